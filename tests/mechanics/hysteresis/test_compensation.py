"""Compensation: eq. (12) and its limits, and inverses by bisection."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from giajax import InputError
from giajax.mechanics.hysteresis import (
    BoucWen,
    BranchCompensator,
    InverseByBisection,
    MonotoneCurve,
    Play,
    PrandtlIshlinskii,
    Preisach,
    branches_from_loop,
    history_by_steps,
    isotonic,
)


def compensator(travel=0.5):
    x = jnp.linspace(-3.0, 3.0, 7)
    return BranchCompensator(
        rising=MonotoneCurve(x, x + 0.4), falling=MonotoneCurve(x, x - 0.2), travel=travel
    )


def test_away_from_reversals_it_is_one_branch():
    it = compensator()
    up, down = jnp.linspace(-2.0, 2.0, 81), jnp.linspace(2.0, -2.0, 81)
    commands, memory = it.history(up)
    np.testing.assert_allclose(commands[20:], up[20:] + 0.4, atol=1e-14)
    commands, _ = it.history(down, memory)
    np.testing.assert_allclose(commands[11:], down[11:] - 0.2, atol=1e-14)


def test_xi_is_a_stop_between_0_and_1():
    it = compensator(travel=0.6)
    turns = [0, 1, -1, 0.2, 0.0, 0.1, -0.4, 0.5]
    wanted = jnp.asarray(np.interp(np.linspace(0, 7, 701), np.arange(8), turns))
    xi = np.asarray(it.transition(wanted))
    assert xi.min() == pytest.approx(0, abs=1e-15)
    assert xi.max() == pytest.approx(1, abs=1e-15)
    # The slope is at most that of the desired angle, so the result is continuous at reversals.
    steps = np.abs(np.diff(np.asarray(wanted)))
    assert np.all(np.abs(np.diff(xi)) <= steps / 0.6 + 1e-12)
    # The result is 1 exactly when the travel since the reversal at -1 is complete.
    since = np.asarray(wanted[200:300]) + 1
    assert np.all((xi[200:300] > 1 - 1e-12) == (since > 0.6 - 1e-12))


def test_it_is_eq_12():
    it = compensator(travel=0.6)
    wanted = jnp.asarray(np.interp(np.linspace(0, 3, 301), np.arange(4), [0, 1, -1, 0.2]))
    xi = it.transition(wanted)
    expected = xi * it.rising(wanted) + (1 - xi) * it.falling(wanted)
    np.testing.assert_allclose(it.history(wanted)[0], expected, atol=1e-14)
    stepped = history_by_steps(it, wanted, None)[0]
    np.testing.assert_allclose(stepped, expected, atol=1e-14)


def test_it_undoes_a_backlash_on_its_own_loop():
    """A play has one pair of branches, and beyond the travel eq. (12) is its inverse."""
    backlash = Play(thresholds=[0.3])
    turns = np.interp(np.linspace(0, 3, 601), np.arange(4), [0, 2, -2, 2])
    outputs = np.asarray(backlash.history(jnp.asarray(turns))[0][:, 0])
    it = branches_from_loop(turns[200:], outputs[200:], travel=0.1)
    low, high = it.reachable
    assert (low, high) == pytest.approx((-1.7, 1.7), abs=0.02)
    wanted = jnp.asarray(np.interp(np.linspace(0, 3, 601), np.arange(4), [0, 1.5, -1.5, 1.5]))
    found = backlash.history(it.history(wanted)[0])[0][:, 0]
    xi = np.asarray(it.transition(wanted))
    away = np.minimum(xi, 1 - xi) < 1e-12
    assert away.mean() > 0.8
    assert np.max(np.abs(found - wanted)[away]) < 0.02


def test_it_is_differentiable():
    it, wanted = compensator(), jnp.linspace(-1.0, 1.0, 21)

    def total(travel):
        return jnp.sum(BranchCompensator(it.rising, it.falling, travel).history(wanted)[0] ** 2)

    travel = jnp.asarray(0.55)
    slope = float(jax.grad(total)(travel))
    difference = float(total(travel + 1e-6) - total(travel - 1e-6)) / 2e-6
    assert slope == pytest.approx(difference, rel=1e-6)
    assert abs(slope) > 0.01


def test_isotonic_regression():
    assert isotonic(np.asarray([1.0, 3.0, 2.0, 4.0])).tolist() == [1.0, 2.5, 2.5, 4.0]
    noisy = np.linspace(0, 1, 200) + np.random.default_rng(0).normal(scale=0.1, size=200)
    found = isotonic(noisy)
    assert np.all(np.diff(found) >= 0)
    assert np.mean(found) == pytest.approx(np.mean(noisy))
    # The result is the nearest monotone sequence, so no farther away than the noise-free line.
    assert np.sum((found - noisy) ** 2) <= np.sum((np.linspace(0, 1, 200) - noisy) ** 2)


def test_a_loop_without_branches_is_refused():
    up = np.linspace(0, 1, 30)
    with pytest.raises(InputError, match="falling branch of the loop has 0 measured samples"):
        branches_from_loop(up, up, travel=0.1)
    back = np.concatenate([up, up[::-1]])
    missing = np.where(np.arange(60) < 28, np.nan, back)
    with pytest.raises(InputError, match="rising branch of the loop has 3"):
        branches_from_loop(back, missing, travel=0.1)
    for travel in (0.0, -1.0, np.inf):
        with pytest.raises(InputError, match="positive travel"):
            branches_from_loop(back, back, travel=travel)


@pytest.mark.slow
@pytest.mark.parametrize(
    "operator",
    [
        PrandtlIshlinskii(elastic=0.4, weights=[0.3, 0.2], thresholds=[0.2, 0.7]),
        Preisach(
            slope=0.3,
            saturation=0.8,
            coercivity=0.3,
            coercivity_spread=0.5,
            bias=0.1,
            interaction=0.4,
            extent=2.1,
            rows=20,
        ),
        BoucWen(elastic=0.3, alpha=0.8, beta=1.0, gamma=0.9, delta=0.1),
    ],
    ids=["prandtl_ishlinskii", "preisach", "bouc_wen"],
)
def test_bisection_inverts_any_rising_operator(operator):
    turns = np.random.default_rng(1).uniform(-0.6, 0.6, 12)
    wanted = jnp.asarray(np.interp(np.linspace(0, 11, 150), np.arange(12), turns))
    command, _ = InverseByBisection(operator, -2.0, 2.0).history(wanted)
    found, _ = operator.history(command)
    np.testing.assert_allclose(found, wanted, atol=1e-12)
    if isinstance(operator, PrandtlIshlinskii):
        # The two inverses are implemented independently.
        np.testing.assert_allclose(command, operator.inverse().history(wanted)[0], atol=1e-12)


def test_a_narrow_knee_is_inverted_over_its_whole_range():
    """A few Runge-Kutta steps over the range would be unstable."""
    operator = BoucWen(elastic=0.3, alpha=0.8, beta=20.0, gamma=0.8, delta=0.2)
    with np.errstate(all="ignore"):
        blown = operator.step(operator.reset(), jnp.asarray(2.0))[1]
    assert not abs(float(blown)) < 2
    fine = operator.for_moves_of(2.0)
    turns = np.asarray([0.0, 0.3, -0.3, 0.2, -0.1, 0.25])
    wanted = jnp.asarray(np.interp(np.linspace(0, 5, 101), np.arange(6), turns))
    command, _ = InverseByBisection(fine, -1.0, 1.0).history(wanted)
    np.testing.assert_allclose(fine.history(command)[0], wanted, atol=1e-9)
    finest = BoucWen(0.3, 0.8, 20.0, 0.8, 0.2, substeps=2000)
    np.testing.assert_allclose(finest.history(command)[0], wanted, atol=1e-4)


@pytest.mark.slow
def test_a_bisected_input_has_the_derivative_of_the_inverse():
    turns = np.asarray([0.0, 0.5, -0.4, 0.3])
    wanted = jnp.asarray(np.interp(np.linspace(0, 3, 40), np.arange(4), turns))

    def command(slope, scale):
        operator = Preisach(slope, 0.8, 0.3, 0.5, 0.1, 0.4, extent=2.1, rows=20)
        return jnp.sum(InverseByBisection(operator, -2.0, 2.0).history(scale * wanted)[0] ** 2)

    at, step = (jnp.asarray(0.3), jnp.asarray(1.0)), 1e-6
    for number, gradient in enumerate(jax.grad(command, (0, 1))(*at)):
        ends = [
            command(*[x + sign * step * (k == number) for k, x in enumerate(at)])
            for sign in (1, -1)
        ]
        assert abs(float(gradient)) > 0.1
        assert float(gradient) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)
    forward = jax.jvp(lambda s: command(s, at[1]), at[:1], (jnp.asarray(1.0),))[1]
    assert float(forward) == pytest.approx(float(jax.grad(command)(*at)), rel=1e-10)


def test_a_falling_loop_is_refused():
    there = np.concatenate([np.linspace(-1, 1, 30), np.linspace(1, -1, 30)])
    with pytest.raises(InputError, match="decreases where the input increases: change the sign"):
        branches_from_loop(there, -there, travel=0.1)
