"""Sums along a chain for every size and transformation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.runtime.arrays import running_sum

RANDOM = np.random.default_rng(0)


def expected(x, backwards):
    return np.cumsum(x[..., ::-1], axis=-1)[..., ::-1] if backwards else np.cumsum(x, axis=-1)


# Sizes below and above the limit of one loop, and above the limit of all loops.
@pytest.mark.parametrize("shape", [(1,), (7,), (3, 20), (18, 20), (19, 5), (4, 18, 20), (5, 40, 3)])
@pytest.mark.parametrize("backwards", [False, True])
def test_sums_are_those_of_numpy(shape, backwards):
    x = RANDOM.normal(size=shape)
    total = jax.jit(lambda x: running_sum(x, backwards=backwards))(x)
    assert_allclose(total, expected(x, backwards), rtol=1e-13, atol=1e-13)
    assert_allclose(running_sum(jnp.asarray(x), backwards=backwards), total, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("backwards", [False, True])
def test_derivatives_are_sums_too_and_in_reverse_mode_those_from_the_other_end(backwards):
    x, direction = RANDOM.normal(size=(2, 3, 20))

    def total(x):
        return running_sum(jnp.sin(x), backwards=backwards)

    forward = jax.jit(lambda x: jax.jvp(total, (x,), (jnp.asarray(direction),))[1])(x)
    assert_allclose(forward, expected(np.cos(x) * direction, backwards), rtol=1e-12, atol=1e-12)
    back = jax.jit(lambda x: jax.vjp(total, x)[1](jnp.asarray(direction))[0])(x)
    assert_allclose(back, np.cos(x) * expected(direction, not backwards), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_batch_may_be_along_any_axis(axis):
    x = RANDOM.normal(size=(2, 3, 4))
    total = jax.jit(jax.vmap(running_sum, axis, axis))(x)
    moved = np.moveaxis(expected(np.moveaxis(x, axis, 0), False), 0, axis)
    assert_allclose(total, moved, rtol=1e-14)


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="elsewhere a sum is a product")
@pytest.mark.parametrize("count", [4, 20, 160])
def test_a_small_sum_is_one_kernel_however_long_the_chain(count):
    text = jax.jit(running_sum).lower(jnp.zeros((18, count))).compile().as_text()
    assert text.count('xla_cpu_small_call="true"') == 1
    assert " dot(" not in text


@pytest.mark.skipif(jax.default_backend() != "cpu", reason="elsewhere a sum is a product")
def test_a_sum_of_many_rows_is_a_product():
    text = jax.jit(running_sum).lower(jnp.zeros((1000, 20))).compile().as_text()
    assert "small_call" not in text
    assert " dot(" in text or "dot_general" in text
