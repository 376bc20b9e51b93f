"""Suspects compared with refits that free them, for a model that compiles quickly."""

import dataclasses
import json
import os
import signal
import time
import types

import jax.numpy as jnp
import numpy as np
import pytest
from curves import NOISE, TRUTH, Curve, OwnHeights, curve, recorded

from giajax import InputError, Run, fit, predict, replace, suspects, write_result
from giajax.fitting import Response
from giajax.report import residuals_figure, summary, suspect_rows
from giajax.runtime.arrays import Scalar
from giajax.schema.parameters import parameter
from giajax.studies import explain, inquiry, is_disturbed, linearised, with_suspects
from giajax.studies._columns import chi_square_of, points_row
from toy_model import Decay, run

FREE = ["amplitude", "decay"]


def fitted(recording, *, free=FREE, start=None, **options):
    model = curve()
    begin = {"amplitude": 1.5, "decay": 0.9} if start is None else start
    # Chi-square drops are those with white noise, so that refits can be compared.
    options = {"noise_model": "white", **options}
    return fit(model, recording, free=free, start=begin, check=False, **options)


def chi_square(result):
    return sum(c.n * (c.rmse / NOISE) ** 2 for r in result.runs for c in r.channels.values())


@pytest.mark.parametrize(("path", "value"), [("offset", 0.105), ("shift[1]", 0.004), ("rub", 0.01)])
def test_drop_and_estimate_are_those_of_a_refit(path, value):
    name = path.partition("[")[0]
    whole = [0.0, value, 0.0] if "[" in path else value
    recording = recorded(**{name: whole})
    result = fitted(recording)
    row = suspects(result, recording).of(path)
    start = {path: max(row.estimate, 1e-3)} if path == "rub" else {}
    freed = fitted(recording, free=[*FREE, path], start={"amplitude": 1.5, "decay": 0.9, **start})
    assert row.testable
    assert row.chi_square_drop == pytest.approx(chi_square(result) - chi_square(freed), rel=0.05)
    estimate = freed.parameters[path]
    assert row.estimate == pytest.approx(estimate.value, rel=0.03)
    assert row.estimate_error == pytest.approx(estimate.standard_error, rel=0.2)


def test_what_the_fit_imitates_and_what_nothing_shows_is_not_testable():
    recording = run(seed=1)
    result = fit(Decay(), recording, check=False)
    found = suspects(result, recording)
    assert {row.path: row.note for row in found.untestable} == {
        "twin": "the fitted parameters have the same effect: only a ratio is identifiable",
        "idle": "no channel responds to it",
    }
    assert found.rows == found.untestable
    assert found.of("twin").p_value is None


@pytest.mark.parametrize("stated", [True, False])
def test_each_omission_comes_first(stated):
    """A disabled part, a value at its bound, a vector, a choice, and axes."""
    omissions = {
        "late": {"late": 0.05},
        "rub": {"rub": 0.05},
        "shift": {"shift": [0.02, -0.03, 0.02]},
        "weights": {"weights": [1.05, 1.05]},
        "wavy = true": {"wave": 0.04},
    }
    for name, values in omissions.items():
        recording = recorded(noise=stated, seed=3, **values)
        found = suspects(fitted(recording), recording)
        first = found.promising[0]
        assert first.path == name, [row.path for row in found.promising[:3]]
        assert first.p_value < 1e-3
        assert first.chi_square_drop > 30


def test_a_choice_is_a_blend_between_its_two_sides():
    recording = recorded(wave=0.05)
    row = suspects(fitted(recording), recording).of("wavy = true")
    assert (row.kind, row.value, row.unit) == ("switch", 0, "")
    assert row.estimate == pytest.approx(1, abs=4 * row.estimate_error)
    away = recorded(wave=-0.05)
    assert suspects(fitted(away), away).of("wavy = true").chi_square_drop == 0


def test_at_a_bound_only_what_leads_inwards_counts():
    recording = recorded()
    values = dict(recording.values)
    values["tip_x"] = values["tip_x"] - 0.05 * np.tanh(recording.times - 2)
    outwards = dataclasses.replace(recording, values=values)
    row = suspects(fitted(outwards), outwards).of("rub")
    assert (row.estimate, row.chi_square_drop, row.p_value) == (0, 0, 1)
    assert row.note == (
        "fixed at its bound: tested only towards the interior, and the data suggest a value beyond "
        "the bound"
    )


