"""A subexpression that is computed separately gives the same result in every transformation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.runtime.arrays import computed_once, derivative_barrier

X, DIRECTIONS = np.random.default_rng(0).normal(size=(2, 3, 20))


def force(x):
    return derivative_barrier(jnp.sin(x)) * jnp.cos(x)


def test_values_and_derivatives_are_those_without():
    assert_allclose(jax.jit(force)(X), np.sin(X) * np.cos(X), rtol=1e-15)
    assert_allclose(force(jnp.asarray(X)), np.sin(X) * np.cos(X), rtol=1e-15)
    assert_allclose(computed_once(jnp.asarray(X)), X, rtol=0)
    slope = np.cos(2 * X)
    forward = jax.jit(lambda x, t: jax.jvp(force, (x,), (t,))[1])(X, DIRECTIONS)
    assert_allclose(forward, slope * DIRECTIONS, rtol=1e-13)
    assert_allclose(jax.jit(jax.grad(lambda x: force(x).sum()))(X), slope, rtol=1e-13)
    second = jax.jit(lambda x: jax.jvp(jax.grad(lambda x: force(x).sum()), (x,), (x,))[1])(X)
    assert_allclose(second, -2 * np.sin(2 * X) * X, rtol=1e-12)


@pytest.mark.parametrize("count", [1, 4, 100])
def test_of_many_directions_at_once_too(count):
    directions = jnp.stack([DIRECTIONS] * count, axis=1)
    many = jax.vmap(lambda t: jax.jvp(force, (X,), (t,))[1], in_axes=1, out_axes=1)
    expected = np.stack([np.cos(2 * X) * DIRECTIONS] * count, axis=1)
    assert_allclose(jax.jit(many)(directions), expected, rtol=1e-13)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="elsewhere nothing is kept apart")
def test_derivatives_are_a_kernel_of_their_own_and_values_are_not():
    def kernels(function, *args):
        return jax.jit(function).lower(*args).compile().as_text().count('small_call="true"')

    assert kernels(force, X) == 0
    assert kernels(lambda x, t: jax.jvp(force, (x,), (t,))[1], X, DIRECTIONS) == 1
    assert kernels(lambda x: computed_once(jnp.sin(x)) * jnp.cos(x), X) == 1
