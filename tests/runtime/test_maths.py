"""Vectors and quaternions, compared with NumPy and scipy, and their critical derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from giajax.runtime import arrays as _maths

RANDOM = np.random.default_rng(0)
A, B = RANDOM.normal(size=(2, 3, 5))


def quaternions(rotation):
    return jnp.asarray(rotation.as_quat(scalar_first=True).T)


def test_products_are_those_of_numpy():
    assert_allclose(_maths.dot(jnp.asarray(A), jnp.asarray(B)), (A * B).sum(axis=0), rtol=1e-14)
    expected = np.cross(A, B, axis=0)
    assert_allclose(_maths.cross(jnp.asarray(A), jnp.asarray(B)), expected, atol=1e-15)
    factor = RANDOM.normal(size=5)
    assert_allclose(_maths.scaled(jnp.asarray(factor), jnp.asarray(A)), factor * A, rtol=1e-15)


def test_safe_norm_is_the_norm():
    assert_allclose(_maths.safe_norm(jnp.asarray(A)), np.linalg.norm(A, axis=0), rtol=1e-15)


@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev])
def test_safe_norm_times_its_vector_has_the_derivative_zero_at_rest(transform):
    def drag(v):
        return _maths.safe_norm(v) * v

    assert_allclose(jax.jit(transform(drag))(jnp.zeros(3)), np.zeros((3, 3)), atol=0)
    # d(|v| v)/dv = |v| I + v v' / |v|
    v = jnp.array([1.0, -2.0, 2.0])
    expected = 3.0 * np.eye(3) + np.outer(v, v) / 3.0
    assert_allclose(transform(drag)(v), expected, rtol=1e-14)


def test_safe_norm_of_a_batch_is_safe_for_its_zero_rows_only():
    rows = jnp.asarray(np.stack([[0.0, 0.0, 0.0], [3.0, 0.0, 4.0]], axis=1))
    gradient = jax.grad(lambda x: _maths.safe_norm(x).sum())(rows)
    assert_allclose(gradient, np.stack([[0.0, 0.0, 0.0], [0.6, 0.0, 0.8]], axis=1), rtol=1e-15)


def test_quaternions_compose_and_turn_as_rotations_do():
    first, second = Rotation.random(5, rng=3), Rotation.random(5, rng=4)
    product = _maths.quaternion_product(quaternions(first), quaternions(second))
    composed = Rotation.from_quat(np.array(product).T, scalar_first=True)
    assert_allclose(composed.as_matrix(), (first * second).as_matrix(), atol=1e-14)
    turned = _maths.rotate(quaternions(first), jnp.asarray(A))
    assert_allclose(turned, first.apply(A.T).T, atol=1e-14)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-4, 1.0, 3.0])
def test_a_rotation_vector_turns_by_its_length_about_itself(size):
    vector = size * np.array([2.0, -1.0, 2.0]) / 3.0
    quaternion = _maths.rotation_vector_to_quaternion(jnp.asarray(vector))
    expected = Rotation.from_rotvec(vector).as_quat(scalar_first=True)
    assert_allclose(quaternion, expected, rtol=1e-14, atol=1e-24)


@pytest.mark.parametrize("transform", [jax.jacfwd, jax.jacrev])
def test_no_rotation_still_has_a_derivative(transform):
    derivative = transform(_maths.rotation_vector_to_quaternion)(jnp.zeros(3))
    # To first order, q = (cos(|r|/2), r sin(|r|/2)/|r|) = (1, r/2).
    assert_allclose(derivative, np.vstack([np.zeros(3), np.eye(3) / 2]), atol=1e-16)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("size", [1, 20, 70])
@pytest.mark.parametrize("more", [1, 7])
def test_a_factor_and_a_solution_come_out_of_one_factorisation(dtype, size, more):
    """Also for a large right-hand side, within a batch, and from the lower triangle alone."""
    random = np.random.default_rng(0)
    root = random.normal(size=(size, size)) + 2 * np.sqrt(size) * np.eye(size)
    matrix = (root @ root.T).astype(dtype)
    for b in random.normal(size=(3, size)) * np.array([[1.0], [1e6], [1e-6]]):
        lower = jnp.asarray(np.tril(matrix))
        rows = np.concatenate([random.normal(size=(more - 1, size)), b[None]])
        factor, half = _maths.factor_with_rows(lower, jnp.asarray(rows, dtype))
        solution = _maths.solve_upper(factor, half[-1:].T)[:, 0]
        assert factor.dtype == solution.dtype == dtype
        rounding = 200 * size * np.finfo(dtype).eps
        assert_allclose(factor @ factor.T, matrix, rtol=0, atol=rounding * np.abs(matrix).max())
        expected = np.linalg.solve(matrix.astype(float), b)
        assert_allclose(solution, expected, rtol=0, atol=rounding * np.abs(expected).max())


def test_what_has_no_factor_has_no_solution():
    factor, half = _maths.factor_with_rows(-jnp.eye(3), jnp.ones((1, 3)))
    assert np.all(np.isnan(factor[np.tril_indices(3)]))
    assert np.all(np.isnan(half))
    assert np.all(np.isnan(_maths.factor_with_rows(jnp.eye(3), jnp.full((1, 3), jnp.nan))[1]))


def test_a_choice_has_the_derivative_of_what_was_chosen():
    x, low, high = jnp.asarray([-2.0, -1.0, 0.3, 1.0, 2.0]), -1.0, 1.0
    choices = {
        "larger": (lambda x: _maths.larger(x, low), jnp.maximum(x, low), [0, 1, 1, 1, 1]),
        "smaller": (lambda x: _maths.smaller(x, high), jnp.minimum(x, high), [1, 1, 1, 1, 0]),
        "limited": (
            lambda x: _maths.limited(x, low, high),
            jnp.clip(x, low, high),
            [0, 1, 1, 1, 0],
        ),
    }
    for name, (of, values, slopes) in choices.items():
        found, slope = jax.jvp(of, (x,), (jnp.ones_like(x),))
        assert_allclose(found, values, rtol=0, err_msg=name)
        assert_allclose(slope, slopes, rtol=0, err_msg=name)
    nothing = jnp.asarray(jnp.nan)
    assert jnp.isnan(_maths.limited(nothing, low, high))
    assert jnp.isnan(_maths.larger(jnp.ones(2), nothing)).all()
    assert jnp.isnan(_maths.smaller(jnp.ones(2), nothing)).all()
    assert jnp.isnan(_maths.limited(jnp.ones(2), nothing, nothing)).all()


def test_a_derivative_does_not_depend_on_how_a_compiler_rounds():
    # The derivative of `jnp.hypot` is 0 at some of these points, where the compiler computes a
    # coordinate twice, once with a fused multiply-add.
    angle = jnp.linspace(0.1, 3, 97)

    def distance(angle):
        cosine, sine = jnp.cos(angle / 2), jnp.sin(angle / 2)
        return _maths.hypotenuse(0.9 * cosine - 0.2 * sine, 0.3 * sine + 0.1 * cosine)

    def slope(angle):
        return jax.jvp(distance, (angle,), (jnp.ones_like(angle),))[1]

    difference = (distance(angle + 1e-6) - distance(angle - 1e-6)) / 2e-6
    assert_allclose(jax.jit(slope)(angle), difference, rtol=1e-8, atol=1e-9)
