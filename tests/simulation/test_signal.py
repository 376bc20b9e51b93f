"""Inputs over time: their values compared with NumPy, merged rows, and invalid inputs."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from giajax.runtime.text import InputError
from giajax.simulation import (
    constant,
    joint_ramps,
    joint_steps,
    lagged,
    last_before,
    logged,
    ramps,
    steps,
)

RANDOM = np.random.default_rng(0)


def evaluate(signal, times):
    return np.asarray(jax.jit(jax.vmap(signal))(jnp.asarray(times)))


def a_log(rows, width=3):
    times = np.cumsum(RANDOM.uniform(0.05, 0.2, rows))
    return times, RANDOM.normal(size=(rows, width))


@pytest.mark.parametrize("rows", [1, 2, 30, 700])
def test_ramps_are_numpys_interp(rows):
    """For more than some hundred knots, another search for the knot is used."""
    times, values = a_log(rows)
    wanted = np.concatenate([np.linspace(times[0] - 1, times[-1] + 1, 400), times])
    expected = np.stack([np.interp(wanted, times, column) for column in values.T], axis=1)
    assert_allclose(evaluate(ramps(times, values), wanted), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("rows", [1, 2, 30, 700])
def test_steps_hold_each_row_from_its_time_on(rows):
    times, values = a_log(rows)
    wanted = np.concatenate([np.linspace(times[0] - 1, times[-1] + 1, 400), times])
    row = np.maximum(np.searchsorted(times, wanted, side="right") - 1, 0)
    assert_array_equal(evaluate(steps(times, values), wanted), values[row])


def test_a_constant_is_the_same_at_all_times():
    signal = constant([0.1, 0.2, 0.3])
    assert signal.width == 3
    assert_array_equal(evaluate(signal, [-5.0, 0.0, 1e6]), [[0.1, 0.2, 0.3]] * 3)
    assert constant(2.0).width == 1


def test_interpolation_is_chosen_by_name():
    times, values = [0.0, 1.0, 2.0], [[0.0], [1.0], [0.0]]
    assert_allclose(evaluate(logged(times, values, "zoh"), [0.5, 1.0, 1.5]), [[0.0], [1.0], [1.0]])
    assert_allclose(evaluate(logged(times, values), [0.5, 1.0, 1.5]), [[0.5], [1.0], [0.5]])
    with pytest.raises(InputError, match="'cubic' is unknown: use 'zoh' or 'linear'"):
        logged(times, values, "cubic")


@pytest.mark.parametrize("make", [steps, ramps])
def test_what_lags_is_what_an_integrator_makes_of_it(make):
    """lag dy/dt = u - y, integrated piece by piece from rest."""
    times, values = a_log(12)
    lags = np.asarray([0.3, 0.05, 2.0])
    signal = make(times, values)
    wanted = np.linspace(times[0] - 1, times[-1] + 1, 301)
    expected, state = np.repeat(values[:1], 301, axis=0), values[0]
    slopes = np.asarray(signal.slopes)
    for k, (begin, end) in enumerate(pairwise([*np.asarray(signal.times), times[-1] + 1])):
        first = np.asarray(signal.values)[k]
        inside = (begin <= wanted) & (wanted <= end)
        at = np.unique([*wanted[inside], end])
        found = solve_ivp(
            lambda t, y, k=k, first=first, begin=begin: (
                (first + slopes[k] * (t - begin) - y) / lags
            ),
            (begin, end), state, t_eval=at, method="DOP853", rtol=1e-11, atol=1e-12,
        )  # fmt: skip
        expected[inside], state = found.y.T[: inside.sum()], found.y[:, -1]
    assert_allclose(evaluate(lagged(signal, jnp.asarray(lags)), wanted), expected, atol=1e-8)
    one = evaluate(lagged(signal, jnp.asarray(lags[0])), wanted)
    assert_allclose(one[:, 0], expected[:, 0], atol=1e-8)


def test_without_a_lag_a_signal_is_itself():
    signal = ramps(*a_log(30))
    wanted = np.linspace(-1.0, float(signal.times[-1]) + 1, 200)
    assert lagged(signal, None) is signal
    exact = evaluate(signal, wanted)
    assert_allclose(evaluate(lagged(signal, jnp.zeros(())), wanted), exact, atol=1e-14)
    # The remaining difference is proportional to the lag.
    for lag in (1e-3, 1e-6, 1e-300):
        late = evaluate(lagged(signal, jnp.asarray(lag)), wanted)
        assert np.abs(late - exact).max() < 200 * lag + 1e-14


@pytest.mark.parametrize("lag", [0.0, 1e-14, 1e-9, 0.2])
def test_derivatives_by_a_lag_are_those_of_differences(lag):
    """At a lag of 0, the one-sided derivative; forward, in reverse and under vmap."""
    signal = ramps([0.5, 1.0, 1.7, 3.0], [[0.0, 0.2], [1.0, 0.0], [0.3, 0.4], [0.3, 0.4]])
    wanted = jnp.linspace(0.0, 4.0, 37)[:-1] + 0.01

    def values(lags):
        return jax.vmap(lagged(signal, lags))(wanted)

    lags = jnp.asarray([lag, 2 * lag])

    def slopes(lags):
        return jax.vmap(jax.jacfwd(lagged(signal, lags)))(wanted)

    # The derivative with respect to time is the rate of the output.
    forward, reverse, slope = (
        np.asarray(jax.jit(function)(lags))
        for function in (jax.jacfwd(values), jax.jacrev(values), slopes)
    )
    values = jax.jit(values)
    assert_allclose(reverse, forward, rtol=1e-12, atol=1e-13)
    h = 1e-7
    steps_up = np.stack([values(lags + h * unit) for unit in np.eye(2)], axis=-1)
    if lag > h:
        steps_up = (steps_up - np.stack([values(lags - h * e) for e in np.eye(2)], axis=-1)) / 2
    else:
        steps_up = steps_up - np.asarray(values(lags))[..., None]
    assert_allclose(forward, steps_up / h, atol=2e-6)
    assert np.abs(forward).max() > 0.5
    late = evaluate(signal, wanted) - np.asarray(values(lags))
    assert_allclose(slope * lags[None], late, atol=1e-12)


def test_a_step_and_a_ramp_by_joint():
    step = joint_steps(3, {2: 0.5}, time=0.5)
    expected = [[0, 0, 0], [0, 0, 0], [0, 0.5, 0], [0, 0.5, 0]]
    assert_array_equal(evaluate(step, [-9.0, 0.4999, 0.5, 9.0]), expected)
    early = joint_steps(3, {1: 0.5}, time=-2.0)
    assert_array_equal(evaluate(early, [-2.001, -2.0, 0.0])[:, 0], [0.0, 0.5, 0.5])
    ramp = joint_ramps(3, {1: 0.4, 3: -0.2}, start=0.5, duration=2.0)
    expected = [[0, 0, 0], [0, 0, 0], [0.2, 0, -0.1], [0.4, 0, -0.2], [0.4, 0, -0.2]]
    assert_allclose(evaluate(ramp, [0.0, 0.5, 1.5, 2.5, 9.0]), expected, atol=1e-15)


@pytest.mark.parametrize("joint", [0, 4])
def test_a_joint_that_the_arm_has_not_is_refused(joint):
    for make in (joint_steps, joint_ramps):
        with pytest.raises(
            InputError, match=f"joint {joint} is not a joint of the arm: give a number from 1 to 3"
        ):
            make(3, {joint: 0.5})


@pytest.mark.parametrize("duration", [0.0, -1.0, np.nan])
def test_a_ramp_takes_time(duration):
    with pytest.raises(InputError, match="positive duration, or use joint_steps"):
        joint_ramps(3, {1: 0.5}, duration=duration)


@pytest.mark.parametrize(
    ("times", "values", "sentence"),
    [
        ([0.0, 1.0], [1.0, 2.0], "the shapes \\(row,\\) and \\(row, width\\)"),
        ([0.0], [[1.0], [2.0]], "have shapes \\(1,\\) and \\(2, 1\\)"),
        ([], np.zeros((0, 2)), "have shapes \\(0,\\)"),
        ([0.0, 0.0], [[1.0], [2.0]], "do not increase strictly"),
        ([1.0, 0.0], [[1.0], [2.0]], "do not increase strictly"),
        ([0.0, np.nan], [[1.0], [2.0]], "are not finite"),
        ([0.0, 1.0], [[1.0], [np.inf]], "are not finite"),
    ],
)
@pytest.mark.parametrize("make", [steps, ramps])
def test_rows_that_make_no_signal_are_refused(make, times, values, sentence):
    with pytest.raises(InputError, match=sentence):
        make(times, values)


def a_ramp(rate, digits=None):
    """Return a 25 s log of the benchmark's command, in degrees as in a recording."""
    times = np.arange(0, 25 + 0.5 / rate, 1 / rate)
    values = np.interp(times, [0.5, 1.5], [0.0, 40 / 3])[:, None]
    return times, values if digits is None else np.round(values, digits)


