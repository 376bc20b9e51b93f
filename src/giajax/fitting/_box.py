"""The step of least squares in a box: between the bounds, and no longer than it may be."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import lineax as lx

from .._typing import Array, Bool, Float

# How often coordinates that leave the box are put on its sides, those that want to come back let
# go, and the rest solved anew; and how often all of them at once.
_SIDES, _AT_ONCE = 40, 6

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


class _Sides(NamedTuple):
    """Which coordinates are held on which side of the box, and the step with them there."""

    step: Array
    side: Array
    held: Array
    wrong: Array
    rounds: Array


def boxed_step(
    factor: Float[Array, "parameter parameter"],
    projected: Float[Array, " parameter"],
    damping: Float[Array, " parameter"],
    box: tuple[Float[Array, " parameter"], Float[Array, " parameter"]],
    active: Bool[Array, " parameter"],
) -> Float[Array, " parameter"]:
    """Minimise |R s + Q^T r|^2 + |D s|^2 over a box.

    By block principal pivoting (Kim and Park 2011): coordinates that want to leave the box stay on
    its side, the others are solved for again, and those that then want to come back are let go.
    To shorten the whole step would let one weak parameter hold up all of them.

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

    places = jnp.arange(active.shape[0])

    def again(carry: _Sides) -> _Sides:
        step = solve(jnp.where(carry.held, carry.side, 0), carry.held | ~active)
        below, above = step < lowest, step > highest
        uphill = factor.T @ (projected + factor @ step) + damping**2 * step
        back = carry.held & jnp.where(carry.side <= lowest, uphill < 0, uphill > 0)
        wrong = active & ((~carry.held & (below | above)) | back)
        # All at once is quick, and may go round in circles; one by one, by place, does not.
        last = jnp.max(jnp.where(wrong, places, -1))
        wrong = wrong & ((carry.rounds < _AT_ONCE) | (places == last))
        side = jnp.where(wrong & below, lowest, jnp.where(wrong & above, highest, carry.side))
        return _Sides(step, side, carry.held ^ wrong, jnp.any(wrong), carry.rounds + 1)

    nothing = jnp.zeros_like(damping)
    begin = _Sides(
        nothing,
        nothing,
        jnp.zeros_like(active),
        jnp.asarray(True),
        jnp.asarray(0, dtype=jnp.int32),
    )
    end = jax.lax.while_loop(lambda now: now.wrong & (now.rounds < _SIDES), again, begin)
    return jnp.clip(end.step, lowest, highest)