def test_swapped_axes_are_found_from_where_the_fit_began():
    recording = recorded()
    swapped = {"tip_y": recording.values["tip_z"], "tip_z": recording.values["tip_y"]}
    wrong = dataclasses.replace(recording, values={**recording.values, **swapped})
    found = suspects(fitted(wrong, start={"amplitude": 1.9, "decay": 0.75}), wrong)
    first = found.promising[0]
    assert (first.path, first.kind) == ("axes: y and z swapped", "axes")
    assert first.p_value < 1e-6
    assert first.begun
    # Correct axes are not accused, nor a single coordinate, whose sign is the only choice.
    for right in recording, recorded(channels=("tip_z",)):
        found = suspects(fitted(right), right)
        assert not [row for row in found.rows if row.kind in ("axes", "columns")]


def test_elements_of_an_array_one_by_one():
    recording = recorded(weights=[1.05, 0.95])
    result = fitted(recording)
    together = suspects(result, recording)
    assert together.of("weights").degrees_of_freedom == 1
    each = suspects(result, recording, each=["weights"])
    group = each.of("weights")
    assert (group.kind, group.degrees_of_freedom) == ("group", 2)
    assert np.allclose(group.estimate, [1.05, 0.95], atol=4 * max(group.estimate_error))
    assert each.promising[0].path == "weights"
    assert group.chi_square_drop > 4 * together.of("weights").chi_square_drop
    assert each.asked == together.asked + 2


def test_nothing_is_asked_for_where_the_model_is_right():
    alarms = 0
    for seed in range(20):
        recording = recorded(seed=100 + seed)
        found = suspects(fitted(recording), recording)
        alarms += bool(found.significant)
        assert found.chi_square == pytest.approx(found.values, rel=0.25)
    assert alarms <= 4  # P(5 or more of 20 at 5 %) is 0.3 %


def test_a_robust_loss_and_an_outlier():
    recording = recorded(late=0.05)
    values = recording.values["tip_x"].copy()
    values[30] += 5
    wild = dataclasses.replace(recording, values={**recording.values, "tip_x": values})
    found = suspects(fitted(wild, loss="huber"), wild)
    assert found.promising[0].path == "late"


def test_outliers_are_told_with_the_loss_for_them():
    """For 3 % of all cells; but not for normal noise, or if the missing effect is smooth."""
    recording = recorded(seed=1)
    rng, values = np.random.default_rng(1), dict(recording.values)
    for name in recording.observations:
        hit = rng.random(len(recording.times)) < 0.03
        values[name] = values[name] + 10 * NOISE * hit * rng.normal(size=len(hit))
    wild = dataclasses.replace(recording, values=values)
    found = suspects(fitted(wild), wild)
    row = found.promising[0]
    assert (row.path, row.kind) == ("outliers", "outliers")
    assert row.p_value < 1e-3
    assert 0.01 < row.estimate < 0.03
    assert "--loss student_t" in row.note
    for other, options in (wild, {"loss": "student_t"}), (recorded(late=0.1), {}):
        asked = suspects(fitted(other, **options), other)
        assert all(row.kind != "outliers" for row in asked.rows)


def test_pictures_tables_and_suspects_measure_by_one_noise():
    """The sample-to-sample noise, because the fit has interpreted the missing effect as noise."""
    recording = recorded(noise=False, late=0.1)
    result = fitted(recording)
    found, (channels,) = suspects(result, recording), [run.channels for run in result.runs]
    sizes = {name: each.rmse / each.white for name, each in channels.items()}
    assert max(sizes.values()) > 1.2
    assert all(each.noise == pytest.approx(each.rmse, rel=0.05) for each in channels.values())
    assert all(each.white == pytest.approx(NOISE, rel=0.25) for each in channels.values())
    squares = sum(each.n * sizes[name] ** 2 for name, each in channels.items())
    assert found.chi_square == pytest.approx(squares, rel=1e-6)
    figure = residuals_figure(result, [recording], [predict(result.model, recording)])
    dots = figure.axes[-1].lines[0].get_ydata()
    assert dots == pytest.approx([sizes[name] for name in recording.observations], rel=1e-6)
    assert "from sample to sample, and up to" in summary(result)


