"""Logged commands: steps may cross rows that are not corners, within their tolerance."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import ramps, simulate
from peers.scipy_chain import ScipyChain

ARM = takeichi_20m(3)
COARSE = {"solver": "springs5", "rtol": 1e-4, "atol": 1e-4}


def stopped(command):
    """Return the same signal, but no step may cross any of its rows."""
    rough = jnp.full_like(command.roughness, jnp.inf)
    return eqx.tree_at(lambda signal: signal.roughness, command, rough)


def padded(command, knots):
    """Return the same signal with its last knot repeated, so one compiled program serves all."""
    last = jax.tree.map(lambda x: x[-1:], stopped(command))
    more = knots - command.times.shape[0]
    return jax.tree.map(lambda x, end: jnp.concatenate([x, *[end] * more]), command, last)


@pytest.mark.slow
def test_steps_go_over_rows_of_a_smooth_command_within_their_tolerance():
    """There are a third fewer steps at the same accuracy, and rounding does not change them."""
    times = np.linspace(0.0, 5.0, 51)
    command = ramps(times, 0.3 * (1 - np.cos(0.3 * times))[:, None] * np.array([1.0, 0.5, 0.0]))
    crossing = simulate(ARM, command, times, **COARSE)
    at_each = simulate(ARM, stopped(command), times, **COARSE)
    assert 3 * int(crossing.steps.sum()) < 2 * int(at_each.steps.sum())
    exact = ScipyChain(ARM, command).trajectory(times)[:, 0]
    assert_allclose(crossing.angles, exact, rtol=0, atol=5e-5)
    heavier = replace(ARM, {"links.mass": ARM.links.mass * (1 + 1e-14)})
    moved = simulate(heavier, command, times, **COARSE)
    assert_array_equal(moved.steps, crossing.steps)
    assert_allclose(moved.angles, crossing.angles, rtol=0, atol=1e-11)


def wave(times):
    return 0.3 * np.sin(2 * np.pi * times / 41) + 0.2 * np.sin(2 * np.pi * times / 17)


def kinks(times):
    """Return ramps between holds, with a small wave and a pulse that is narrower than a step."""
    knots = np.sort(np.r_[np.arange(0.0, 600.0, 30.0), np.arange(1.5, 600.0, 30.0)])
    ramped = np.interp(times, knots, 0.3 * np.tile([0.0, 1.0, 1.0, 0.0], 10))
    return 0.2 * wave(times) + ramped + 0.05 * (np.abs(times - 295.2) < 0.15)


@pytest.mark.slow
@pytest.mark.parametrize("log", [wave, kinks])
def test_ten_minutes_of_rows_are_as_exact_as_their_tolerance(log):
    """With and without corners, compared with another method whose steps end at each row."""
    rows = np.arange(0.0, 600.0, 0.1)
    values = log(rows)[:, None] * np.array([1.0, 0.3, 0.0])
    command = padded(ramps(rows, values, tolerance=0), len(rows))
    times = np.linspace(0.0, 599.0, 1198)
    exact = simulate(ARM, stopped(command), times, solver="dopri8", rtol=1e-9, atol=1e-9)
    crossing = simulate(ARM, command, times, **COARSE)
    assert_allclose(crossing.angles, exact.angles, rtol=0, atol=3e-4)
    assert int(crossing.steps.sum()) < 0.6 * len(rows)
