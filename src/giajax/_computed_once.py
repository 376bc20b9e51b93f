"""Derivatives that XLA computes once.

What is made of a vector by a few operations XLA joins into one kernel with it, and computes the
vector anew for each of its uses: for each component of a cross product twice. Of motions that costs
little, but the derivatives of forces have a hundred operations. On a CPU nothing but a loop that is
a kernel of its own keeps them apart: an `optimization_barrier` is gone before kernels are made.
"""

from typing import Any

import jax
import jax.extend
import jax.numpy as jnp
from jax.interpreters import ad, batching

from ._small_loops import in_small_loops, lower_by_platform
from ._typing import Array, Float


def derivatives_once(x: Float[Array, "*row n"]) -> Float[Array, "*row n"]:
    """The same, with derivatives (in forward mode) that are computed apart from what uses them.

    Arguments:
        x: rows along a chain.
    """
    same: Array = _once_p.bind(x, now=False)
    return same


_once_p = jax.extend.core.Primitive("derivatives_once")


@_once_p.def_abstract_eval
def _shape(x: Any, *, now: bool) -> Any:
    del now
    return x


def _same(x: Array, *, now: bool) -> Array:
    del now
    return x


def _on_cpu(x: Array, *, now: bool) -> Array:
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


def _batched(args: Any, axes: Any, *, now: bool) -> tuple[Any, int]:
    return _once_p.bind(jnp.moveaxis(args[0], axes[0], 0), now=now), 0


_once_p.def_impl(_same)
ad.primitive_jvps[_once_p] = _jvp
ad.primitive_transposes[_once_p] = lambda cotangent, x, **_: [cotangent]
batching.primitive_batchers[_once_p] = _batched
lower_by_platform(_once_p, _on_cpu, _same)
