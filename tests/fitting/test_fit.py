"""Fits of any model: recovery of true values, honest errors, masks, weights, several runs."""

import dataclasses
import json
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import giajax
from giajax import InputError, Run
from giajax.fitting import _checks, _fit, _loop, begin, fit, set_up, step, trial
from giajax.models import Integration
from giajax.report import summary
from toy_model import TRUTH, Decay, height, run

START = {"amplitude": 0.5, "decay": 3.0, "offset": -1.0}


def pulls(result):
    return {
        path: (estimate.value - TRUTH[path]) / estimate.standard_error
        for path, estimate in result.free.items()
    }


def test_the_truth_is_recovered_with_honest_errors():
    result = fit(Decay(), run(), start=START)
    assert result.status == "converged"
    assert max(abs(pull) for pull in pulls(result).values()) < 3
    assert result.reduced_chi_square == pytest.approx(1, abs=0.5)
    assert result.conditions == ("about amplitude", "about decay", "about offset")
    assert result.gradient_check.relative_difference < 1e-7
    assert [entry.number for entry in result.history] == list(range(result.iterations + 1))
    # Studies derive keys from the text of a result, in which 0 and 0.0 differ.
    bounds = [b for e in result.parameters.values() for b in (e.lower, e.upper) if b is not None]
    assert bounds
    assert all(type(bound) is float for bound in bounds)


def test_noise_that_nobody_stated_is_estimated():
    stated = fit(Decay(), run(sigma=0.05, samples=400))
    guessed = fit(Decay(), run(sigma=0.05, samples=400, state_noise=False))
    assert guessed.runs[0].channels["tip_z"].noise == pytest.approx(0.05, rel=0.1)
    for path in TRUTH:
        assert guessed.parameters[path].standard_error == pytest.approx(
            stated.parameters[path].standard_error, rel=0.15
        )
    assert "estimated" in guessed.message


def test_residuals_beyond_the_stated_noise_widen_the_errors():
    """At ten times the stated noise, the covariance is scaled and this is reported."""
    recording = run(sigma=0.1, samples=200)
    lying = Run.from_arrays(
        recording.times,
        recording.observations,
        noise={"position": 0.01},
        definition={"free_motion": True},
    )
    honest, scaled = fit(Decay(), recording), fit(Decay(), lying)
    assert scaled.reduced_chi_square == pytest.approx(100, rel=0.3)
    assert scaled.parameters["decay"].standard_error == pytest.approx(
        honest.parameters["decay"].standard_error, rel=0.1
    )
    assert "times the noise" in scaled.message


def test_missing_cells_do_not_count():
    full = run()
    values = np.array(full.observations["tip_z"])
    gaps = values.copy()
    gaps[10:30] = np.nan
    with_gaps = dataclasses.replace(full, values={"tip_z": gaps})
    kept = ~np.isnan(gaps)
    without = Run.from_arrays(
        full.times[kept],
        {"tip_z": values[kept]},
        noise={"position": 0.01},
        definition={"free_motion": True},
    )
    ours, theirs = fit(Decay(), with_gaps), fit(Decay(), without)
    assert ours.runs[0].channels["tip_z"].n == 40
    for path in TRUTH:
        assert ours.parameters[path].value == pytest.approx(theirs.parameters[path].value, rel=1e-6)


@pytest.mark.parametrize("loss", ["huber", "soft_l1"])
def test_robust_losses_survive_outliers(loss):
    full = run(samples=200)
    values = np.array(full.observations["tip_z"])
    values[::20] += 1.0
    spoiled = dataclasses.replace(full, values={"tip_z": values})
    robust = fit(Decay(), spoiled, loss=loss)
    plain = fit(Decay(), spoiled)
    assert abs(robust.parameters["offset"].value - 0.3) < 0.01
    assert abs(plain.parameters["offset"].value - 0.3) > 0.03
    assert max(abs(pull) for pull in pulls(robust).values()) < 4


def test_several_runs_of_several_lengths_are_one_fit():
    runs = [run(seed=1, samples=60), run(seed=2, samples=47)]
    together = fit(Decay(), runs)
    alone = [fit(Decay(), one).parameters["decay"] for one in runs]
    weights = np.array([1 / one.standard_error**2 for one in alone])
    mean = np.sum(weights * [one.value for one in alone]) / weights.sum()
    # The estimate of the joint fit differs from the weighted mean by a small fraction of its error.
    joint = together.parameters["decay"]
    assert joint.standard_error == pytest.approx(weights.sum() ** -0.5, rel=0.1)
    assert abs(joint.value - mean) < joint.standard_error
    assert [entry.channels["tip_z"].n for entry in together.runs] == [60, 47]
    for one, predicted in zip(runs, together.predictions, strict=True):
        values = {path: together.parameters[path].value for path in TRUTH}
        np.testing.assert_allclose(predicted["tip_z"], height(one.times, **values), rtol=1e-9)


