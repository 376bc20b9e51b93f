"""Load of the links: the torque that a motion needs against inertia, gravity and air."""

import jax.numpy as jnp

from .._computed_once import derivatives_once
from .._maths import cross, dot, scaled
from .._typing import Array, Float
from ._added_mass import added_mass, added_mass_load
from ._air import Flow, Wind, drag, flow, lift_force, relative_velocity
from ._arm import Arm
from ._bodies import bodies
from ._inertia import gyroscopic, inertia_times
from ._kinematics import (
    Pose,
    Rows,
    angular_velocities,
    beside_axis,
    pose,
    sum_from_base,
    sum_from_tip,
)


def inverse_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"],
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
) -> Float[Array, " joint"]:
    """Joint torques that produce accelerations against inertia, gravity and drag, N m.

    Springs and dampers of the joints are part of the torque, not of the load; see
    `joint_torque`.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        accelerations: joint accelerations, rad/s^2.
        wind: velocity of the air in the base frame, m/s, one for the arm or one for each
            link; still air by default.
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.

    Returns:
        Torques, N m, shape (joint,).
    """
    return required_torque(arm, pose(arm, angles), rates, accelerations, flow(arm, wind, wind_rate))


def required_torque(
    arm: Arm,
    here: Pose,
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"],
    wind: Flow,
) -> Float[Array, " joint"]:
    """Inverse dynamics."""
    carried = sum_from_tip(carried_load(arm, here, rates, accelerations, wind))
    torque = load_torque(here, carried)
    if arm.joints.armature is not None:
        torque = torque + arm.joints.armature * accelerations
    return torque


def load_torque(here: Pose, carried: Float[Array, "6 link"]) -> Float[Array, " joint"]:
    """Torque about each joint's axis of what is carried beyond it."""
    return dot(here.axis, carried[3:] - cross(here.joint, carried[:3]))


def carried_load(
    arm: Arm,
    here: Pose,
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"] | None,
    wind: Flow,
) -> Float[Array, "6 link"]:
    """Force that each link needs and its moment about the origin, to be summed from the tip.

    Accelerations of None count as zero.
    """
    links, body, e = arm.links, bodies(arm), here.direction

    turning = scaled(rates, here.axis)
    omega = angular_velocities(here, rates)
    # The axis of a joint turns with the links before it, which is the Coriolis term.
    gain = cross(omega, turning)
    if accelerations is not None:
        gain = gain + scaled(accelerations, here.axis)
    # First and second rate of the directions, of which those of all points on the axes are made:
    # XLA computes what a cross product takes anew for each of its components.
    leaning = cross(omega, e)
    span_velocity = scaled(links.length, leaning)
    # Sums along the chain are what an evaluation spends its time on, few rows or many.
    summed = sum_from_base(jnp.concatenate([gain, span_velocity]))
    alpha, end_velocity = summed[:3], summed[3:]
    swinging = cross(alpha, e) + cross(omega, leaning)
    span_acceleration = scaled(links.length, swinging)
    centre_velocity = end_velocity - span_velocity / 2
    joint_acceleration = sum_from_base(span_acceleration) - span_acceleration
    mass_acceleration = joint_acceleration + scaled(body.along, swinging)
    beside = beside_axis(body, here)
    if beside is not None:
        mass_acceleration += cross(alpha, beside) + cross(omega, cross(omega, beside))
    upwards = jnp.zeros((3, 1), e.dtype).at[2, 0].set(1) * arm.gravity
    inertial = scaled(body.mass, mass_acceleration + upwards)
    spin = inertia_times(body, here, alpha) + gyroscopic(body, here, omega, leaning)

    relative = relative_velocity(arm, centre_velocity, wind)
    load = drag(arm, here, relative, omega)
    force = load.force
    if load.couple is not None:
        spin = spin - load.couple
    lifted = lift_force(arm)
    if lifted is not None:
        force = force + lifted
    rod = added_mass(arm)
    if rod is not None:
        centre_acceleration = joint_acceleration + span_acceleration / 2
        if arm.air.added_mass == "inertia":
            relative, leaning, omega, alpha, centre_acceleration = _from_rest(
                arm, here, accelerations
            )
        push, couple = added_mass_load(
            arm, rod, here, relative, leaning, omega, alpha, centre_acceleration, wind
        )
        force, spin = force + push, spin - couple
    both = derivatives_once(jnp.concatenate([inertial, force]))
    inertial, force = both[:3], both[3:]
    moment = spin + cross(here.mass_centre, inertial) - cross(here.centre, force)
    return jnp.concatenate([inertial - force, moment])


def _from_rest(
    arm: Arm, here: Pose, accelerations: Float[Array, " joint"] | None
) -> tuple[Rows, Rows, Rows, Rows, Rows]:
    """What moves the links without any velocity, in the order of `added_mass_load`."""
    still = jnp.zeros_like(here.direction)
    if accelerations is None:
        return still, still, still, still, still
    alpha = sum_from_base(scaled(accelerations, here.axis))
    leap = scaled(arm.links.length, cross(alpha, here.direction))
    return still, still, still, alpha, sum_from_base(leap) - leap / 2