def test_several_runs_with_states_of_their_own():
    """The parameters of each run absorb a part of the missing effect, as in a refit."""
    short = recorded(late=0.05, seed=1, channels=("tip_y", "tip_z"))
    rows = {name: values[:70] for name, values in short.values.items()}
    runs = [
        recorded(late=0.05, seed=2, offset=0.5, channels=("tip_y", "tip_z")),
        dataclasses.replace(short, times=short.times[:70], values=rows),
    ]
    model = OwnHeights(curve())
    start = {"amplitude": 1.5, "decay": 0.9}
    white = {"check": False, "noise_model": "white"}
    result = fit(model, runs, free=FREE, start=start, **white)
    found = suspects(result, runs)
    assert (
        found.of("offset").note
        == "the fitted parameters have the same effect: only a ratio is identifiable"
    )
    assert found.promising[0].path == "late"
    assert found.parameters == 4
    freed = fit(model, runs, free=[*FREE, "late"], start={**start, "late": 0.02}, **white)
    row = found.promising[0]
    assert row.chi_square_drop == pytest.approx(chi_square(result) - chi_square(freed), rel=0.05)
    assert row.estimate == pytest.approx(freed.parameters["late"].value, rel=0.05)


def test_a_fit_of_states_alone_is_asked_too():
    """A suspect cannot shift any fitted parameter."""
    run = recorded(late=0.05, seed=2, offset=0.5, channels=("tip_y", "tip_z"))
    result = fit(OwnHeights(curve()), run, free=[], check=False, noise_model="white")
    assert not result.free
    found = suspects(result, run)
    assert "late" in [row.path for row in found.significant]
    assert not any(row.moves for row in found.rows)


def test_a_result_carries_its_suspects_as_json():
    recording = recorded(late=0.05)
    asked = with_suspects(fitted(recording), recording)
    stored = json.loads(asked.to_json())
    assert stored["suspects"][0]["path"] == "late"
    assert stored["suspects"][0]["chi_square_drop"] > 100
    assert stored["suspects"][0]["estimate"] == pytest.approx(0.05, rel=0.1)
    held = {row["path"] for row in stored["systematic"]}
    # Values that are 0, free, or do not shift a fitted parameter are not included.
    assert held == {"offset", "twin"}


def test_what_a_suspect_moves_is_what_a_refit_moves():
    recording = recorded(late=0.03)
    result = fitted(recording)
    moves = suspects(result, recording).of("late").moves
    freed = fitted(recording, free=[*FREE, "late"], start={**TRUTH, "late": 0.01})
    for path in FREE:
        before = result.parameters[path]
        moved = (freed.parameters[path].value - before.value) / before.standard_error
        assert moves[path] == pytest.approx(moved, rel=0.15, abs=0.2), path
    assert max(map(abs, moves.values())) > 1
    assert all(not row.moves for row in suspects(result, recording).rows if row.p_value is None)


def test_a_suspect_that_moves_a_parameter_makes_the_verdict_doubtful():
    """The residuals do not show it, but the estimates are off by several standard errors."""
    recording = recorded(offset=0.115, seed=3, channels=("tip_z",))
    result = fitted(recording)
    assert result.verdict.status == "adequate"
    decay = result.parameters["decay"]
    assert abs(decay.value - TRUTH["decay"]) > 5 * decay.standard_error
    asked = with_suspects(result, recording, parameters_alone=True)
    assert asked.verdict.status == "doubtful"
    (reason,) = asked.verdict.reasons
    assert reason.code == "suspect"
    assert reason.sentence.startswith(
        "offset (or shift[2], which the data can hardly distinguish from it)"
    )
    assert "is fixed at 0.1 m, and the residuals suggest 0.11" in reason.sentence
    assert reason.sentence.endswith("fit it too, with --free amplitude --free decay --free offset")
    assert asked.headline.startswith("DOUBTFUL MODEL: offset ")
    # Another test gives the same verdict, and with the suspect free, the model is adequate.
    assert with_suspects(asked, recording, parameters_alone=True).verdict == asked.verdict
    freed = fitted(recording, free=[*FREE, "offset"])
    assert with_suspects(freed, recording, parameters_alone=True).verdict.status == "adequate"


def test_right_models_are_seldom_doubted():
    """Of 40 models with a probability of 0.8 % each; a fixed level would accuse 5 %."""
    doubted = 0
    for seed in range(40):
        recording = recorded(seed=seed)
        asked = with_suspects(fitted(recording), recording, parameters_alone=True)
        doubted += asked.verdict.status == "doubtful"
    assert doubted <= 2


def test_noise_with_a_memory_is_no_physics():
    """Half of it is white, half has a correlation of ten samples, similar to an offset."""
    named = 0
    for seed in range(12):
        recording = recorded(seed=seed)
        rng = np.random.default_rng(seed)
        values = dict(recording.values)
        for name in recording.observations:
            fresh, slow = rng.normal(size=len(recording.times)), 0.0
            memory = np.array([slow := 0.9 * slow + np.sqrt(0.19) * each for each in fresh])
            values[name] = values[name] + NOISE * memory
        noisy = dataclasses.replace(recording, values=values)
        found = suspects(fitted(noisy), noisy, parameters_alone=True)
        named += bool(found.significant)
    assert named <= 1


