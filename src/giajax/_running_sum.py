"""Sums along a chain, as a CPU computes them quickly.

`jax.numpy.cumsum` becomes a tree of slices, a product with a triangle a call of a library: for the
few hundred additions of a chain both take several times as long as these, and a small loop does
not. What a sum is made of depends on how many rows it has in the end, with all directions of a
derivative and all members of a batch, and is chosen when a program is lowered; so it is a
primitive.
"""

import functools
from typing import Any

import jax
import jax.extend
import jax.numpy as jnp
import numpy as np
from jax.interpreters import ad, batching

from ._small_loops import in_small_loops, lower_by_platform
from ._typing import Array, Float


def running_sum(x: Float[Array, "*row n"], *, backwards: bool = False) -> Float[Array, "*row n"]:
    """Sums over each place along the last axis and all before it, or over it and all after it.

    Arguments:
        x: of one axis or more.
        backwards: whether to begin at the end.

    Returns:
        Of the same shape.
    """
    total: Array = _running_sum_p.bind(x, backwards=backwards)
    return total


_running_sum_p = jax.extend.core.Primitive("running_sum")


@_running_sum_p.def_abstract_eval
def _shape(x: Any, *, backwards: bool) -> Any:
    del backwards
    return x


def _product(x: Array, *, backwards: bool) -> Array:
    ones = np.ones((x.shape[-1],) * 2, x.dtype)
    return x @ (np.tril(ones) if backwards else np.triu(ones))


def _on_cpu(x: Array, *, backwards: bool) -> Array:
    return in_small_loops(
        x,
        functools.partial(_loop, backwards=backwards),
        functools.partial(_product, backwards=backwards),
    )


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


def _batched(args: Any, axes: Any, *, backwards: bool) -> tuple[Array, int]:
    return running_sum(jnp.moveaxis(args[0], axes[0], 0), backwards=backwards), 0


_running_sum_p.def_impl(_product)
ad.deflinear2(_running_sum_p, _transposed)
batching.primitive_batchers[_running_sum_p] = _batched
lower_by_platform(_running_sum_p, _on_cpu, _product)
