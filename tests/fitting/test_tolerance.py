"""A fit chooses the integrator tolerance from its effect and from the roughness of the cost."""

import dataclasses
import functools
import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from test_journal import HEAD

import giajax
from giajax.fitting import fit, set_up, solve, state_at_end
from giajax.models import ArmModel, Integration
from giajax.recordings import hold_out
from giajax.studies import refit
from giajax.tasks import JOURNAL, Journal, read_journal
from small_arm import NOISE, START, small_run
from toy_model import TRUTH, Decay, run

BEGIN = {"amplitude": 0.5, "decay": 3.0}


def _number(value):
    return jnp.asarray(value, jnp.result_type(float))


class Approximate(Decay):
    """A decay with two errors that are proportional to the tolerance.

    Attributes:
        tolerance: tolerance; None lets the fit choose it.
        bias: relative error of the rate, divided by the tolerance.
        roughness: size of jumps without derivatives, divided by the tolerance, m.
    """

    tolerance: jax.Array | None = eqx.field(
        default=None, converter=lambda x: None if x is None else _number(x)
    )
    bias: jax.Array = eqx.field(default=0.0, converter=_number)
    roughness: jax.Array = eqx.field(default=0.0, converter=_number)

    def integration(self):
        return Integration("exact", None if self.tolerance is None else float(self.tolerance))

    def with_integration(self, *, solver, tolerance):
        if tolerance is None:
            return self
        return dataclasses.replace(self, tolerance=tolerance)

    def refined(self, factor):
        return dataclasses.replace(self, tolerance=self.tolerance * factor)

    def predict(self, inputs, channels):
        inexact = dataclasses.replace(self, decay=self.decay * (1 + self.bias * self.tolerance))
        values, successful = Decay.predict(inexact, inputs, channels)
        # Jumps like those of steps that appear and disappear when the parameters change.
        place = 1e7 * jax.lax.stop_gradient(self.decay + self.amplitude)
        jumps = self.roughness * self.tolerance * jnp.sin(jnp.floor(place) + 40.0 * inputs)
        return {name: value + jumps for name, value in values.items()}, successful


@functools.cache
def exact():
    """Return the fit without any error."""
    return fit(Decay(), run(), start=BEGIN)


def off(result, reference):
    """Return the largest difference of an estimate from a reference, in standard errors."""
    pairs = [(result.parameters[path], reference.parameters[path]) for path in TRUTH]
    return max(abs(one.value - other.value) / other.standard_error for one, other in pairs)


def test_it_is_the_coarsest_that_moves_nothing_by_much():
    coarse = fit(Approximate(bias=1.0), run(), start=BEGIN)
    assert (coarse.integration.tolerance, coarse.integration.chosen) == (1e-5, True)
    finer = fit(Approximate(bias=300.0), run(), start=BEGIN)
    assert finer.integration.tolerance < 2e-6
    for result in (coarse, finer):
        assert result.status == "converged"
        assert result.tolerance_effect.factor == 0.01
        assert result.tolerance_effect.largest_in_standard_errors < 0.002
        assert off(result, exact()) < 0.01
    # For comparison, the result with the coarsest tolerance.
    stated = fit(Approximate(bias=300.0), run(), start=BEGIN, tolerance=1e-5)
    assert stated.tolerance_effect.largest_in_standard_errors > 0.01 < off(stated, exact())
    assert (stated.integration.tolerance, stated.integration.chosen) == (1e-5, False)


def test_what_a_tenth_leaves_is_known_without_a_finer_simulation():
    """1e-5 is slightly too coarse at the optimum; the final tolerance is compared once."""
    compared = []

    class Counted(Approximate):
        def refined(self, factor):
            compared.append(float(self.tolerance))
            return super().refined(factor)

    result = fit(Counted(bias=2.0), run(), start=BEGIN, check=False)
    assert result.status == "converged"
    assert compared == pytest.approx([1e-5, 1e-5, 1e-5 / np.sqrt(10)])
    assert result.integration.tolerance == compared[-1]
    assert off(result, exact()) < 0.01


