"""A good fit ends soon, and a fit that cannot succeed ends with the reason."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.fitting import Iteration, begin, descend, fit, residuals_at, set_up, step, stopped_by
from giajax.recordings import Run
from small_pendulum import Pendulum, start, swing
from toy_model import Decay, run

TIMES = np.linspace(0.0, 4.0, 60)


def recording(values):
    """Return a run with values that no exponential can produce."""
    return Run.from_arrays(
        TIMES, {"tip_z": values}, noise={"position": 0.01}, definition={"free_motion": True}
    )


def end_of(recorded, **asked):
    """Return how a fit of the toy model ends, without checks afterwards."""
    return descend(begin(set_up(Decay(), recorded, noise_model="white", **asked)), 50, None)


@pytest.mark.parametrize("loss", ["linear", "huber"])
def test_a_parameter_whose_optimum_is_zero_ends_on_its_bound(loss):
    falling = recording(-0.5 * np.exp(-0.7 * TIMES) + 0.3)
    state = end_of(falling, free=["amplitude", "offset"], loss=loss, fix={"decay": 0.7})
    assert state.ending[::2] == ("converged", "optimum")
    assert state.parameters()["amplitude"] == 0
    # A robust loss is flat if all cells are far off.
    assert state.trials <= {"linear": 5, "huber": 22}[loss]


def test_a_value_at_its_upper_bound_is_not_beyond_it_by_rounding():
    """The true decay is 0.7; each bound gives another map with other rounding."""
    for upper in (0.3, 0.45, 0.6):
        state = end_of(run(), start={"decay": 0.2}, bounds={"decay": (0.0, upper)})
        assert state.ending[2] == "optimum"
        assert 0 <= upper - state.parameters()["decay"] < 1e-12


def test_a_fit_from_far_off_takes_few_steps_with_a_robust_loss_too():
    for loss in ("linear", "huber", "soft_l1"):
        state = end_of(run(), start={"amplitude": 0.2, "decay": 4.0, "offset": 1.0}, loss=loss)
        assert state.ending[::2] == ("converged", "optimum")
        assert state.trials <= 15, loss


def after(factors, recorded=None, *, accepted=True, sound=True, **start):
    """Return the reason that stops a fit whose costs are these factors times that of a start."""
    setup = set_up(Decay(), run() if recorded is None else recorded, start=start)
    state = step(begin(setup))
    history = tuple(
        Iteration(number, factor * state.cost, 0.1, accepted, {})
        for number, factor in enumerate(factors)
    )
    inner = eqx.tree_at(lambda inner: inner.finite, state.inner, jnp.asarray(sound))
    state = dataclasses.replace(state, inner=inner, history=history, done=False, converged=False)
    stopped = stopped_by(state)
    # After a change of noise or tolerance, the earlier costs do not count.
    assert stopped_by(dataclasses.replace(state, round_began=len(history))) is None
    return stopped and stopped[0]


def test_what_stops_a_fit_is_told_from_its_last_steps():
    near, off = {"amplitude": 1.9, "decay": 0.8}, {"amplitude": 0.2, "decay": 4.0, "offset": 1.0}
    falling, still = 0.9 ** np.arange(-19.0, 1.0), 1 + 1e-6 * np.arange(20.0)[::-1]
    assert after(falling, **near) is None
    assert after(still[-8:], **near) is None
    assert after(still, **near) == "crawl"
    assert after(still, sound=False, **near) == "wall"
    assert after(still[-9:], accepted=False, **near) == "rough"
    assert after(still[-9:], accepted=False, sound=False, **near) == "wall"
    # Worse than a constant, and slow.
    assert after(still, **off) == "cannot_fit"
    assert after(falling, **off) is None
    # If a constant would fit, the criterion does not require the fit to be that slow.
    flat = recording(np.random.default_rng(2).normal(scale=0.01, size=60))
    assert after(falling, flat, **near) == "cannot_fit"
    assert after(0.5 ** np.arange(-19.0, 1.0), flat, **near) is None


@pytest.mark.parametrize("level", [25.0, 60.0])
def test_a_far_start_of_what_is_constant_is_on_its_way(level):
    """Without bounds, a parameter takes as many steps of maximum length as it needs."""
    noise = np.random.default_rng(3).normal(scale=0.01, size=60)
    state = end_of(recording(level + noise), free=["offset"], fix={"amplitude": 1e-3})
    assert state.ending[::2] == ("converged", "optimum")
    assert abs(state.parameters()["offset"] - level) < 0.01


def test_states_of_single_runs_may_be_what_crawls():
    state = step(begin(set_up(Pendulum(), swing(seconds=6.0), free=[])))
    costs = state.cost * (1 + 1e-9 * np.arange(20.0)[::-1])
    history = tuple(Iteration(number, cost, 0.1, True, {}) for number, cost in enumerate(costs))
    reason, sentence = stopped_by(dataclasses.replace(state, history=history, done=False))
    assert reason == "crawl"
    assert "the states of individual runs" in sentence


def test_derivatives_are_not_checked_beyond_a_bound():
    """The amplitude is many standard errors, but less than a finite difference, from its bound."""
    noise = np.random.default_rng(4).normal(scale=1e-6, size=60)
    run = Run.from_arrays(
        TIMES,
        {"tip_z": 5e-6 * np.exp(-0.7 * TIMES) + 0.3 + noise},
        noise={"position": 1e-6},
        definition={"free_motion": True},
    )
    result = fit(Decay(), run, free=["amplitude", "offset"], fix={"decay": 0.7})
    assert result.parameters["amplitude"].value == pytest.approx(5e-6, rel=0.5)
    assert "amplitude" in result.gradient_check.left_out
    assert result.gradient_check.relative_difference < 1e-6


def test_a_wall_is_named():
    """The model fails for a decay above 8, but the data require a larger one."""
    fast = recording(2 * np.exp(-30 * TIMES))
    result = fit(Decay(), fast, free=["decay"], start={"decay": 7.9}, fix={"offset": 0.0})
    assert result.status == "not_converged"
    assert result.reason == "wall"
    assert result.iterations <= 30


def test_steps_that_are_used_up_are_a_reason():
    result = fit(Decay(), run(), max_iterations=1, check=False)
    assert (result.status, result.reason) == ("not_converged", "iterations")


def test_residuals_without_derivatives_are_the_same():
    """If a step takes long, the residuals have a separate program without derivatives."""
    quick = step(begin(set_up(Decay(), run(), free=["amplitude", "decay"])))
    long = dataclasses.replace(quick, step_seconds=(9.0, 1.0))
    there = quick.problem.bijector.inverse(np.array([1.5, 0.9]))
    assert_allclose(residuals_at(long, there), residuals_at(quick, there), rtol=1e-12)
    # The model fails for a decay above 8.
    fails = quick.problem.bijector.inverse(np.array([1.5, 8.5]))
    for state in (quick, long):
        assert np.all(np.isnan(residuals_at(state, fails)))


@pytest.mark.slow
def test_a_pendulum_with_friction_air_and_no_damping_is_fitted_from_every_side():
    """Three corners of the sixteen; a robust loss takes as many iterations."""
    runs = swing(seconds=30.0, seed=5)
    for loss in ("linear", "huber"):
        costs = []
        for corner in ((1, 1, 1, 1), (-1, 1, -1, -1), (1, -1, -1, 1)):
            setup = set_up(Pendulum(), runs, start=start(corner), loss=loss, noise_model="white")
            state = descend(begin(setup), 50, None)
            assert state.ending[::2] == ("converged", "optimum")
            assert state.trials <= 25
            assert state.parameters()["damping"] == 0
            costs.append(state.cost)
        assert_allclose(costs, costs[0], rtol=1e-5)
