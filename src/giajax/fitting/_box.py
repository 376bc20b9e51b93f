"""The step of least squares in a box: between the bounds, and no longer than it may be."""

import jax
import jax.numpy as jnp
import lineax as lx

from .._typing import Array, Bool, Float

# How often coordinates that leave the box are put on its sides, those that want to come back let
# go, and the rest solved anew.
_SIDES = 10

# A bound is reached from near it: farther off a step covers this part of the way at most.
_AT_HAND, _WAY = 0.1, 0.9


def towards(bound: Float[Array, " parameter"], most: float) -> Float[Array, " parameter"]:
    """How far a step may go towards bounds.

    Arguments:
        bound: the way to each, negative downwards.
        most: the longest step, of the same sign.
    """
    way = jnp.where(jnp.abs(bound) > _AT_HAND, _WAY * bound, bound)
    return jnp.clip(way, -abs(most), abs(most))


def boxed_step(
    factor: Float[Array, "parameter parameter"],
    projected: Float[Array, " parameter"],
    damping: Float[Array, " parameter"],
    box: tuple[Float[Array, " parameter"], Float[Array, " parameter"]],
    active: Bool[Array, " parameter"],
) -> Float[Array, " parameter"]:
    """Minimise |R s + Q^T r|^2 + |D s|^2 over a box.

    By an active set: coordinates that want to leave the box stay on its side, the others are
    solved for again, and those that then want to come back are let go. To shorten the whole step
    would let one weak parameter hold up all of them.

    Arguments:
        factor, projected: R and Q^T r of the Jacobian's QR factorisation.
        damping: D, positive.
        box: the lowest (at most 0) and the highest (at least 0) step of each coordinate.
        active: coordinates that may move.

    Returns:
        The step.
    """
    lowest, highest = box
    diagonal = jnp.diag(damping)

    def solve(direct: Array, held: Array) -> Array:
        matrix = jnp.concatenate([jnp.where(held[None], 0, factor), diagonal])
        load = projected + factor @ direct
        vector = jnp.concatenate([-load, jnp.zeros_like(load)])
        operator = lx.MatrixLinearOperator(matrix)
        return lx.linear_solve(operator, vector, solver=lx.QR(), throw=False).value + direct

    def again(carry: tuple[Array, Array, Array, Array]) -> tuple[Array, Array, Array, Array]:
        step, held, _, count = carry
        step = solve(jnp.where(held, step, 0), held | ~active)
        outside = (step < lowest) | (step > highest)
        step = jnp.clip(step, lowest, highest)
        uphill = factor.T @ (projected + factor @ step) + damping**2 * step
        inwards = jnp.where(step <= lowest, uphill < 0, uphill > 0)
        now = outside | (held & ~inwards)
        return step, now, jnp.any(now != held), count + 1

    begin = (
        jnp.zeros_like(damping),
        jnp.zeros_like(active),
        jnp.asarray(True),
        jnp.asarray(0, dtype=jnp.int32),
    )
    step, *_ = jax.lax.while_loop(lambda carry: carry[2] & (carry[3] < _SIDES), again, begin)
    return step
