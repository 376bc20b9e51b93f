"""Equation of motion: joint accelerations under joint torques; energies and powers."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from ...runtime.arrays import Array, Float, Scalar, dot
from ._air import (
    Flow,
    Wind,
    across_link,
    added_mass,
    drag_in_motion,
    flow,
    lift_force,
    relative_velocity,
)
from ._arm import Arm, bodies
from ._contact import touch, touched
from ._inverse_dynamics import (
    carried_inertia,
    carried_load,
    eliminate_and_solve,
    load_torque,
    mass_matrix,
    motion_and_momentum,
    required_torque,
    solve_accelerations,
    solve_eliminated,
)
from ._joint_laws import JointLaws, PerJoint, States
from ._kinematics import Pose, pose, sum_from_tip


def acceleration(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    command: PerJoint,
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
    torque: PerJoint | None = None,
    memory: States | None = None,
    pressures: Float[Array, "2 joint"] | None = None,
    skin: Float[Array, "3 link"] | None = None,
    time: Any = 0.0,
) -> PerJoint:
    """Return the joint accelerations of the arm under its commands, rad/s^2.

    This is the equation of motion of the arm.

    Arguments:
        arm: the arm.
        angles, rates, command: joint angles, rad, joint rates, rad/s, and commanded angles, rad.
        wind, wind_rate: velocity of the air in the base frame, m/s, and its rate of change, m/s^2;
            still air by default.
        torque: torque of the joint drives in addition to springs and dampers, N m; none by default.
        memory, pressures: see `joint_torque`.
        skin: stretch of the skin of the links along obstacles (`Contact`), m; none by default.
        time: time at which a wind field (`Air.wind_field`) is evaluated, s.
    """
    total = joint_torque(arm, angles, rates, command, memory, pressures)
    if torque is not None:
        total = total + torque
    if arm.contact is not None:
        total = total + touch(arm, angles, rates, skin).torque
    return forward_dynamics(arm, angles, rates, total, wind, wind_rate, time)


def joint_torque(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    command: PerJoint,
    memory: States | None = None,
    pressures: Float[Array, "2 joint"] | None = None,
) -> PerJoint:
    """Return the torque of all joint laws, N m.

    These are springs or muscles, dampers, friction, hysteresis and further laws. The spring of a
    joint pulls towards its commanded angle (section III.A of the paper: a spring whose initial
    length can change). Damping c and Coulomb friction f act against the rate v of the joint with
    the torque c v + f tanh(v / v0).

    Arguments:
        arm: the arm.
        angles, rates, command: joint angles, rad, joint rates, rad/s, and commanded angles, rad.
        memory: states of the joint laws (`Arm.joint_laws`); by default those at the start of a
            motion.
        pressures: pressures supplied to the muscles (`Pneumatics`), Pa; by default the pressures
            with which their controller holds the command.
    """
    laws = arm.joint_laws
    return laws.torque(laws.at(angles, rates, command, memory, pressures))


def forward_dynamics(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    torques: PerJoint,
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
    time: Any = 0.0,
) -> PerJoint:
    """Return the joint accelerations under joint torques, gravity and drag, rad/s^2.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        torques: joint torques, N m.
        wind, wind_rate: velocity of the air in the base frame, m/s, and its rate of change, m/s^2;
            still air by default.
        time: time at which a wind field is evaluated, s.
    """
    return _accelerations(arm, angles, rates, torques, flow(arm, wind, wind_rate, time))


@eqx.filter_custom_jvp
def _accelerations(arm: Arm, angles: Array, rates: Array, torques: Array, wind: Flow) -> Array:
    return solve_accelerations(*_equations(arm, pose(arm, angles), rates, torques, wind))


@_accelerations.def_jvp
def _accelerations_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    """Differentiate M a + h = tau at constant a, and reuse the Cholesky factors of M.

    Differentiating the Cholesky factorisation itself takes twice as much time.
    """
    arm, angles, rates, torques, wind = primals
    t_arm, t_angles, t_rates, t_torques, t_wind = tangents
    here, t_here = eqx.filter_jvp(pose, (arm, angles), (t_arm, t_angles))
    pieces, accelerations = eliminate_and_solve(*_equations(arm, here, rates, torques, wind))

    def unbalanced(arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow) -> Array:
        return torques - required_torque(arm, here, rates, accelerations, wind)

    _, tangent = eqx.filter_jvp(
        unbalanced, (arm, here, rates, torques, wind), (t_arm, t_here, t_rates, t_torques, t_wind)
    )
    return accelerations, solve_eliminated(pieces, tangent)


def _equations(
    arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow
) -> tuple[Array, Array, Array | None, Array]:
    """Return the motion, momentum and armature of the mass matrix, and the torque."""
    load, inertia = carried_load(arm, here, rates, None, wind), carried_inertia(arm, here)
    carried = sum_from_tip(jnp.concatenate([load, inertia]))
    motion, momentum = motion_and_momentum(arm, here, carried[6:])
    torque = torques - load_torque(here, carried[:6])
    return motion, momentum, arm.joints.armature, torque


def joint_forces(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    accelerations: PerJoint,
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
    skin: Float[Array, "3 link"] | None = None,
    time: Any = 0.0,
) -> Float[Array, "joint 3"]:
    """Return the force that each joint exerts on the link beyond it, in the base frame, N.

    This is the force required for the acceleration of all links beyond the joint, minus the forces
    of gravity, buoyancy, the air and obstacles on them.

    Arguments:
        arm: the arm.
        angles, rates, accelerations: joint angles, rad, joint rates, rad/s, and joint
            accelerations, rad/s^2.
        wind, wind_rate, skin, time: see `acceleration`.
    """
    air = flow(arm, wind, wind_rate, time)
    needed = carried_load(arm, pose(arm, angles), rates, accelerations, air)[:3]
    if arm.contact is not None:
        needed = needed - touched(arm, angles, rates, skin)[1].sum(axis=1).T
    return sum_from_tip(needed).T


def kinetic_energy(arm: Arm, angles: PerJoint, rates: PerJoint) -> Scalar:
    """Return the kinetic energy of the links and, with added mass, of the air, J.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
    """
    return rates @ mass_matrix(arm, angles) @ rates / 2


def potential_energy(
    arm: Arm,
    angles: PerJoint,
    command: PerJoint,
    wind: Wind | None = None,
    memory: States | None = None,
) -> Scalar:
    """Return the potential energy of joint laws, gravity and buoyancy, J.

    The energy is zero for masses at z = 0 and undeflected joints. For joints with muscles, it
    includes the energy stored by the resistance of the balloons. The energy of the gas in the
    muscles is not included: `muscle_power` is the power that they deliver.

    In a steady wind u, added mass contributes -1/2 u . M_a(q) u, which turns a link perpendicular
    to the wind (the Munk moment). With this term, only the powers of drag and joints change the sum
    of kinetic and potential energy. The corresponding term of a wind field is omitted, because it
    is not a potential.

    Arguments:
        arm: the arm.
        angles, command: joint angles and commanded angles, rad.
        wind: steady velocity of the air in the base frame, m/s; still air by default.
        memory: see `joint_torque`.
    """
    here, laws = pose(arm, angles), arm.joint_laws
    springs = laws.energy(laws.at(angles, jnp.zeros_like(angles), command, memory)).sum()
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
    arm: Arm, angles: PerJoint, rates: PerJoint, wind: Wind | None = None, time: Any = 0.0
) -> Scalar:
    """Return the power that the drag of the air delivers to the links, W; negative in still air.

    The arguments are those of `drag_force`.
    """
    (force, couple), velocity, omega = drag_in_motion(arm, angles, rates, wind, time)
    power = dot(force, velocity)
    if couple is not None:
        power = power + dot(couple, omega)
    return power.sum()


def damping_power(arm: Arm, rates: PerJoint) -> Scalar:
    """Return the power of joint damping and friction at rates (rad/s), W; never positive."""
    laws, still = JointLaws(arm.joints.dampers), jnp.zeros_like(rates)
    return (laws.torque(laws.at(still, rates, still)) * rates).sum()


def hysteresis_power(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    memory: States | None = None,
    command: PerJoint | None = None,
) -> Scalar:
    """Return the negative of the power dissipated by joint hysteresis, W; never positive.

    The power dissipated by further joint laws is included.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        memory: states of the laws; by default those at the start of a motion.
        command: commanded angles, on which further laws may depend, rad; 0 by default.
    """
    command = jnp.zeros_like(angles) if command is None else command
    return -_lost(arm.further_laws, False, angles, rates, command, memory)


def muscle_power(
    arm: Arm, angles: PerJoint, rates: PerJoint, pressures: Float[Array, "2 joint"]
) -> Scalar:
    """Return the power that the muscles deliver to the joints, W; 0 without muscles.

    The muscles have no friction. If the muscle law is the virtual work of the gas (the ideal
    braid), the power is therefore the pressure times the rate of change of the volume. In joints
    with necks, it is the combined power of muscles and necks, and does not equal this work, because
    the energy stored in a neck depends on the compression by the muscles, which do not shorten with
    the neck.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        pressures: pressures in the muscles, Pa.
    """
    still = jnp.zeros_like(angles)
    return -_lost(arm.further_laws, True, angles, rates, still, None, pressures)


def _lost(laws: JointLaws, driven: bool, *state: Any) -> Scalar:
    """Return the total `dissipation` of laws driven by pressures, or of all other laws, W.

    Arguments:
        laws: joint laws.
        driven: whether to use the laws that are driven by pressures.
        state: arguments of `JointLaws.at`.
    """
    parts = laws.each(laws.at(*state)) if laws.laws else ()
    lost = [law.dissipation(own).sum() for law, own in parts if law.takes_pressures == driven]
    return sum(lost, jnp.zeros(()))
