"""Where in a step a joint turns round: there the equation of joints with memory has a corner."""

from typing import Any

import jax.numpy as jnp

from .._typing import Array, Bool, Float


def turns(
    step: Any, y0: Float[Array, "row joint"], y1: Float[Array, "row joint"]
) -> tuple[Bool[Array, " joint"], Float[Array, " joint"]]:
    """Which joints turn round in a step, and after which part of it.

    By the cubic through angles and rates at both ends.

    Arguments:
        step: its length, s.
        y0, y1: states at its ends, of which the first two rows are angles (rad) and rates (rad/s).

    Returns:
        Whether each does; from 0 to 1, and 1 for those that do not.
    """
    a, b, v0, v1 = slopes(step, y0, y1)
    does = v0 * v1 < 0
    # The root between 0 and 1, where the slope has the sign of v0 before and of v1 after it.
    root = jnp.sqrt(jnp.where(does, b * b - a * v0, 1))
    part = jnp.clip(v0 / jnp.where(does, -b + jnp.sign(v0) * root, 1), 0, 1)
    return does, jnp.where(does, part, 1)


def angle_after(
    part: Float[Array, " joint"], step: Any, y0: Float[Array, "row joint"], y1: Any
) -> Float[Array, " joint"]:
    """Angles (rad) after a part of a step; arguments as of `turns`."""
    a, b, v0, _ = slopes(step, y0, y1)
    return y0[0] + part * (v0 + part * (b + part * a / 3))


def slopes(step: Any, y0: Any, y1: Any) -> tuple[Array, Array, Array, Array]:
    """Of the cubic, by the part x of the step: its slope is v0 + 2 b x + a x^2, and v1 at 1."""
    moved, v0, v1 = y1[0] - y0[0], step * y0[1], step * y1[1]
    return 3 * (v0 + v1 - 2 * moved), 3 * moved - 2 * v0 - v1, v0, v1
