"""The ladder: omitted effects are found one by one, and nothing else."""

import dataclasses

import numpy as np
import pytest
from curves import curve, recorded
from test_suspects import FREE, fitted

from giajax import InputError, fit, ladder, suspects
from giajax.recordings import PriorEntry, split_run
from giajax.studies import Step, refit
from giajax.studies._stepwise import _spare, best_step

TIGHT = 4


@pytest.mark.slow
def test_two_omissions_one_after_the_other():
    recording = recorded(late=0.05, rub=0.05, seed=2)
    seen = []
    steps = ladder(
        fitted(recording), recording, held_out=[recorded(late=0.05, rub=0.05, seed=9)],
        progress=seen.append,
    )  # fmt: skip
    assert {step.suspect.path for step in steps.steps[1:]} == {"late", "rub"}
    assert steps.ending == "no suspect that could be freed is significant"
    assert [step.suspect for step in seen] == [step.suspect for step in steps.steps]
    for path, truth in {"late": 0.05, "rub": 0.05, "amplitude": 2.0, "decay": 0.7}.items():
        one = steps.result.parameters[path]
        assert one.value == pytest.approx(truth, abs=TIGHT * one.standard_error)
    for measure in ("chi_square", "aic", "bic", "held_out"):
        values = [getattr(step, measure) for step in steps.steps]
        assert values == sorted(values, reverse=True), measure
    last = steps.steps[-1]
    assert last.parameters == 4
    assert last.chi_square == pytest.approx(last.values, rel=0.2)
    assert last.held_out == pytest.approx(1, rel=0.15)
    assert last.bic - last.aic == pytest.approx(4 * (np.log(360) - 2))


@pytest.mark.slow
def test_what_is_no_longer_needed_is_taken_out_again():
    """A shift of z compensates for a wrong offset and a delay, until these are included."""
    recording = recorded(late=0.03, rub=0.05, seed=4)
    first = fitted(recording, free=[*FREE, "shift[2]"])
    step = suspects(first, recording).of("late")
    assert step.p_value < 1e-3
    steps = [
        Step(None, 9e9, 2, 360, None, fitted(recording)),
        Step(suspects(fitted(recording), recording).of("shift[2]"), 8e9, 3, 360, None, first),
        Step(step, 7e9, 4, 360, None, refit(first, [recording], free=["late", "rub"])),
    ]
    assert [suspect.path for suspect in _spare(steps)] == ["shift[2]"]
    assert _spare(steps[:2]) == []
    removed = dataclasses.replace(steps[2], suspect=steps[1].suspect, removed=True)
    assert removed.change == "without shift[2]"
    assert _spare([*steps, removed, steps[2]]) == []
    held = refit(steps[2].result, [recording], fix={"shift[2]": 0.0})
    assert set(held.free) == {"amplitude", "decay", "late", "rub"}


def test_elements_that_scatter_no_more_are_held_where_they_were():
    """The elements were freed because of a delay, and are not needed once it is included."""
    recording = recorded(late=0.05, seed=4)
    first = fitted(recording)
    parts = ["weights[0]", "weights[1]"]
    known = {path: PriorEntry(value=1.0, deviation=0.1) for path in parts}
    freed = refit(first, [recording], free=parts, priors=known)
    scattered = dataclasses.replace(suspects(first, recording).of("weights"), kind="scatter")
    last = refit(freed, [recording], free=["late"])
    steps = [
        Step(None, 9e9, 2, 360, None, first),
        Step(scattered, 8e9, 4, 360, None, freed),
        Step(suspects(freed, recording).of("late"), 7e9, 5, 360, None, last),
    ]
    (spare,) = _spare(steps)
    assert (spare.path, spare.value) == ("weights", [1.0, 1.0])
    held = refit(last, [recording], fix={spare.path: spare.value})
    assert set(held.free) == {"amplitude", "decay", "late"}
    assert not held.config.get("priors")
    # Without the delay, the elements differ from their fixed values.
    late = dataclasses.replace(steps[2], result=freed)
    assert _spare([*steps[:2], late]) == []


@pytest.mark.slow
def test_a_choice_is_made_the_other_way_and_axes_are_exchanged():
    recording = recorded(wave=0.05)
    steps = ladder(fitted(recording), recording)
    assert [step.suspect.path for step in steps.steps[1:]] == ["wavy = true"]
    assert steps.result.model.wavy
    values = recording.values
    swapped = {**values, "tip_y": values["tip_z"], "tip_z": values["tip_y"]}
    wrong = dataclasses.replace(recording, values=swapped)
    start = {"amplitude": 1.9, "decay": 0.75}
    # The held-out data were recorded with the same wrong axes.
    late = split_run(wrong, dict.fromkeys(wrong.observations, 90))
    steps = ladder(fitted(late.fitted, start=start), late.fitted, held_out=[late.held])
    added = [step.suspect.path for step in steps.steps[1:]]
    assert added[0] == "axes: y and z swapped"
    assert steps.steps[0].held_out > 10
    assert steps.steps[-1].held_out == pytest.approx(1, rel=0.25)
    assert steps.result.parameters["decay"].value == pytest.approx(0.7, abs=0.02)