@pytest.mark.parametrize("rate", [10, 100])
@pytest.mark.parametrize("digits", [None, 6, 4])
def test_rows_on_a_line_are_merged(rate, digits):
    """This includes rows that were rounded as in a file, such as 13.3333."""
    times, values = a_ramp(rate, digits)
    signal = ramps(times, values)
    assert_allclose(signal.times, [0.0, 0.5, 1.5, 25.0], atol=1e-12)
    expected = np.interp(times, [0.5, 1.5], [0.0, 40 / 3])[:, None]
    assert_allclose(evaluate(signal, times), expected, atol=1e-4)


def test_corners_that_count_are_kept():
    times = np.arange(0, 10, 0.1)
    bend = np.where(times < 5, times, 5 + 1.01 * (times - 5))[:, None]
    assert_allclose(ramps(times, bend).times, [0.0, 5.0, 9.9], atol=1e-12)


def test_what_is_merged_stays_within_the_tolerance():
    times = np.sort(RANDOM.uniform(0, 10, 300))
    values = np.stack([np.sin(times), np.cos(3 * times)], axis=1)
    for tolerance in (1e-1, 1e-2, 1e-3):
        signal = ramps(times, values, tolerance=tolerance)
        assert 2 < len(signal.times) < 300
        assert np.abs(evaluate(signal, times) - values).max() <= tolerance * (1 + 1e-9)