def test_a_parameter_without_response_is_named_before_the_first_step():
    seen = []
    result = fit(Decay(), run(), free=["decay", "idle"], progress=seen.append)
    idle = result.parameters["idle"]
    assert "no channel responds" in idle.remark
    assert idle.value == 4.0
    assert idle.standard_error is None
    assert all(iteration.parameters["idle"] == 4.0 for iteration in seen)
    assert result.correlation.parameters == ("decay",)


def test_nothing_responds_is_no_convergence():
    result = fit(Decay(), run(), free=["idle"])
    assert result.status == "not_converged"
    assert "no channel responds" in result.message


def test_parameters_that_only_count_together_have_no_error_of_their_own():
    result = fit(Decay(), run(), free=["amplitude", "twin", "decay", "offset"], noise_model="white")
    for path, other in (("amplitude", "twin"), ("twin", "amplitude")):
        assert result.parameters[path].standard_error is None
        assert other in result.parameters[path].remark
    product = result.parameters["amplitude"].value * result.parameters["twin"].value
    assert product == pytest.approx(2.0, rel=0.02)
    alone = fit(Decay(), run(), noise_model="white")
    assert result.parameters["decay"].standard_error == pytest.approx(
        alone.parameters["decay"].standard_error, rel=1e-5
    )


def test_a_parameter_driven_against_its_bound_comes_back():
    """The first steps from this initial guess lead to a decay of zero; the optimum is at 0.7."""
    start = {"amplitude": 40.0, "decay": 1e-9, "offset": 5.0}
    result = fit(Decay(), run(), start=start)
    assert result.status == "converged"
    assert result.parameters["decay"].value == pytest.approx(0.7, rel=0.05)


@pytest.mark.parametrize("decay", [1e-10, 8 - 1e-9])
def test_a_start_at_a_bound_is_not_dead(decay):
    """At a bound, the slope of the coordinate vanishes, but the data depend on the parameter."""
    result = fit(Decay(), run(), start={"decay": decay})
    assert result.status == "converged"
    assert result.parameters["decay"].value == pytest.approx(0.7, rel=0.05)


def test_an_optimum_at_a_bound_has_an_error_and_says_so():
    """The data rise but the model can only fall, so zero decay is the best fit."""
    times = np.linspace(0.0, 4.0, 60)
    rising = 2.0 + 0.002 * times + np.random.default_rng(0).normal(scale=0.01, size=60)
    recording = Run.from_arrays(
        times,
        {"tip_z": rising},
        noise={"position": 0.01},
        definition={"free_motion": True},
    )
    result = fit(Decay(), recording, fix={"offset": 0.0}, noise_model="white")
    decay = result.parameters["decay"]
    assert result.status == "converged"
    assert result.iterations <= 20
    assert "at its lower bound" in decay.remark
    # Error of the rate in the linear model 2 - 2 decay t with two free coefficients.
    design = np.stack([np.ones(60), -2 * times], axis=1) / 0.01
    expected = np.sqrt(np.linalg.inv(design.T @ design)[1, 1])
    assert decay.standard_error == pytest.approx(expected, rel=0.2)
    assert decay.value < 0.1 * decay.standard_error


class Rough(Decay):
    """Predictions with rounding errors as in a simulation, which derivatives do not include."""

    def predict(self, inputs, channels):
        predicted, fine = super().predict(inputs, channels)
        rounding = {
            name: jax.lax.stop_gradient(1e-9 * jnp.sin(1e12 * values))
            for name, values in predicted.items()
        }
        return {name: values + rounding[name] for name, values in predicted.items()}, fine