def test_nothing_is_added_to_a_right_model_nor_beyond_the_steps_allowed():
    recording = recorded(seed=5)
    steps = ladder(fitted(recording), recording)
    assert len(steps.steps) == 1
    both = recorded(late=0.05, rub=0.05, seed=2)
    short = ladder(fitted(both), both, most=1)
    assert len(short.steps) == 2
    assert short.ending == "the limit of 1 steps was reached"


def test_a_refit_begins_where_the_fit_ended():
    recording = recorded(rub=0.02)
    result = fitted(recording)
    again = refit(result, [recording])
    assert again.iterations <= 2
    assert again.parameters["decay"].value == pytest.approx(
        result.parameters["decay"].value, abs=0.1 * result.parameters["decay"].standard_error
    )
    # A value at a bound starts slightly inside.
    freed = refit(result, [recording], free=["rub"])
    whole = fit(curve(), recording, free=["amplitude", "decay", "rub"],
                start={"amplitude": 1.5, "decay": 0.9, "rub": 0.1}, check=False)  # fmt: skip
    assert freed.parameters["rub"].value == pytest.approx(whole.parameters["rub"].value, rel=1e-3)
    assert freed.status == "converged"


def test_of_several_that_are_tried_the_lowest_bic_is_taken():
    """A fit may not confirm a test; here, the order of the tests is wrong."""
    recording = recorded(late=0.05, seed=2)
    result = fitted(recording)
    found = suspects(result, recording)
    promising = [found.of("weights"), found.of("shift[1]"), found.of("late")]
    taken = {
        tries: best_step(result, [recording], [], promising, tries)[0].suspect.path
        for tries in (1, 2)
    }
    # A common factor of all weights is not a parameter of a fit, and does not count as a try.
    assert taken == {1: "shift[1]", 2: "late"}
    steps = ladder(result, recording, tries=2)
    assert [step.suspect.path for step in steps.steps[1:]] == ["late"]
    with pytest.raises(InputError, match="to try at each step is 0"):
        ladder(result, recording, tries=0)


def test_what_is_tried_does_not_depend_on_the_cores(monkeypatch):
    """They run in parallel or in sequence, and a failed fit does not affect the others."""
    recording = recorded(late=0.05, rub=0.05, seed=2)
    result = fitted(recording)
    found = suspects(result, recording)
    late = found.of("late")
    impossible = dataclasses.replace(late, estimate=np.inf)
    ends = []
    for number in (1, 2):
        monkeypatch.setattr("giajax.studies._stepwise.cores", lambda number=number: number)
        one, _, _ = best_step(result, [recording], [], [late, found.of("rub"), impossible], 3)
        ends.append((one.suspect.path, one.result.cost))
    assert ends[0] == ends[1]
    assert ends[0][0] == "late"


def test_rungs_among_outliers_are_compared_by_one_likelihood():
    """The estimated noise decreases from fit to fit, so the fits must not use their own weights."""
    recording = recorded(late=0.05, seed=2, noise=False)
    random = np.random.default_rng(0)
    wild = {
        name: values + np.where(random.uniform(size=120) < 0.05, 0.4, 0.0)
        for name, values in recording.values.items()
    }
    outlying = dataclasses.replace(recording, values=wild)
    steps = ladder(fitted(outlying, loss="huber"), outlying)
    assert steps.steps[1].suspect.path == "late"

    def left_over(step):
        predicted = step.result.predict(outlying)
        return [predicted[name] - wild[name] for name in predicted]

    (last,) = steps.steps[-1].result.runs
    sigmas = [channel.white for channel in last.channels.values()]
    for step in steps.steps:
        far = np.concatenate(
            [np.abs(rest) / sigma for rest, sigma in zip(left_over(step), sigmas, strict=True)]
        )
        expected = np.sum(np.where(far < 1, far**2, 2 * far - 1))
        assert step.chi_square == pytest.approx(expected, rel=1e-9)
    assert steps.steps[0].bic - steps.steps[-1].bic > 100


def test_what_was_left_out_before_is_held_as_if_it_were():
    recording = recorded(rub=0.05, seed=4)
    first = fitted(recording)
    freed = refit(first, [recording], free=["late"])
    scattered = dataclasses.replace(suspects(first, recording).of("late"), kind="scatter")
    last = refit(freed, [recording], free=["rub"])
    steps = [
        Step(None, 9e9, 2, 360, None, first),
        Step(scattered, 8e9, 3, 360, None, freed),
        Step(suspects(freed, recording).of("rub"), 7e9, 4, 360, None, last),
    ]
    (spare,) = _spare(steps)
    assert (spare.path, spare.value) == ("late", 0.0)
    assert set(refit(last, [recording], fix={"late": 0.0}).free) == {"amplitude", "decay", "rub"}
