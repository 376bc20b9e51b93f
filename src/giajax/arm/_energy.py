"""Energy of the arm, and the powers that change it."""

import jax.numpy as jnp

from .._maths import dot
from .._typing import Array, Float, Scalar
from ._chain import Arm
from ._drag import drag_rows
from ._dynamics import mass_matrix
from ._kinematics import angular_velocities, centre_velocities, pose


def kinetic_energy(
    arm: Arm, angles: Float[Array, " joint"], rates: Float[Array, " joint"]
) -> Scalar:
    """Kinetic energy of the links, J.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
    """
    return rates @ mass_matrix(arm, angles) @ rates / 2


def potential_energy(
    arm: Arm, angles: Float[Array, " joint"], command: Float[Array, " joint"]
) -> Scalar:
    """Energy of the joints' springs and of gravity, J; zero at z = 0 with the springs at rest.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        command: commanded angles, rad.
    """
    springs = (arm.joints.stiffness * (angles - command) ** 2).sum() / 2
    return springs + arm.gravity * (arm.links.mass * pose(arm, angles).mass_centre[2]).sum()


def drag_power(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
) -> Scalar:
    """Power that the air delivers to the links, W; negative in still air.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        wind: velocity of the air in the base frame, m/s; still air by default.
    """
    wind = jnp.zeros(3, angles.dtype) if wind is None else wind
    here = pose(arm, angles)
    velocity = centre_velocities(arm, here, angular_velocities(here, rates))
    return dot(drag_rows(arm, velocity, wind), velocity).sum()


def damping_power(arm: Arm, rates: Float[Array, " joint"]) -> Scalar:
    """Power that the joints' dampers deliver, W; never positive.

    Arguments:
        arm: the arm.
        rates: joint rates, rad/s.
    """
    return -(arm.joints.damping * rates**2).sum()
