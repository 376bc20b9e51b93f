"""Energy of the arm, and the powers that change it."""

import jax.numpy as jnp

from .._maths import dot
from .._typing import Array, Float, Scalar
from ._added_mass import added_mass
from ._air import (
    Wind,
    across_link,
    drag_in_motion,
    flow,
    lift_force,
    relative_velocity,
)
from ._arm import Arm
from ._bodies import bodies
from ._inertia import mass_matrix
from ._kinematics import pose


def kinetic_energy(
    arm: Arm, angles: Float[Array, " joint"], rates: Float[Array, " joint"]
) -> Scalar:
    """Kinetic energy of the links, and of the air that they move where added mass is on, J.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.

    Returns:
        Energy, J, shape ().
    """
    return rates @ mass_matrix(arm, angles) @ rates / 2


def potential_energy(
    arm: Arm,
    angles: Float[Array, " joint"],
    command: Float[Array, " joint"],
    wind: Wind | None = None,
    memory: Float[Array, "row joint"] | None = None,
) -> Scalar:
    """Energy of the joints' springs, of gravity and of buoyancy, J; zero at z = 0 and rest.

    Of joints with muscles it has what the balloons resist; the muscles' own is the air's, and
    `muscle_power` what they deliver.

    In a steady wind u added mass adds -1/2 u . M_a(q) u, which turns a link across the wind
    (the Munk moment): with it the sum of kinetic and potential energy changes by the powers of
    drag and of the joints alone.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        command: commanded angles, rad.
        wind: steady velocity of the air in the base frame, m/s, one for the arm or one for each
            link; still air by default.
        memory: states of the joints' hysteresis (`JointHysteresis`); without strain by default.

    Returns:
        Energy, J, shape ().
    """
    here = pose(arm, angles)
    springs = (arm.spring_stiffness * (angles - command) ** 2).sum() / 2
    if arm.pneumatics is not None:
        springs = springs + arm.pneumatics.energy(angles).sum()
    if memory is not None:
        springs = springs + arm.joints.hysteresis.energy(angles, memory).sum()
    energy = springs + arm.gravity * (bodies(arm).mass * here.mass_centre[2]).sum()
    lifted = lift_force(arm)
    if lifted is not None:
        energy = energy - dot(lifted, here.centre).sum()
    rod = added_mass(arm)
    if rod is not None and arm.air.added_mass == "kirchhoff":
        still = jnp.zeros_like(here.centre)
        stream = across_link(here.direction, relative_velocity(arm, still, flow(arm, wind)))
        energy = energy - (rod.mass * dot(stream, stream)).sum() / 2
    return energy


def drag_power(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    wind: Wind | None = None,
) -> Scalar:
    """Power that the air's drag delivers to the links, W; negative in still air.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        wind: velocity of the air in the base frame, m/s, one for the arm or one for each
            link; still air by default.

    Returns:
        Power, W, shape ().
    """
    (force, couple), velocity, omega = drag_in_motion(arm, angles, rates, wind)
    power = dot(force, velocity)
    if couple is not None:
        power = power + dot(couple, omega)
    return power.sum()


def damping_power(arm: Arm, rates: Float[Array, " joint"]) -> Scalar:
    """Power that the joints' damping and friction deliver, W; never positive.

    Arguments:
        arm: the arm.
        rates: joint rates, rad/s.

    Returns:
        Power, W, shape ().
    """
    return -(arm.joints.resistance(rates) * rates).sum()


def hysteresis_power(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    memory: Float[Array, "row joint"],
) -> Scalar:
    """Power that the joints' hysteresis takes from the motion for good, W; never positive.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        memory: states of the joints' hysteresis (`JointHysteresis`).

    Returns:
        Power, W, shape ().
    """
    return -arm.joints.hysteresis.dissipation(angles, rates, memory).sum()


def muscle_power(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    pressures: Float[Array, "2 joint"],
) -> Scalar:
    """Power that the pressures in the muscles deliver to the joints, W.

    Muscles are without friction, so that it is the pressure times the rate of the volume where
    the law is virtual work of the gas (the ideal braid).

    Arguments:
        arm: an arm with muscles; without, it is 0.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        pressures: of both muscles of each joint, Pa.

    Returns:
        Power, W, shape ().
    """
    if arm.pneumatics is None:
        return jnp.zeros(())
    return (arm.pneumatics.pull(angles, pressures) * rates).sum()
