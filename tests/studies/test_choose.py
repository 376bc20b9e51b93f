"""The choice between operators: the true operator is selected, and the criteria are correct."""

import dataclasses
import itertools

import numpy as np
import pytest

from giajax import Definition, InputError, Run, declared, fit
from giajax.mechanics.hysteresis import Preisach
from giajax.studies import CANDIDATES, choice_hint, choose_hysteresis


def recording(seed=0, turns=(0, 1, -1, 0.7, -0.5, 0.9, 0.1, 0.6, -0.8, 0.3, -0.3, 0.5)):
    truth = Preisach(
        slope=0.2,
        saturation=0.9,
        coercivity=0.25,
        coercivity_spread=0.5,
        bias=0.12,
        interaction=0.25,
        extent=1.05,
    )
    inputs = np.concatenate([np.linspace(a, b, 30)[1:] for a, b in itertools.pairwise(turns)])
    outputs = np.asarray(truth.history(inputs)[0])
    noise = 0.003 * np.random.default_rng(seed).standard_normal(len(inputs))
    return Run.from_arrays(None, {"input": inputs, "output": outputs + noise}, name="loops")


@pytest.fixture(scope="module")
def choice():
    return choose_hysteresis([recording()], candidates=["play", "preisach", "bouc_wen"])


@pytest.mark.slow
def test_the_operator_behind_the_data_is_chosen(choice):
    assert choice.best.name == "preisach"
    held_out = {candidate.name: candidate.held_out_rmse for candidate in choice.candidates}
    assert held_out["preisach"] < 0.004
    assert held_out["play"] > 5 * held_out["preisach"]
    assert list(held_out.values()) == sorted(held_out.values())
    assert min(choice.candidates, key=lambda c: c.aic).name == "preisach"
    assert min(choice.candidates, key=lambda c: c.bic).name == "preisach"


@pytest.mark.slow
def test_the_criteria_are_what_they_say(choice):
    for candidate in choice.candidates:
        record = candidate.result.runs[0].channels["output"]
        assert record.rmse == pytest.approx(candidate.rmse)
        n, k = record.n, candidate.parameters + 1
        assert candidate.aic == pytest.approx(n * np.log(candidate.rmse**2) + 2 * k)
        assert candidate.bic - candidate.aic == pytest.approx(k * (np.log(n) - 2))
        # 30 % are held out.
        assert n == round(0.7 * 319)


@pytest.mark.slow
def test_fits_that_did_not_converge_sink(monkeypatch):
    """The true operator may take three steps, the play as many as it needs."""

    def hurried(model, runs, **options):
        iterations = 3 if "saturation" in declared(model) else 100
        return fit(model, runs, **{**options, "max_iterations": iterations})

    monkeypatch.setattr("giajax.studies._choose.fit", hurried)
    choice = choose_hysteresis([recording()], candidates=["preisach", "play"])
    assert [one.name for one in choice.candidates] == ["play", "preisach"]
    assert [one.converged for one in choice.candidates] == [True, False]
    assert choice.best.name == "play"
    assert choice.candidates[1].held_out_rmse < choice.best.held_out_rmse


def test_a_loop_without_an_operator_hints_at_the_choice():
    run = recording()
    hint = choice_hint([run], ["my loops.csv"])
    assert hint.endswith("giajax choose --data 'my loops.csv'")
    stated = Definition.parse({"hysteresis": {"operator": "preisach"}})
    known = dataclasses.replace(run, definition=run.definition.merged_with(stated))
    assert choice_hint([known], ["loops.csv"]) == ""
    arm = Run.from_arrays([0.0, 1.0], {"tip_z": [0.0, 0.1]}, definition={"free_motion": True})
    assert choice_hint([arm], ["run.csv"]) == ""


def test_another_run_judges():
    other = recording(seed=1, turns=(0, 0.8, -0.2, 0.6, -0.9, 0.4))
    choice = choose_hysteresis([recording()], [other], candidates=["play"])
    only = choice.best
    predicted = only.result.predict(other)["output"] - other.values["output"]
    assert only.held_out_rmse == pytest.approx(np.sqrt(np.mean(predicted**2)))
    assert only.result.runs[0].channels["output"].n == 319


def test_bad_questions_are_refused():
    run = recording()
    with pytest.raises(InputError, match="unknown candidate 'duhem'"):
        choose_hysteresis([run], candidates=["duhem"])
    with pytest.raises(InputError, match="unknown candidate: choose from play"):
        choose_hysteresis([run], candidates=[])
    with pytest.raises(InputError, match="between 0 and 1"):
        choose_hysteresis([run], hold_out=["last:1"])
    with pytest.raises(InputError, match="but at least 8 are required"):
        choose_hysteresis([run], hold_out=["last:0.01"])
    arm = Run.from_arrays([0.0, 1.0], {"tip_z": [0.0, 0.1]}, definition={"free_motion": True})
    with pytest.raises(InputError, match="runs of the hysteresis model"):
        choose_hysteresis([arm])
    assert set(CANDIDATES) > {"preisach", "bouc_wen", "modified_prandtl_ishlinskii"}
