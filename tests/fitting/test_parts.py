"""Bijectors, noise and identifiability, each compared with known results."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from giajax.fitting import (
    Bijector,
    BlockJacobian,
    Linear,
    between,
    responds,
    uncertainty,
    undetermined_groups,
)
from giajax.noise import from_differences, robust_deviation

INF = float("inf")
BOUNDS = Bijector.of((0.0, -INF, -2.0, -INF), (INF, 3.0, 5.0, INF), (0.2, 1.0, 4.0, 0.0))
INSIDE = np.array([1e-3, -40.0, 4.9, -7.0])


def test_a_bijector_comes_back():
    np.testing.assert_allclose(BOUNDS.forward(jnp.asarray(BOUNDS.inverse(INSIDE))), INSIDE)


def test_rounding_leads_nothing_beyond_a_bound():
    """The slope at the bound equals that of the map."""
    starts = np.linspace(0.05, 0.95, 200)
    for upper in (1.0, 9.0, 50.0, 0.3):
        bijector = Bijector.of([0.0] * 200, [upper] * 200, upper * starts)
        last = np.asarray(bijector.last)
        assert np.all(bijector.forward(last) <= upper)
        value, slope = jax.jvp(bijector.forward, (bijector.last,), (jnp.ones(200),))
        assert np.all(np.asarray(value) <= upper)
        np.testing.assert_allclose(slope, bijector.slope(last), rtol=1e-9)


def test_a_bijector_has_its_bounds_at_its_ends_and_increases_between_them():
    lower, upper = BOUNDS.ends()
    assert np.asarray(lower).tolist()[1::2] == [-INF, -INF]
    for ends, bounds in ((lower, BOUNDS.lower), (upper, BOUNDS.upper)):
        known = np.isfinite(bounds)
        values = np.asarray(BOUNDS.forward(jnp.where(known, ends, 0)))
        # A value may differ from its bound by rounding, which `FitState.values` corrects.
        np.testing.assert_allclose(values[known], np.asarray(bounds)[known], rtol=1e-15)
    # Rounding must not make a non-negative parameter negative.
    assert BOUNDS.forward(jnp.zeros(4))[0] == 0
    slopes = jax.jacfwd(BOUNDS.forward)(jnp.asarray(BOUNDS.inverse(INSIDE)))
    np.testing.assert_allclose(np.diag(slopes), BOUNDS.slope(BOUNDS.inverse(INSIDE)), rtol=1e-12)
    assert np.all(np.diag(slopes) > 0)


def test_a_coordinate_is_linear_near_its_bound_and_a_logarithm_far_from_it():
    at = lambda value: BOUNDS.inverse(np.array([value, 0.0, 0.0, 0.0]))[0]  # noqa: E731
    np.testing.assert_allclose(at(2e-6), 2 * at(1e-6), rtol=1e-4)
    np.testing.assert_allclose(at(2e6) - at(1e6), np.log(2), rtol=1e-4)


def test_the_map_of_a_start_on_its_bound_has_a_size_all_the_same():
    there = Bijector.of((0.0, 0.0), (INF, 0.5), (0.0, 0.5))
    assert np.all(np.isfinite(there.slope(there.inverse(np.array([0.0, 0.5])))))


def test_noise_is_seen_through_the_motion():
    rng = np.random.default_rng(0)
    times = np.linspace(0.0, 25.0, 501)
    values = np.sin(times) + rng.normal(scale=0.02, size=times.size)
    values[rng.random(times.size) < 0.1] = np.nan
    values[40] = 50.0  # an outlier
    assert from_differences(values) == pytest.approx(0.02, rel=0.15)
    assert from_differences(np.linspace(0.0, 2.0, 50)) == pytest.approx(1.8e-3)
    assert from_differences(np.zeros(5)) > 0


def test_robust_noise_is_not_moved_by_an_outlier():
    residuals = np.array([1.0, -1.0, 1.0, -1.0, 1e3])
    assert robust_deviation(residuals) == pytest.approx(1.4826)


def test_dead_and_collinear_columns_are_named():
    rng = np.random.default_rng(0)
    jacobian = rng.normal(size=(50, 4))
    jacobian[:, 1] = 0
    np.testing.assert_array_equal(
        responds(np.linalg.norm(jacobian, axis=0), np.ones(4)), [True, False, True, True]
    )
    jacobian[:, 1] = 3 * jacobian[:, 3] - jacobian[:, 0]
    assert undetermined_groups(jacobian) == [[0, 1, 3]]
    assert undetermined_groups(jacobian[:, [0, 1, 2]]) == []


def spread(residual, jacobian, **options):
    """Return `uncertainty` of a dense Jacobian, for all of its columns."""
    columns = np.arange(jacobian.shape[1])
    return uncertainty(residual, BlockJacobian.dense(jacobian), columns=columns, **options)


def test_a_null_space_of_two_dimensions_leaves_the_rest_its_error():
    """Beside three twins, a parameter has the same error as in a fit without two of them."""
    rng = np.random.default_rng(5)
    twin, own = rng.normal(size=(2, 40))
    own += 0.5 * twin
    residual, measured = rng.normal(size=40), np.ones(40, bool)
    loose = np.stack([twin, 2 * twin, own, -3 * twin], axis=1)
    plain = np.stack([twin, own], axis=1)
    many = spread(residual, loose, loss=Linear(), measured=measured)
    few = spread(residual, plain, loss=Linear(), measured=measured)
    scale = few.scale / many.scale  # other degrees of freedom
    assert many.covariance[2, 2] * scale == pytest.approx(few.covariance[1, 1], rel=1e-10)
    assert sorted({i for group in undetermined_groups(loose) for i in group}) == [0, 1, 3]


@pytest.mark.quick
def test_a_start_on_a_bound_is_moved_inside_by_a_margin():
    assert between(0.4, 0.0, 1.0) == 0.4
    assert between(-3.0, 0.0, 1.0, margin=0.01) == 0.01
    assert between(3.0, 0.0, 1.0, margin=0.01) == 0.99
    assert between(5.0, 5.0, INF, margin=0.5) == 5.5
    assert between(9.0, -INF, 5.0, margin=0.5) == 4.5
    assert between(-7.0, -INF, INF, margin=0.5) == -7.0
    # Without a margin, the result is still strictly inside, and away from 0 it has a logarithm.
    for lower, upper in ((0.0, INF), (5.0, INF), (-INF, 5.0), (-1.0, 1e-12), (2.0, 3.0)):
        for value in (lower, upper):
            if np.isfinite(value):
                assert lower < between(value, lower, upper) < upper
    assert np.isfinite(np.log(between(0.0, 0.0, INF)))