def test_a_fit_without_an_optimum_is_asked_all_the_same():
    recording = recorded(late=0.1)
    result = fitted(recording, max_iterations=1)
    assert result.status == "not_converged"
    assert result.verdict.reasons[-1].code == "end"
    assert suspects(result, recording).promising[0].path == "late"


def test_bad_input():
    recording, other = recorded(), recorded(channels=("tip_z",))
    result = fitted(recording)
    with pytest.raises(InputError, match=r"not those of the result: give"):
        suspects(result, other)
    with pytest.raises(InputError, match=r"'offset' has no elements .*: name"):
        suspects(result, recording, each=["offset"])
    with pytest.raises(InputError, match=r"'wrong' has no elements .*: name"):
        suspects(result, recording, each=["wrong"])


def test_truth_is_not_where_the_fits_begin():
    assert TRUTH["amplitude"] != 1.5
    assert TRUTH["decay"] != 0.9


def test_responses_that_are_not_those_of_the_fit_are_noticed():
    """A part that is enabled at its neutral value must not change anything."""
    recording = recorded(offset=0.1)
    result = fitted(recording)
    (at,) = linearised(result, [recording], inquiry(result.model, list(result.free)))
    assert not is_disturbed(result, [recording], [at])
    random = np.random.default_rng(0).normal(size=at.predicted.shape)
    moved = dataclasses.replace(at, predicted=at.predicted + NOISE * random)
    assert is_disturbed(result, [recording], [moved])


class Three(Decay):
    """A decay without three of its parts; one is nearly the sum of the other two."""

    first: Scalar = parameter(0.0, unit="m", doc="a part")
    second: Scalar = parameter(0.0, unit="m", doc="a part")
    both: Scalar = parameter(0.0, unit="m", doc="both, and a bit")

    def predict(self, inputs, channels):
        height, fine = super().predict(inputs, channels)
        one, two, bit = (jnp.sin(k * inputs) for k in (2.0, 5.0, 9.0))
        moved = self.first * one + self.second * two + self.both * (one + two + 0.02 * bit)
        return {name: row + moved for name, row in height.items()}, fine


def told(**true):
    times = np.linspace(0.0, 4.0, 200)
    exact, _ = replace(Three(), true).predict(jnp.asarray(times), ("tip_z",))
    noise = NOISE * np.random.default_rng(2).normal(size=200)
    values = {"tip_z": np.asarray(exact["tip_z"]) + noise}
    free = {"free_motion": True}
    recording = Run.from_arrays(times, values, noise={"position": NOISE}, definition=free)
    result = fit(Three(), recording, free=FREE, start={"amplitude": 1.5}, check=False)
    return suspects(result, recording)


def test_what_data_cannot_tell_apart_is_told_as_one():
    found = told(both=0.05)
    assert found.promising[0].path == "both"
    # The others explain it only together.
    assert set(found.of("both").together) == {"first", "second"}
    assert found.of("first").explained_by == found.of("second").explained_by == "both"
    rows = suspect_rows(found, 1)
    assert [row[0] for row in rows] == ["both"]
    assert "first" in rows[0][-1]
    # One of them is the only cause, and explains the combined part as well.
    found = told(first=0.05)
    assert found.promising[0].path == "first"
    assert found.of("first").together == ()
    assert found.of("both").explained_by == "first"


def test_what_nothing_explains_is_said_and_drawn(tmp_path):
    recording = recorded()
    values = dict(recording.values)
    values["tip_x"] = values["tip_x"] + 3 * NOISE * np.sin(23 * recording.times)
    odd = dataclasses.replace(recording, values=values)
    asked = with_suspects(fitted(odd), odd)
    reason = asked.verdict.reasons[-1]
    assert reason.code == "unexplained"
    assert reason.size == pytest.approx(np.sqrt(1 + 9 / 2 / 3), rel=0.1)
    assert "left_over.png" in reason.sentence
    write_result(asked, odd, tmp_path)
    assert (tmp_path / "left_over.png").stat().st_size > 10_000
    # Suspects at the initial guess, such as axes, say nothing about the end of the fit.
    result = fitted(odd)
    found = suspects(result, odd)
    begun = dataclasses.replace(found.rows[-1], kind="axes", begun=True)
    with_axes = dataclasses.replace(found, rows=(*found.rows, begun))
    assert with_axes.judge(result).reasons[-1].code == "unexplained"
    # An effect that a suspect explains is not reported as unexplained.
    late = recorded(late=0.1)
    codes = [each.code for each in with_suspects(fitted(late), late).verdict.reasons]
    assert codes
    assert "unexplained" not in codes


