"""Explanations: omitted effects are found, stored, resumed and reported, and nothing else."""

import dataclasses
import json
import threading
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from curves import NOISE, TRUTH, Curve, curve, recorded
from test_suspects import fitted

import giajax
from giajax import InputError, write_run
from giajax.fitting import fit, load_result
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel, capabilities
from giajax.recordings import hold_out, read_run
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import declared, left_out, parameter
from giajax.studies import Explanation, explain, ladder, refit, suspects
from giajax.studies._explain import JOURNAL


@giajax.register
class Kept(Curve):
    """The curve as a kind that files can name."""

    kind: ClassVar[str] = "kept_curve"
    from_definition = classmethod(lambda cls, _: cls(weights=np.ones(2)))


def kept(runs, of=None):
    """Return a fit that a file can store, too."""
    names = [field.name for field in dataclasses.fields(Curve)]
    model = (of or Kept)(**{name: getattr(curve(), name) for name in names})
    begin = {"amplitude": 1.9, "decay": 0.75}
    return fit(model, runs, free=list(begin), start=begin, check=False, noise_model="white")


@pytest.mark.slow
def test_two_omissions_are_found_and_judged_by_time_that_no_step_saw():
    recording = recorded(late=0.05, rub=0.05, seed=2)
    told = []
    found = explain(fitted(recording), recording, say=told.append)
    record, result = found.record, found.result
    assert set(record.added) == {"late", "rub"}
    assert (record.ended, record.verdict, record.outliers) == ("selected", "adequate", 0)
    for path, truth in {"late": 0.05, "rub": 0.05, "amplitude": 2.0, "decay": 0.7}.items():
        one = result.parameters[path]
        assert one.value == pytest.approx(truth, abs=3 * one.standard_error)
    first, last = record.steps[0], record.steps[-1]
    # The final model is fitted to all data, the steps to four fifths.
    assert sum(channel.n for run in result.runs for channel in run.channels.values()) == 360
    assert last.values == 288
    assert last.held_out == pytest.approx(1, abs=0.3)
    assert first.held_out > 1.5 * last.held_out
    assert all(step.p_value < 0.05 for step in record.steps[1:])
    assert any("step 1" in sentence and "remaining" in sentence for sentence in told)
    assert any("selected with these data" in sentence for sentence in result.conditions)
    for one in record.parameters:
        assert one.total_error == pytest.approx(np.hypot(one.standard_error, one.selection_error))
        assert one.selection_error <= one.spread
    assert Explanation.of_json(record.to_json()) == record
    assert record.is_of(result)
    # The ladder has the same likelihood, and takes the same steps.
    steps = ladder(fitted(recording), recording)
    assert [step.change for step in record.steps] == [step.change for step in steps.steps]


def test_outliers_are_seen_first_and_a_right_model_stays():
    recording = recorded(seed=5)
    found = explain(fitted(recording), recording)
    assert [step.change for step in found.record.steps] == ["-"]
    assert (found.record.added, found.record.verdict) == ((), "adequate")
    assert found.result.parameters["decay"].value == fitted(recording).parameters["decay"].value
    assert all(one.selection_error <= 0.5 * one.standard_error for one in found.record.parameters)
    values = {name: column.copy() for name, column in recording.values.items()}
    for name, column in values.items():
        column[np.random.default_rng(len(name)).choice(120, 6, replace=False)] += 30 * NOISE
    spoilt = dataclasses.replace(recording, values=values)
    found = explain(fitted(spoilt), spoilt, max_steps=1)
    assert found.record.outliers >= 10
    assert found.record.loss == "huber"
    one = found.result.parameters["decay"]
    assert one.value == pytest.approx(0.7, abs=3 * one.standard_error)


def test_what_ends_it_early_gives_all_that_was_reached():
    recording = recorded(late=0.05, rub=0.05, seed=2)
    first = fitted(recording)
    assert explain(first, recording, budget_s=0.0).record.ended == "budget"

    def stop(sentence):
        if "step 1" in sentence:
            raise KeyboardInterrupt

    found = explain(first, recording, say=stop)
    assert found.record.ended == "interrupted"
    assert len(found.record.steps) == 2
    assert found.record.steps[1].chi_square < found.record.steps[0].chi_square
    assert found.record.fit
    # The result reports that it uses four fifths of the data, which are read again from the file.
    assert any("the fit of the last step" in sentence for sentence in found.result.conditions)
    (about,) = found.result.config["runs"]
    assert about["held_from"] == dict.fromkeys(recording.observations, 96)
    (part,) = (each.fitted for each in hold_out([recording], ["last"]))
    assert suspects(found.result, part).rows
    with pytest.raises(InputError, match="to try at each step is 0"):
        explain(first, recording, tries=0)