@pytest.mark.parametrize("bias", [2.0, 8.0])
def test_an_optimum_follows_its_tolerance_without_a_step(bias):
    result = fit(Approximate(bias=bias), run(), start=BEGIN, check=False)
    assert result.status == "converged"
    assert result.integration.tolerance < 1e-5
    *_, before, last = result.history
    # The same iteration with another tolerance.
    assert before.number == last.number == result.iterations
    assert last.parameters == {path: result.parameters[path].value for path in last.parameters}
    assert last.parameters != before.parameters
    assert off(result, exact()) < 0.01


def test_an_optimum_at_a_bound_stays_there():
    held = {"start": BEGIN, "bounds": {"amplitude": (0.0, 0.6)}, "check": False}
    result = fit(Approximate(bias=30.0), run(), **held)
    assert result.integration.tolerance < 1e-5
    assert result.parameters["amplitude"].value == pytest.approx(0.6)
    reference = fit(Decay(), run(), **held)
    one, other = (each.parameters["decay"] for each in (result, reference))
    assert abs(one.value - other.value) < 0.01 * other.standard_error


def test_many_rows_ask_for_less_and_say_the_same(monkeypatch):
    few = fit(Approximate(bias=8.0), run(), start=BEGIN)
    monkeypatch.setattr("giajax.fitting._steps._MANY_ROWS", 5)
    many = fit(Approximate(bias=8.0), run(), start=BEGIN)
    assert off(many, few) < 0.005
    # The fits start at 3e-6 and 1e-5, which differ by nearly one step of a root of ten.
    assert many.integration.tolerance == pytest.approx(few.integration.tolerance, rel=0.06)
    assert (few.tolerance_effect.factor, many.tolerance_effect.factor) == (0.01, 0.1)
    assert few.gradient_check.relative_difference < 1e-6
    assert many.gradient_check.relative_difference < 1e-3
    assert [each.code for each in many.findings] == [each.code for each in few.findings]


def test_a_fit_of_many_rows_begins_at_a_finer_tolerance(monkeypatch):
    few = fit(Approximate(bias=1.0), run(), start=BEGIN)
    monkeypatch.setattr("giajax.fitting._steps._MANY_ROWS", 5)
    many = fit(Approximate(bias=1.0), run(), start=BEGIN)
    assert (few.integration.tolerance, many.integration.tolerance) == (1e-5, 3e-6)


def test_a_refit_and_what_is_held_out_have_a_tolerance_that_suits_them():
    recorded, settings = run(), {"start": BEGIN}
    (part,) = hold_out([recorded], ["last"])
    result = solve(set_up(Approximate(bias=300.0), part.fitted, **settings), check=False)
    assert result.integration.tolerance < 2e-6
    whole = set_up(Approximate(bias=300.0), recorded, **settings)
    assert state_at_end(result, whole, [part]).tolerance == result.integration.tolerance
    again = refit(result, [recorded])
    assert again.integration == result.integration
    assert again.config["tolerance"] is None
    # A tolerance that suffices for the first fit may be too coarse for the next.
    coarse = fit(Approximate(bias=1.0), recorded, start=BEGIN)
    worse = dataclasses.replace(coarse.model, bias=_number(300.0))
    assert refit(coarse, [recorded], model=worse).integration.tolerance < 2e-6


def test_the_last_steps_keep_to_the_limits_of_the_fit():
    free = fit(Approximate(bias=300.0), run(), start=BEGIN, check=False)
    most = free.iterations
    ends = [
        fit(Approximate(bias=300.0), run(), start=BEGIN, check=False, max_iterations=count)
        for count in range(1, most)
    ]
    assert [each.iterations for each in ends] == list(range(1, most))
    # An optimum is reported even if a closer step could still be tried.
    assert {each.status for each in ends} == {"converged", "not_converged"}


def test_a_finer_simulation_that_fails_has_no_effect_that_is_known():
    class Failing(Approximate):
        def predict(self, inputs, channels):
            values, successful = super().predict(inputs, channels)
            enough = self.tolerance > 9e-6
            values = {name: jnp.where(enough, row, jnp.nan) for name, row in values.items()}
            return values, successful & enough

    result = fit(Failing(bias=1.0), run(), start=BEGIN)
    assert result.status == "converged"
    assert result.tolerance_effect is None


