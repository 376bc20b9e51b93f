"""Quasi-static rest angles of a joint under slowly changing pressures, including jumps."""

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
    """Return the angle at which a joint rests after each of several slow steps, rad.

    The joint moves in the direction of its torque to the next angle at which dry friction holds it,
    or to an end of its range. The rest angle depends on the previous one: the joint remains at an
    equilibrium until this equilibrium vanishes, and then jumps. The torque is interpolated linearly
    between two angles.

    Arguments:
        torques: torque towards positive angles in each step at each of the angles, N m.
        angles: increasing angles from one end of the range of the joint to the other, rad.
        friction: largest torque that dry friction holds, N m.
        start: angle before the first step, rad.
    """

    def step(angle: Scalar, torque: Float[Array, " angle"]) -> tuple[Scalar, Scalar]:
        here = jnp.interp(angle, angles, torque)
        ahead = _next(torque - friction, angles, angle, here - friction)
        # A motion towards negative angles is a motion towards positive angles of the mirror image.
        back = -_next(-torque[::-1] - friction, -angles[::-1], -angle, -here - friction)
        rest = jnp.where(here > friction, ahead, jnp.where(here < -friction, back, angle))
        return rest, rest

    return jax.lax.scan(step, start, torques)[1]


def _next(
    drive: Float[Array, " angle"], angles: Float[Array, " angle"], angle: Scalar, here: Scalar
) -> Scalar:
    """Return the first angle after a given one at which the driving torque vanishes.

    Arguments:
        drive: torque minus friction at each of the angles, N m.
        angles: increasing angles, rad.
        angle: current angle, rad.
        here: torque minus friction at the current angle, N m.
    """
    stops: Bool[Array, " angle"] = (drive <= 0) & (angles > angle)
    at = jnp.argmax(stops)
    before = jnp.where(angles[at - 1] > angle, angles[at - 1], angle)
    driven = jnp.where(angles[at - 1] > angle, drive[at - 1], here)
    width = angles[at] - before
    found = before + width * driven / jnp.where(stops[at], driven - drive[at], 1)
    return jnp.where(jnp.any(stops), found, angles[-1])
