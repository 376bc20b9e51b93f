"""The force of the air on the links: the paper's eq. (1)."""

import jax.numpy as jnp

from .._maths import safe_norm, scaled
from .._typing import Array, Float
from ._chain import Arm
from ._kinematics import Rows, link_velocities


def drag_rows(arm: Arm, centre_velocity: Rows, wind: Float[Array, "3"]) -> Rows:
    """Drag on each link at its centre, from the velocity of the centre."""
    relative = centre_velocity - wind[:, None]
    area = arm.links.length * arm.links.diameter
    factor = 0.5 * arm.air.density * arm.air.drag_coefficient * area
    return -scaled(factor * safe_norm(relative), relative)


def drag_force(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
) -> Float[Array, "link 3"]:
    """Drag force of the air on each link, acting at its geometric centre, N.

    F_D = -1/2 rho C_D L d |V| V with V the velocity of the link's centre relative to the air
    (paper, eq. 1).

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        wind: velocity of the air in the base frame, m/s; still air by default.
    """
    wind = jnp.zeros(3, angles.dtype) if wind is None else wind
    return drag_rows(arm, link_velocities(arm, angles, rates).T, wind).T
