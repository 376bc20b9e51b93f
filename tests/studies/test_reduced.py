"""Suspects of fits with ties, priors and values per run, compared with refits that free them."""

import dataclasses

import numpy as np
import pytest
from curves import curve, recorded

from giajax import InputError, Prior, fit, ladder, suspects, systematic_errors
from giajax.studies import refit

START = {"amplitude": 1.5, "decay": 0.9}
# The recordings have amplitude 2 and offset 0.1.
TIES = {"offset": "0.05 * amplitude"}
PRIORS = {"decay": Prior(0.71, deviation=0.004), "amplitude": Prior(2.02, factor=1.004)}


def fitted(runs, *, free=tuple(START), start=None, **options):
    begin = {**START, **(start or {})}
    return fit(
        curve(), runs, free=free, start=begin, check=False, noise_model="white", **options
    )  # fmt: skip


def runs_of(*, aside=0.0, **values):
    """Simulate three recordings; the second one is 0.2 m higher, and shifted by a part of that."""
    return [
        recorded(seed=i, offset=height, shift=[aside * (height - 0.1), 0.0, 0.0], **values)
        for i, height in enumerate((0.1, 0.3, 0.1))
    ]


def check(result, freed, row):
    """Compare a test with the fit that frees the suspect; priors count as measurements."""
    drop = 2 * (result.cost - freed.cost)
    assert row.testable
    assert row.chi_square_drop == pytest.approx(drop, rel=0.05)
    estimate = freed.parameters[row.path]
    assert row.estimate == pytest.approx(estimate.value, abs=0.1 * estimate.standard_error)
    assert row.estimate_error == pytest.approx(estimate.standard_error, rel=0.2)
    return drop


@pytest.mark.slow
@pytest.mark.parametrize("options", [{"ties": TIES}, {"priors": PRIORS}])
def test_drop_and_estimate_are_those_of_a_refit(options):
    """A delay, which has the effect of a larger amplitude if that is not constrained."""
    recording = recorded(late=0.015, channels=("tip_z",), offset=0.1)
    result, plain = fitted(recording, **options), fitted(recording)
    found = suspects(result, recording)
    freed = fitted(recording, free=[*START, "late"], start={"late": 0.01}, **options)
    drop = check(result, freed, found.of("late"))
    other = suspects(plain, recording).of("late")
    assert not other.testable or other.chi_square_drop < 0.5 * drop
    assert found.chi_square == pytest.approx(2 * result.cost, rel=1e-6)
    assert (found.values, found.parameters) == (120, 2)


@pytest.mark.slow
def test_what_is_tied_is_no_suspect_and_moves_with_what_it_follows_from():
    recording = recorded(offset=0.1, shift=[0.0, 0.004, 0.0])
    result = fitted(recording, ties={"offset": "0.05 * twin + 0.05", "weights[1]": "weights[0]"})
    found = suspects(result, recording)
    assert not {"offset", "weights[1]"} & {row.path for row in found.rows}
    for path, start in {"twin": 1.001, "weights[0]": 1.001}.items():
        freed = fitted(
            recording, free=[*START, path], start={path: start}, ties=result.config["ties"]
        )  # fmt: skip
        check(result, freed, found.of(path))


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        {"per_run": ["offset"]},
        {"groups": {"offset": [["curve0", "curve2"], ["curve1"]]}},
        {
            "per_run": ["offset"],
            "priors": {"offset": Prior(0.2, deviation=0.1), "decay": Prior(0.7, deviation=0.001)},
            "ties": {"shift[0]": "0.2 * offset - 0.02"},
        },
    ],
)
def test_values_of_single_runs_take_part(options):
    """A value of one run or of a group of runs; with priors, and with ties to it."""
    runs = runs_of(late=0.01, aside=0.2 if "ties" in options else 0.0)
    result = fitted(runs, **options)
    found = suspects(result, runs)
    assert "offset" not in {row.path for row in found.rows}
    freed = fitted(runs, free=[*START, "late"], start={"late": 0.01}, **options)
    check(result, freed, found.of("late"))
    assert found.chi_square == pytest.approx(2 * result.cost, rel=1e-6)
    assert found.parameters == 2 + (3 if "per_run" in options else 2)
    # A refit with the same values per run starts at its optimum.
    assert refit(result, runs).iterations <= 2


