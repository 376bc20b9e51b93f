"""Angles at which a joint rests while its pressures change slowly: where it stays, and jumps."""

import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float, Scalar
from ...runtime.programs import program


@program
def slow_history(
    torques: Float[Array, "step angle"],
    angles: Float[Array, " angle"],
    friction: Scalar,
    start: Scalar,
) -> Float[Array, " step"]:
    """Angle at which a joint rests after each of many slow steps, rad.

    A joint goes the way that its torque drives it, to the next angle at which dry friction holds
    it, or to an end of its range. What it rests at depends on where it came from: it stays at an
    equilibrium until there is none, and jumps then. Between two angles torques are linear.

    Arguments:
        torques: of each step at these angles, N m, towards positive angles.
        angles: increasing, from the one end of its range to the other, rad.
        friction: torque up to which dry friction holds the joint, N m.
        start: angle before the first step, rad.
    """

    def step(angle: Scalar, torque: Float[Array, " angle"]) -> tuple[Scalar, Scalar]:
        here = jnp.interp(angle, angles, torque)
        ahead = _next(torque - friction, angles, angle, here - friction)
        # The way back is the way ahead of what is turned round.
        back = -_next(-torque[::-1] - friction, -angles[::-1], -angle, -here - friction)
        rest = jnp.where(here > friction, ahead, jnp.where(here < -friction, back, angle))
        return rest, rest

    return jax.lax.scan(step, start, torques)[1]


def _next(
    drive: Float[Array, " angle"], angles: Float[Array, " angle"], angle: Scalar, here: Scalar
) -> Scalar:
    """The first angle from one on at which nothing drives a joint on any longer."""
    stops: Bool[Array, " angle"] = (drive <= 0) & (angles > angle)
    at = jnp.argmax(stops)
    before = jnp.where(angles[at - 1] > angle, angles[at - 1], angle)
    driven = jnp.where(angles[at - 1] > angle, drive[at - 1], here)
    width = angles[at] - before
    found = before + width * driven / jnp.where(stops[at], driven - drive[at], 1)
    return jnp.where(jnp.any(stops), found, angles[-1])
