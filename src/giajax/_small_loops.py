"""Loops over the places of a chain that are small enough for XLA to make one kernel of each.

A call of a kernel takes as long as a hundred operations, on a CPU.
"""

import itertools
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
from jax.interpreters import mlir

from ._typing import Array

# XLA makes a kernel of a loop that touches less than 1024 bytes each time round
# (`SmallWhileLoopHoistingPass`): two columns of so many numbers, and what counts them.
_ROWS = 18

# More loops than this take longer than what they are instead of.
_LOOPS = 8


def in_small_loops(
    x: Array, loop: Callable[[Array], Array], instead: Callable[[Array], Array]
) -> Array:
    """What a function makes of all rows, a few at a time.

    Arguments:
        x: rows along the last axis.
        loop: from some rows, shape (row, place), to as many, in a loop over the places.
        instead: of `x`, where there are no rows, or too many.
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
