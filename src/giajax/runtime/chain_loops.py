"""Loops, sums and derivatives along a chain, written so that XLA makes few kernels of them."""

import functools
import itertools
from collections.abc import Callable
from typing import Any

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad, batching, mlir

from .arrays import Array, Float

# A call of a kernel takes as long as a hundred operations, on a CPU.

# XLA makes a kernel of a loop that touches less than 1024 bytes each time round
# (`SmallWhileLoopHoistingPass`): two columns of so many numbers, and what counts them.
_ROWS = 18

_LOOPS = 8  # more loops than this take longer than what they are instead of


def in_small_loops(
    x: Array, loop: Callable[[Array], Array], instead: Callable[[Array], Array]
) -> Array:
    """What a function makes of all rows (along the last axis), a few at a time.

    `loop` goes over the places of some rows, shape (row, place); `instead` is of `x` where there
    are no rows, or too many.
    """
    rows: Any = x.reshape(-1, x.shape[-1]) if x.size else x[:0]
    loops = -(-len(rows) // _ROWS)
    if not 0 < loops <= _LOOPS:
        return instead(x)
    ends = [len(rows) * each // loops for each in range(loops + 1)]
    parts = [loop(rows[begin:end]) for begin, end in itertools.pairwise(ends)]
    return jnp.concatenate(parts).reshape(x.shape)


def lower_by_platform(
    primitive: Any, on_cpu: Callable[..., Any], elsewhere: Callable[..., Any]
) -> None:
    """Say what a primitive with one result is made of, on a CPU and elsewhere."""
    mlir.register_lowering(primitive, mlir.lower_fun(elsewhere, multiple_results=False))
    lowered = mlir.lower_fun(on_cpu, multiple_results=False)
    mlir.register_lowering(primitive, lowered, platform="cpu")


# Sums along a chain, as a CPU computes them quickly.
#
# `jax.numpy.cumsum` becomes a tree of slices, a product with a triangle a call of a library: for
# the few hundred additions of a chain both take several times as long as these, and a small loop
# does not. What a sum is made of depends on how many rows it has in the end, with all directions
# of a derivative and all members of a batch, and is chosen when a program is lowered; so it is a
# primitive.


def running_sum(x: Float[Array, "*row n"], *, backwards: bool = False) -> Float[Array, "*row n"]:
    """Sums over each place along the last axis and all before it; `backwards`: all after it."""
    total: Array = _running_sum_p.bind(x, backwards=backwards)
    return total


_running_sum_p = jax.extend.core.Primitive("running_sum")


def _product(x: Array, *, backwards: bool) -> Array:
    ones = np.ones((x.shape[-1],) * 2, x.dtype)
    return x @ (np.tril(ones) if backwards else np.triu(ones))


def _sum_on_cpu(x: Array, *, backwards: bool) -> Array:
    loop, instead = (functools.partial(how, backwards=backwards) for how in (_loop, _product))
    return in_small_loops(x, loop, instead)


def _loop(rows: Array, *, backwards: bool) -> Array:
    last = rows.shape[1] - 1

    def add(k: Array, rows: Array) -> Array:
        here, before = (last - k, last - k + 1) if backwards else (k, k - 1)
        column = functools.partial(jax.lax.dynamic_slice_in_dim, rows, slice_size=1, axis=1)
        return jax.lax.dynamic_update_slice_in_dim(rows, column(here) + column(before), here, 1)

    return jax.lax.fori_loop(1, last + 1, add, rows)


def _transposed(cotangent: Any, x: Any, *, backwards: bool) -> list[Any]:
    """What a place is added to lies on its other side."""
    del x
    return [running_sum(cotangent, backwards=not backwards)]


def _sum_batched(args: Any, axes: Any, *, backwards: bool) -> tuple[Array, int]:
    return running_sum(jnp.moveaxis(args[0], axes[0], 0), backwards=backwards), 0


_running_sum_p.def_abstract_eval(lambda x, **_: x)
_running_sum_p.def_impl(_product)
ad.deflinear2(_running_sum_p, _transposed)
batching.primitive_batchers[_running_sum_p] = _sum_batched
lower_by_platform(_running_sum_p, _sum_on_cpu, _product)


# Derivatives that XLA computes once.
#
# What is made of a vector by a few operations XLA joins into one kernel with it, and computes the
# vector anew for each of its uses: for each component of a cross product twice. Of motions that
# costs little, but the derivatives of forces have a hundred operations. On a CPU nothing but a
# loop that is a kernel of its own keeps them apart: an `optimization_barrier` is gone before
# kernels are made.


def derivative_barrier(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """Rows along a chain, with derivatives (in forward mode) computed apart from what uses them."""
    same: Array = _once_p.bind(x, now=False)
    return same


_once_p = jax.extend.core.Primitive("derivatives_once")


def _same(x: Array, *, now: bool) -> Array:
    del now
    return x


def _copied_on_cpu(x: Array, *, now: bool) -> Array:
    return in_small_loops(x, _copied, lambda x: x) if now else x


def _copied(rows: Array) -> Array:
    def put(k: Array, copy: Array) -> Array:
        column = jax.lax.dynamic_slice_in_dim(rows, k, 1, axis=1)
        return jax.lax.dynamic_update_slice_in_dim(copy, column, k, 1)

    return jax.lax.fori_loop(0, rows.shape[1], put, jnp.zeros_like(rows))


def _jvp(primals: Any, tangents: Any, *, now: bool) -> tuple[Any, Any]:
    (tangent,) = tangents
    if not isinstance(tangent, ad.Zero):
        tangent = _once_p.bind(tangent, now=True)
    return _once_p.bind(*primals, now=now), tangent


def _copy_batched(args: Any, axes: Any, *, now: bool) -> tuple[Any, int]:
    return _once_p.bind(jnp.moveaxis(args[0], axes[0], 0), now=now), 0


_once_p.def_abstract_eval(lambda x, **_: x)
_once_p.def_impl(_same)
ad.primitive_jvps[_once_p] = _jvp
ad.primitive_transposes[_once_p] = lambda cotangent, x, **_: [cotangent]
batching.primitive_batchers[_once_p] = _copy_batched
lower_by_platform(_once_p, _copied_on_cpu, _same)