@pytest.mark.parametrize("ended", ["interrupted", "budget"])
@pytest.mark.parametrize("which", [0, 1])
def test_of_two_fits_at_once_what_ended_before_is_kept(tmp_path, monkeypatch, which, ended):
    recording = recorded(late=0.002, shift=[0.0, 0.0, 0.02], seed=2)
    first, whole, cut = kept([recording]), tmp_path / "whole", tmp_path / "cut"

    def names(folder):
        return [
            json.loads(line)["name"] for line in (folder / JOURNAL).read_text().splitlines()[1:]
        ]

    steps = explain(first, recording, folder=whole).record.steps
    asked = names(whole).index("suspects") + 1
    pair = names(whole)[asked : asked + 2]
    done = threading.Event()

    def stopped(result, runs, **changed):
        if changed.get("free") == [pair[which]]:
            assert which == 0 or done.wait(60)
            if ended == "interrupted":
                raise KeyboardInterrupt
            return dataclasses.replace(result, reason="budget")
        found = refit(result, runs, **changed)
        if changed.get("free") == [pair[0]]:
            done.set()
        return found

    with monkeypatch.context() as patched:
        patched.setattr("giajax.studies._stepwise.refit", stopped)
        assert explain(first, recording, folder=cut).record.ended == ended
    assert names(cut)[asked:] == pair[:which]
    again = explain(first, recording, folder=cut).record.steps
    assert [(one.change, one.chi_square) for one in again] == [
        (one.change, one.chi_square) for one in steps
    ]
    assert names(cut) == names(whole)


def test_the_memory_of_a_joint_is_rather_to_be_believed_than_friction():
    model = ArmModel(takeichi_20m(2))
    assert set(capabilities.rather(model)) == {"joints.friction"}
    name = capabilities.rather(model)["joints.friction"]
    assert "joints.memory.strength" in left_out(model)
    assert "joints.memory.strength" in declared(capabilities.variants(model)[name])
    assert capabilities.rather(capabilities.variants(model)[name]) == {}
    assert capabilities.rather(fitted(recorded(seed=5)).model) == {}


@pytest.mark.parametrize(
    "where", ["fitting the first model", "testing fixed and omitted parameters ..."]
)
def test_a_model_that_cannot_be_asked_ends_an_explanation_with_what_there_is(where):
    recording = recorded(seed=5)

    def fail(sentence):
        if where in sentence:
            raise InputError("it cannot be evaluated: hold more")

    found = explain(fitted(recording), recording, say=fail)
    assert (found.record.ended, found.record.ending) == (
        "failed",
        "it cannot be evaluated: hold more",
    )
    assert [step.change for step in found.record.steps] == ["-"]
    assert found.result.suspects


def test_without_a_last_fifth_nothing_is_held_out_and_it_says_so():
    recording = dataclasses.replace(recorded(seed=5), name="last")
    record = explain(fitted(recording), recording).record
    assert record.ending.endswith("no data could be held out to validate the steps")
    assert record.steps[0].held_out is None
    assert record.steps[0].values == 360


def test_turned_runs_are_files_of_their_own_and_no_users(tmp_path):
    runs = []
    for name in ("one", "two"):
        recording = recorded(seed=len(runs))
        values = recording.values
        swapped = {**values, "tip_y": values["tip_z"], "tip_z": values["tip_y"]}
        (tmp_path / name).mkdir()
        path = tmp_path / name / "run.csv"
        write_run(path, recording.times, swapped, definition=recording.definition)
        runs.append(read_run(path))
    (tmp_path / "run.csv").write_text("a file of the user")
    found = explain(kept(runs), runs, folder=tmp_path, max_steps=1)
    assert found.record.axes
    assert (tmp_path / "run.csv").read_text() == "a file of the user"
    files = [read_run(run.path) for run in found.result.runs]
    assert [run.sha256 for run in files] == [run.sha256 for run in found.result.runs]
    assert files[0].sha256 != files[1].sha256
    # The journal belongs to this explanation, and gives the same result without a fit.
    told = []
    again = explain(kept(runs), runs, folder=tmp_path, say=told.append)
    assert again.record == found.record
    assert not [sentence for sentence in told if sentence.startswith("fitting axes")]
    other = explain(kept(runs[:1]), runs[:1], folder=tmp_path, max_steps=0)
    assert [step.change for step in other.record.steps] == ["-"]