def test_a_parameter_at_its_bound_takes_no_part_in_the_gradient_check():
    """Its coordinate is flat there, so an equal weight would leave no step for the others."""
    times = np.linspace(0.0, 4.0, 60)
    rising = 2.0 + 0.002 * times + np.random.default_rng(0).normal(scale=0.01, size=60)
    recording = Run.from_arrays(
        times, {"tip_z": rising}, noise={"position": 0.01}, definition={"free_motion": True}
    )
    result = fit(Rough(), recording, fix={"offset": 0.0})
    assert "at its lower bound" in result.parameters["decay"].remark
    check = result.gradient_check
    assert check.left_out == ("decay",)
    assert check.direction == {"amplitude": 1.0, "decay": 0.0}
    assert check.relative_difference < 1e-4
    assert "DISAGREE" not in summary(result)
    assert "without decay" in summary(result)


def test_a_gradient_check_sees_a_wrong_derivative():
    result = fit(Misled(), run(), max_iterations=3)
    assert result.gradient_check.relative_difference > 0.1
    assert "DISAGREE" in summary(result)


class Misled(Decay):
    """The derivative with respect to the decay is half of its correct value."""

    def predict(self, inputs, channels):
        slow = (self.decay + jax.lax.stop_gradient(self.decay)) / 2
        return super(Misled, dataclasses.replace(self, decay=slow)).predict(inputs, channels)


@pytest.mark.parametrize(("model", "wrong"), [(Decay, False), (Misled, True)])
def test_of_many_rows_the_gradient_is_checked_where_it_is_known(monkeypatch, model, wrong):
    """The check uses the tolerance of the fit and no further Jacobian, and finds wrong slopes."""
    refined, jacobians = [], []

    class Integrated(model):
        def integration(self):
            return Integration("exact", 1e-5)

        def with_integration(self, *, solver, tolerance):
            return self

        def refined(self, factor):
            refined.append(factor)
            return self

    def counted(*args, **options):
        jacobians.append(args)
        return evaluate(*args, **options)

    evaluate = _checks.evaluate
    monkeypatch.setattr("giajax.fitting._steps._MANY_ROWS", 10)
    monkeypatch.setattr(_checks, "evaluate", counted)
    check = fit(Integrated(), run(), max_iterations=3, tolerance=1e-5).gradient_check
    assert (check.relative_difference > 0.1) == wrong
    # The tolerance effect needs a finer tolerance, the gradient check does not.
    assert set(refined) == {0.1}
    assert not jacobians


def test_the_same_recording_twice_is_refused(tmp_path):
    giajax.write_run(tmp_path / "a.csv", run().times, run().values, definition=run().definition)
    for suffix in ("csv", "toml"):
        (tmp_path / f"b.{suffix}").write_bytes((tmp_path / f"a.{suffix}").read_bytes())
    runs = [giajax.read_run(tmp_path / name) for name in ("a.csv", "b.csv")]
    with pytest.raises(InputError, match="the same recording"):
        fit(Decay(), runs)


def test_fewer_values_than_parameters_are_refused():
    values = np.full(60, np.nan)
    values[[3, 20, 40]] = [1.0, 0.8, 0.6]
    sparse = dataclasses.replace(run(), values={"tip_z": values})
    with pytest.raises(InputError, match="3 measured values cannot determine 3 parameters"):
        fit(Decay(), sparse)


def test_noise_that_was_never_estimated_is_not_said_to_be():
    result = fit(Decay(), run(state_noise=False), start=START, max_iterations=1)
    assert "estimated from differences" in result.message
    assert "estimated from the residuals" not in result.message


def test_a_robust_loss_says_when_the_noise_is_understated():
    recording = run(sigma=0.1, samples=200)
    lying = Run.from_arrays(
        recording.times,
        recording.observations,
        noise={"position": 0.01},
        definition={"free_motion": True},
    )
    assert "times the noise" in fit(Decay(), lying, loss="huber").message


def test_a_failing_trial_is_not_the_end():
    result = fit(Decay(), run(), start={"decay": 7.99, "amplitude": 30.0})
    assert result.status == "converged"
    assert result.parameters["decay"].value == pytest.approx(0.7, rel=0.05)


def test_a_start_that_fails_is_bad_input():
    with pytest.raises(InputError, match="cannot be evaluated at the initial values"):
        fit(Decay(), run(), start={"decay": 8.5})