def test_a_choice_and_axes_are_those_of_each_run():
    runs = runs_of(wave=0.05)
    result = fitted(runs, per_run=["offset"], ties={"twin": "1 + 0 * decay"})
    found = suspects(result, runs)
    row = found.of("wavy = true")
    assert row.estimate == pytest.approx(1, abs=4 * row.estimate_error)
    assert not [row for row in found.rows if row.kind in ("axes", "columns")]


def test_what_a_prior_holds_is_imitated_no_more():
    """Only amplitude times twin matters; with a prior of one, the other is equally uncertain."""
    recording = recorded()
    row = suspects(fitted(recording), recording).of("twin")
    assert row.chi_square_drop < 10  # the y coordinate has no twin
    alone = recorded(channels=("tip_z",))
    assert (
        suspects(fitted(alone), alone)
        .of("twin")
        .note.startswith("the fitted parameters have the same effect")
    )
    known = fitted(alone, priors={"amplitude": Prior(2.1, factor=1.02)})
    row = suspects(known, alone).of("twin")
    assert row.testable
    assert row.estimate_error == pytest.approx(np.log(1.02) * row.estimate, rel=0.1)
    amplitude = known.parameters["amplitude"].value
    assert row.estimate == pytest.approx(amplitude / 2.1, rel=5e-3)


@pytest.mark.slow
def test_nothing_is_asked_for_where_the_model_is_right():
    alarms = 0
    for seed in range(12):
        runs = [recorded(seed=200 + 2 * seed + i, offset=0.1) for i in range(2)]
        result = fitted(
            runs,
            priors={"decay": Prior(0.7, deviation=0.004), "offset": Prior(0.1, deviation=0.01)},
            per_run=["offset"],
            ties={"weights[1]": "weights[0]"},
        )
        alarms += bool(suspects(result, runs).significant)
    assert alarms <= 3  # P(4 or more of 12 at 5 %) is 0.2 %


def test_held_numbers_against_refits_with_them_moved():
    """With ties and priors; for values per run, their mean."""
    runs = runs_of()
    options = {
        "per_run": ["offset"],
        "priors": {"offset": Prior(0.2, deviation=0.002), "decay": Prior(0.7, deviation=0.002)},
        "ties": {"shift[1]": "0.3 * twin - 0.3"},
    }
    result = fitted(runs, **options)
    errors = {one.path: one for one in systematic_errors(result, runs, {"twin": 0.002})}
    assert "shift[1]" not in errors
    ends = [fitted(runs, fix={"twin": 1 + sign * 0.002}, **options).free for sign in (-1, 1)]
    for path, shift in errors["twin"].shifts.items():
        moved = (ends[1][path].value - ends[0][path].value) / 2
        assert shift == pytest.approx(moved, rel=0.03), path
    with pytest.raises(InputError, match=r"shift\[1\] is tied to other parameters: give"):
        systematic_errors(result, runs, {"shift[1]": 0.1})


@pytest.mark.slow
def test_a_ladder_keeps_ties_priors_and_values_of_single_runs():
    runs = runs_of(late=0.05)
    options = {
        "per_run": ["offset"],
        "priors": {"decay": Prior(0.7, deviation=0.01)},
        "ties": {"weights[1]": "weights[0]"},
    }
    steps = ladder(fitted(runs, **options), runs, held_out=[dataclasses.replace(runs[1])])
    assert [step.suspect.path for step in steps.steps[1:]] == ["late"]
    first, last = steps.steps
    assert (first.parameters, last.parameters) == (5, 6)
    assert last.result.config["groups"] == first.result.config["groups"]
    assert last.held_out == pytest.approx(1, rel=0.15)
    assert last.chi_square == pytest.approx(2 * last.result.cost, rel=1e-3)
    for record, height in zip(steps.result.runs, (0.1, 0.3, 0.1), strict=True):
        own = record.parameters["offset"]
        assert own.value == pytest.approx(height, abs=4 * own.standard_error)