def corner_times(signal, tolerance):
    """Return the times of knots that no step may cross; steps may cross all others."""
    corners, bends = (np.asarray(part) for part in signal.corners(jnp.asarray(tolerance)))
    assert_array_equal(np.isinf(corners), ~np.isinf(bends))
    assert_array_equal(np.minimum(corners, bends), signal.times)
    return corners[np.isfinite(corners)]


ROWS = np.arange(0, 20.01, 0.02)


def waving(times):
    return np.stack([0.3 * np.sin(0.5 * times), 0.1 * np.cos(0.3 * times)], axis=1)


def test_rows_of_a_wave_are_no_corners_to_a_tolerance_that_cannot_see_them():
    signal = ramps(ROWS, waving(ROWS), tolerance=0)
    counts = [len(corner_times(signal, tolerance)) for tolerance in (1e-4, 1e-5, 1e-8)]
    assert counts[0] < counts[1] < len(ROWS) / 10
    assert counts[2] == len(ROWS)


def test_between_two_corners_a_signal_is_a_cubic_to_within_twenty_tolerances():
    signal = ramps(ROWS, waving(ROWS) + np.exp(-(((ROWS - 9) / 0.3) ** 2))[:, None])
    times, values = np.asarray(signal.times), np.asarray(signal.values)
    corners = corner_times(signal, 1e-4)
    assert np.ptp(np.diff(corners)) > 1
    for begin, end in pairwise(corners):
        row = (times >= begin) & (times <= end)
        if row.sum() > 4:
            x = times[row] - times[row].mean()
            fitted = np.vander(x, 4) @ np.linalg.lstsq(np.vander(x, 4), values[row])[0]
            assert np.abs(values[row] - fitted).max() <= 2e-3 * np.abs(values).max()


@pytest.mark.parametrize(
    ("feature", "around"),
    [
        (lambda t: 0.1 * np.clip((t - 7) / 2, 0, 1), (7.0, 9.0)),
        (lambda t: 0.003 * ((t > 9.99) & (t < 10.05)), (9.98, 10.06)),
        (lambda t: 0.01 * np.exp(-(((t - 10) / 0.1) ** 2)), (9.8, 10.2)),
    ],
    ids=["ramp", "blip", "pulse"],
)
def test_what_a_long_step_might_miss_is_between_corners(feature, around):
    """The ends of a ramp, and a narrow feature, even if its rows are smooth."""
    signal = ramps(ROWS, waving(ROWS) + feature(ROWS)[:, None], tolerance=0)
    corners = corner_times(signal, 1e-5)
    assert len(corners) < len(ROWS) / 5
    for time in around:
        assert np.abs(corners - time).min() < 0.05
    inside = corners[(corners > around[0] - 0.05) & (corners < around[1] + 0.05)]
    assert len(inside) >= 4 or around == (7.0, 9.0)


def test_jumps_are_corners_at_any_tolerance():
    assert len(corner_times(steps(ROWS, waving(ROWS)), 1.0)) == len(ROWS)
    assert len(corner_times(constant([1.0]), 1.0)) == 1


def test_repeated_rows_of_a_step_are_merged():
    times = np.arange(100) / 10
    values = np.where(times < 3, 0.0, 0.5)[:, None]
    assert_array_equal(steps(times, values).times, [0.0, times[times >= 3][0]])
    assert len(ramps(times, np.zeros((100, 2))).times) == 2


def test_a_signal_is_strongly_typed_and_has_a_derivative():
    signal = ramps([0, 1], [[0, 0], [1, 3]])
    for leaf in jax.tree.leaves(signal):
        assert leaf.dtype == jnp.float64
        assert not leaf.weak_type
    slope = jax.jacfwd(signal)(jnp.asarray(0.25))
    assert_allclose(slope, [1.0, 3.0])


@pytest.mark.parametrize("count", [1, 512, 513, 1000, 4999])
def test_the_knot_before_a_time_is_that_of_a_search_however_many_there_are(count):
    """For many knots, a subset is compared first; the last ones are infinite."""
    knots = np.sort(RANDOM.uniform(0, 10, count))
    knots[count - count // 7 :] = np.inf
    finite = knots[np.isfinite(knots)]
    asked = np.concatenate([finite, np.nextafter(finite, -1), RANDOM.uniform(-1, 11, 50)])
    expected = np.maximum(np.searchsorted(knots, asked, side="right") - 1, 0)
    found = jax.vmap(last_before, in_axes=(None, 0))(jnp.asarray(knots), jnp.asarray(asked))
    assert_array_equal(found, expected)