def test_what_is_fixed_does_not_move():
    result = fit(Decay(), run(), fix={"offset": 0.25})
    assert result.parameters["offset"].value == 0.25
    assert not result.parameters["offset"].free


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"free": ["amplitud"]}, "did you mean 'amplitude'"),
        ({"start": {"decay": 10.0}}, "between 0 and 9"),
        ({"start": {"decay": 0.0}}, "strictly between"),
        ({"fix": {"decay": -1.0}}, "outside its bounds"),
        (
            {"start": {"decay": 1.0}, "fix": {"decay": 1.0}},
            "both an initial value and a fixed value",
        ),
        ({"free": ["decay"], "fix": {"decay": 1.0}}, "both free and fixed"),
        ({"free": []}, "no parameter is free"),
        ({"loss": "l2"}, "fit.loss = 'l2' must be .*soft_l1"),
        ({"noise_model": "pink"}, 'must be "correlated" or "white"'),
        ({"lose": "huber"}, "did you mean fit.loss?"),
    ],
)
def test_wrong_questions_are_one_sentence(arguments, sentence):
    with pytest.raises(InputError, match=sentence):
        fit(Decay(), run(), **arguments)
    with pytest.raises(InputError, match=sentence):
        set_up(Decay(), [run()], **arguments)


def test_an_interrupted_fit_keeps_the_best():
    def interrupt(iteration):
        if iteration.number == 2:
            raise KeyboardInterrupt

    result = fit(Decay(), run(), start=START, progress=interrupt)
    assert result.status == "interrupted"
    assert result.cost < fit(Decay(), run(), start=START, max_iterations=1).cost
    assert result.gradient_check is None


def test_an_interrupted_check_keeps_the_others(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    whole = fit(Decay(), run(), start=START)
    monkeypatch.setattr(_checks, "_gradient_check", interrupted)
    result = fit(Decay(), run(), start=START)
    assert result.status == "interrupted"
    assert "then interrupted before the result was checked" in result.message
    assert (result.gradient_check, result.findings) == (None, whole.findings)
    assert result.tolerance_effect == whole.tolerance_effect


def test_an_interrupted_step_keeps_the_state_before_it(monkeypatch):
    step, seen = _loop.trial, []

    def interrupted(state):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(step(state))
        return seen[-1]

    monkeypatch.setattr(_loop, "trial", interrupted)
    result = fit(Decay(), run(), start=START)
    assert (result.status, result.iterations) == ("interrupted", 2)
    assert result.cost == seen[-1].cost
    values = {path: estimate.value for path, estimate in result.free.items()}
    assert values == seen[-1].parameters()


def test_a_transition_leaves_the_state_that_it_was_given():
    begun = begin(set_up(Decay(), run(), start={"amplitude": 1.5, "decay": 1.0}))
    first = step(begun)
    assert not begun.evaluated
    before = (first.cost, first.parameters(), first.history)
    second = trial(first)
    assert second.cost < first.cost
    assert (first.cost, first.parameters(), first.history) == before
    assert (len(second.history), second.trials) == (1, 1)


def test_a_solver_is_refused_by_a_model_without_one():
    for settings in ({"solver": "tsit5"}, {"tolerance": 1e-9}):
        with pytest.raises(InputError, match="decay model has neither a solver nor a tolerance: "):
            fit(Decay(), run(), **settings)


def test_too_few_iterations_is_no_convergence():
    result = fit(Decay(), run(), start=START, max_iterations=1)
    assert result.status == "not_converged"
    assert result.iterations == 1


def test_the_result_is_json_without_nan():
    record = json.loads(fit(Decay(), run(), free=["decay", "idle"]).to_json())
    assert record["model"] == "decay"
    assert record["parameters"]["idle"]["standard_error"] is None
    assert record["parameters"]["amplitude"]["free"] is False
    assert record["config"]["free"] == ["decay", "idle"]


class Counted(Decay):
    """Count how often the model is traced, once for each compiled program."""

    traces: ClassVar[list[str]] = []

    def predict(self, inputs, channels):
        self.traces.append("traced")
        return super().predict(inputs, channels)


def test_the_same_fit_compiles_once():
    first = fit(Counted(), run())
    traced = len(Counted.traces)
    assert traced > 0
    again = fit(Counted(), run(seed=9))
    assert again.parameters["decay"].value != first.parameters["decay"].value
    assert len(Counted.traces) == traced


def test_32_bit_is_warned_once(monkeypatch):
    monkeypatch.setattr(_fit, "_warned", False)
    monkeypatch.setattr(jax.config, "read", lambda name: False)
    with pytest.warns(UserWarning, match="32-bit"):
        _fit._warn_once_in_32_bit()
    _fit._warn_once_in_32_bit()  # a second warning would be an error here


def test_the_public_name_is_the_function():
    assert giajax.fit is fit