def test_a_cost_that_is_too_rough_to_descend_gets_a_finer_one():
    # The parameters cannot imitate the roughness, so it does not bias the estimates.
    stuck = fit(Approximate(roughness=3e3), run(), start=BEGIN, tolerance=1e-5)
    assert stuck.status == "not_converged"
    result = fit(Approximate(roughness=3e3), run(), start=BEGIN)
    assert result.status == "converged"
    assert result.integration.tolerance < 2e-6
    assert off(result, exact()) < 0.01


@pytest.mark.parametrize("error", [{"bias": 300.0}, {"roughness": 3e3}])
def test_from_any_line_of_a_journal_to_the_same_end(tmp_path, error):
    def journalled():
        journal = read_journal(tmp_path) or Journal(tmp_path / JOURNAL, HEAD)
        setup = set_up(Approximate(**error), run(), start=BEGIN)
        result = json.loads(solve(setup, journal=journal.of(1), check=False).to_json())
        journal.close()
        return {key: result[key] for key in ("parameters", "integration", "history")}

    whole = journalled()
    lines = (tmp_path / JOURNAL).read_bytes().splitlines(keepends=True)
    assert json.loads(lines[-1])["tolerance"] == whole["integration"]["tolerance"] < 2e-6
    for count in (2, len(lines) // 2, len(lines) - 1, len(lines)):
        (tmp_path / JOURNAL).write_bytes(b"".join(lines[:count]))
        assert journalled() == whole, count


def test_a_model_without_an_integrator_knows_nothing_of_it():
    result = exact()
    assert result.integration is None
    assert json.loads(result.to_json())["integration"] is None


@pytest.mark.slow
def test_an_arm_is_fitted_to_what_its_noise_asks_for(tmp_path, compiled):
    recorded = small_run(tmp_path)
    result = fit(giajax.model_for([recorded]), recorded, start=START, check=False)
    assert (result.status, result.integration.chosen) == ("converged", True)
    assert result.integration.solver == "springs5"
    before = compiled()
    ends = {path: each.value for path, each in result.free.items()}
    reference = fit(result.model, recorded, start=ends, tolerance=1e-10, check=False)
    # Other tolerances, including those tried by the choice, are only other inputs of one program.
    assert compiled() - before <= 2
    for path, each in reference.free.items():
        assert abs(result.parameters[path].value - each.value) < 0.01 * each.standard_error
    # With a hundredth of the noise, the same tolerance has a hundred times the effect.
    quiet = giajax.Run.from_arrays(
        recorded.times,
        {**recorded.commands, **_with_less_noise(result, recorded, 0.01)},
        definition={"arm": {"links": 4}, "noise": {"position_m": 0.01 * NOISE}},
    )
    finer = fit(ArmModel(result.model.arm), quiet, start=START)
    assert finer.status == "converged"
    assert finer.integration.tolerance < 0.5 * result.integration.tolerance
    assert finer.tolerance_effect.largest_in_standard_errors < 0.002
    path = tmp_path / "result.json"
    path.write_text(finer.to_json())
    loaded = giajax.load_result(path)
    assert float(loaded.model.tolerance) == finer.integration.tolerance == finer.model.tolerance
    assert loaded.integration == finer.integration


def _with_less_noise(result, recorded, part):
    """Return the recording with only a part of the residuals of a fit."""
    predicted = result.predict(recorded)
    return {
        name: predicted[name] + part * (row - predicted[name])
        for name, row in recorded.observations.items()
    }


def test_what_is_stated_stays():
    times = np.linspace(0.0, 1.0, 20)
    columns = {"joint01_command": np.minimum(times, 0.3), "link02_z": np.zeros(20)}
    recorded = giajax.Run.from_arrays(times, columns, definition={"arm": {"links": 4}})
    stated = set_up(giajax.model_for([recorded]), recorded, start=START, tolerance=1e-8)
    assert not stated.chooses_tolerance
    assert stated.config["tolerance"] == 1e-8
    left_open = set_up(giajax.model_for([recorded]), recorded, start=START, solver="tsit5")
    assert left_open.chooses_tolerance
    assert (left_open.config["solver"], left_open.config["tolerance"]) == ("tsit5", None)
    assert float(stated.model.refined(0.1).tolerance) == pytest.approx(1e-9)