@pytest.mark.quick
def test_a_wrong_model_is_no_exchange_of_points():
    """The model has two points in the wrong order; an exchange makes the recording itself jump."""
    times = np.linspace(0.0, 25.0, 251)
    names = ("link08_z", "tip_z")
    predicted = np.stack([times / 25, 1.5 * times / 25], axis=1)
    swapped = predicted + 1e-2 * np.sin(99 * times)[:, None]
    drifting = swapped - [0.0, 1.0] * np.clip(times / 10 - 1.5, 0, 1)[:, None]
    lost = swapped.copy()
    lost[200, 1] = 0.0  # a single cell that fits the other point is not an exchange
    both_lost = swapped.copy()
    both_lost[200] = 0.0
    swapped[150:] = swapped[150:, ::-1]
    named = ["points: link08 and tip exchanged"]
    for observed, said in (drifting, []), (lost, []), (both_lost, []), (swapped, named):
        recording = Run.from_arrays(
            times, dict(zip(names, observed.T, strict=True)), definition={"free_motion": True}
        )
        at = [Response(names, predicted, observed, predicted[..., None], predicted[..., None])]
        factors = [np.full(observed.shape, 100.0)]
        squares = chi_square_of(at, [predicted], factors)
        plain = types.SimpleNamespace(values=502, parameters=4)
        rows = points_row([recording], at, factors, squares, plain)
        assert [row.path for row in rows] == said


class Interrupted(Curve):
    """A curve whose variant sends Ctrl-C while it is tested."""

    def variants(self):
        return {
            "one": Stopping(**{f.name: getattr(self, f.name) for f in dataclasses.fields(self)})
        }


class Stopping(Curve):
    def predict(self, inputs, channels):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.5)  # the waiting thread receives the signal meanwhile
        return super().predict(inputs, channels)


@pytest.mark.parametrize("cores", ["1", "2"])
def test_ctrl_c_while_choices_are_looked_at_ends_it(cores, monkeypatch, request):
    monkeypatch.setenv("GIAJAX_CORES", cores)
    # A background process of a shell ignores Ctrl-C.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    request.addfinalizer(lambda: signal.signal(signal.SIGINT, before))
    recording = recorded(seed=7)
    model = replace(Interrupted(weights=jnp.ones(2)), TRUTH)
    result = fit(model, recording, free=FREE, check=False, noise_model="white")
    with pytest.raises(KeyboardInterrupt):
        suspects(result, recording)


class Fragile(Curve):
    """A curve that cannot be evaluated for an amplitude above 10."""

    def predict(self, inputs, channels):
        predicted, finite = super().predict(inputs, channels)
        return predicted, finite & (self.amplitude < 10)


def test_a_fit_that_went_astray_is_asked_where_it_began():
    recording = recorded(late=0.2)
    model = replace(Fragile(weights=jnp.ones(2)), TRUTH)
    begin = {"amplitude": 1.5, "decay": 0.9}
    options = {"noise_model": "white", "max_iterations": 1}
    result = fit(model, recording, free=FREE, start=begin, check=False, **options)
    assert result.status == "not_converged"
    away = {"amplitude": dataclasses.replace(result.parameters["amplitude"], value=11.0)}
    lost = dataclasses.replace(
        result,
        model=replace(result.model, {"amplitude": 11.0}),
        parameters={**result.parameters, **away},
    )
    found = suspects(lost, recording)
    first = found.significant[0]
    assert (first.path, first.begun, first.moves) == ("late", True, {})
    assert any("the initial values of the fit" in row[-1] for row in suspect_rows(found))
    # A fit that cannot be evaluated at its end is not judged by its remaining residuals.
    assert found.judge(lost).reasons == lost.verdict.reasons
    # The next fit starts at the initial guess.
    last = explain(lost, recording).result
    assert last.status == "converged"
    assert last.parameters["late"].value == pytest.approx(0.2, abs=0.05)
    # A converged fit reports where it cannot be evaluated.
    with pytest.raises(InputError, match="cannot be evaluated"):
        suspects(dataclasses.replace(lost, status="converged"), recording)
