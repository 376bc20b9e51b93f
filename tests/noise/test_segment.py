"""Recursions over the cells, compared with dense matrices."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.fitting import Whitening
from giajax.noise import ChannelNoise, gains, whitened
from giajax.noise._restricted import solve

NOISE = ChannelNoise(white=0.7, correlated=1.3, time_s=2.0)


def cells(count=30, seed=0):
    """Return uneven times with a gap, weights with outliers, and some columns."""
    rng = np.random.default_rng(seed)
    times = np.sort(rng.uniform(0, 10, count))
    times[count // 2 :] += 15.0
    return times, rng.uniform(0.1, 1, count), rng.normal(size=(count, 3))


def covariance(noise, times, weights):
    memory = np.exp(-np.abs(times[:, None] - times) / noise.time_s)
    return np.diag(noise.white**2 / weights) + noise.correlated**2 * memory


@pytest.mark.parametrize(
    "noise", [NOISE, ChannelNoise(0.0, 0.4, 0.1), ChannelNoise(3.0, 1.0, 90.0)]
)
def test_the_inverse_is_that_of_the_covariance(noise):
    times, weights, columns = cells()
    dense = covariance(noise, times, weights)
    solved, log_determinant = solve(noise, times, weights, columns)
    assert_allclose(solved, np.linalg.solve(dense, columns), rtol=1e-8, atol=1e-9)
    assert log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-10)


@pytest.mark.quick
@pytest.mark.parametrize("count", [0, 1, 2])
def test_a_channel_may_have_a_cell_or_two(count):
    times, weights, columns = (each[:count] for each in cells())
    solved, log_determinant = solve(NOISE, times, weights, columns)
    dense = covariance(NOISE, times, weights)
    assert_allclose(solved, np.linalg.solve(dense, columns), rtol=1e-12)
    assert log_determinant == pytest.approx(np.linalg.slogdet(dense)[1], rel=1e-12)


@pytest.mark.quick
def test_whitened_cells_are_independent():
    times, weights, columns = cells()
    dense = covariance(NOISE, times, weights)
    white = whitened(NOISE, times, columns, weights)
    assert_allclose(white.T @ white, columns.T @ np.linalg.solve(dense, columns), rtol=1e-10)
    _, _, deviation = gains(NOISE, times, weights)
    assert 2 * np.sum(np.log(deviation)) == pytest.approx(np.linalg.slogdet(dense)[1])


def test_a_cell_that_is_not_measured_is_as_if_it_were_not_there():
    times, weights, columns = cells()
    there = np.ones(len(times), bool)
    there[[3, 4, 17]] = False
    gappy = Whitening.of({"x": NOISE}, times, {"x": np.where(there, weights, 0.0)})
    over_deviation = np.where(there[:, None], columns / NOISE.deviation, 0.0)
    made = np.asarray(gappy.apply(over_deviation))
    assert_allclose(made[~there], 0.0)
    expected = whitened(NOISE, times[there], columns[there], weights[there])
    assert_allclose(made[there], expected, atol=1e-12)


def test_whitening_is_undone():
    times, weights, columns = cells()
    noise = {"x": NOISE, "y": ChannelNoise(0.5)}
    measured = {"x": np.where(weights > 0.3, weights, 0.0), "y": np.ones(len(times))}
    both = Whitening.of(noise, times, measured)
    rows = np.stack([columns, columns[::-1]], axis=1)
    rows[measured["x"] == 0, 0] = 0.0
    rows = rows.reshape(-1, 3)
    assert_allclose(both.undone(np.asarray(both.apply(rows))), rows, atol=1e-12)


def test_white_noise_costs_no_pass():
    times, _, columns = cells()
    idle = Whitening.of({"x": ChannelNoise(2.0)}, times, {"x": np.ones(len(times))})
    assert_allclose(idle.apply(columns), columns, rtol=0, atol=0)