@giajax.register
class Kicked(Kept):
    """The curve, with an effect that acts only at the end."""

    kind: ClassVar[str] = "kicked_curve"
    kick: Scalar = parameter(0.0, unit="m/s", doc="rate from 3.2 s on")

    def predict(self, inputs, channels):
        predicted, fine = super().predict(inputs, channels)
        late = self.kick * jnp.maximum(inputs - 3.2, 0.0)
        return {name: row + late for name, row in predicted.items()}, fine


def kicked():
    """Simulate a delayed recording of this curve."""
    recording = recorded(late=0.05, seed=2)
    late = 0.1 * np.maximum(recording.times - 3.2, 0.0)
    values = {name: row + late for name, row in recording.values.items()}
    return dataclasses.replace(recording, values=values)


def stop_at(words):
    def stop(sentence):
        if words in sentence:
            raise KeyboardInterrupt

    return stop


@pytest.mark.slow
def test_what_the_last_fifth_alone_shows_is_fitted_by_all_of_the_data():
    recording = kicked()
    first = kept([recording], Kicked)
    told = []
    record = explain(first, recording, say=told.append).record
    assert [step.change for step in record.steps] == ["-", "late", "all of the data", "kick"]
    assert [step.kind for step in record.steps] == ["start", "parameter", "data", "parameter"]
    assert [step.values for step in record.steps] == [288, 288, 360, 360]
    assert [step.held_out is None for step in record.steps] == [False, False, True, True]
    assert (record.added, record.ended, record.verdict) == (
        ("late", "kick"),
        "selected",
        "adequate",
    )
    for one in record.parameters:
        assert one.value == pytest.approx(TRUTH[one.path], abs=3 * one.total_error)
    assert any(sentence.startswith("all of the data: ") for sentence in told)
    assert any(sentence.startswith("step 2: kick: ") for sentence in told)
    # The steps of both calls are counted together.
    record = explain(first, recording, max_steps=1).record
    assert (record.ended, record.added) == ("steps", ("late",))
    for words in (
        "selected model to all",
        "testing fixed and omitted parameters of the selected",
        "with white noise",
        "all of the",
    ):
        record = explain(first, recording, say=stop_at(words)).record
        assert (record.ended, [step.change for step in record.steps]) == (
            "interrupted",
            ["-", "late"],
        )
    record = explain(first, recording, say=stop_at("step 2: kick")).record
    assert (record.ended, record.added) == ("interrupted", ("late", "kick"))


@pytest.mark.slow
def test_time_that_is_up_before_the_last_fit_is_said_and_the_rest_follows(tmp_path):
    recording = kicked()
    first = kept([recording], Kicked)
    whole = explain(first, recording, folder=tmp_path).record
    assert whole.added == ("late", "kick")
    late = explain(first, recording, folder=tmp_path, budget_s=0.0)
    assert (late.record.ended, late.record.added) == ("budget", ("late",))
    assert any("the final fit did not finish" in one for one in late.result.conditions)
    assert explain(first, recording, folder=tmp_path).record == whole
    # Each fit reports the data that it uses.
    counts = []
    for path in sorted((tmp_path / "fits").glob("*.json")):
        one = load_result(path)
        (about,) = one.config.get("runs") or [{}]
        counts.append(sum(channel.n for channel in one.runs[0].channels.values()))
        assert (counts[-1] == 288) == bool(about.get("held_from"))
    assert {288, 360} == set(counts)


def test_a_fit_whose_file_cannot_be_read_is_passed_over(tmp_path, monkeypatch):
    recording = recorded(late=0.05, seed=2)
    first = kept([recording])

    def refuse(path):
        if path.name != "000.json":
            raise InputError("no file may say so: correct it")
        return load_result(path)

    monkeypatch.setattr("giajax.studies._explain.load_result", refuse)
    record = explain(first, recording, folder=tmp_path).record
    assert (record.ended, record.added) == ("selected", ())
    # The journal contains the reason, and gives the same result.
    assert "no file may say so" in (tmp_path / JOURNAL).read_text()
    assert explain(first, recording, folder=tmp_path).record == record
