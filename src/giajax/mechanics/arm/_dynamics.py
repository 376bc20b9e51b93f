"""Equation of motion: accelerations of the joints under their torques; energy and powers."""

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
    Piece,
    carried_inertia,
    carried_load,
    eliminate_and_solve,
    load_torque,
    mass_matrix,
    motion_and_momentum,
    required_torque,
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
    """Joint accelerations of the arm under its commands, rad/s^2: its equation of motion.

    Arguments:
        angles, rates, command: of the joints, rad, rad/s and rad.
        wind, wind_rate: of the air in the base frame, m/s and m/s^2; still air by default.
        torque: of the joints' drives, beside springs and dampers, N m; none by default.
        memory, pressures: as of `joint_torque`.
        skin: stretch of the links' skin along obstacles (`Contact`), m; none by default.
        time: s, of a wind field (`Air.wind_field`).
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
    """Torque of the joints' springs or muscles, dampers, friction, hysteresis and laws, N m.

    The spring of a joint pulls towards its commanded angle (paper, III.A: a spring whose
    initial length can change); damping c and Coulomb friction f act against the joint's rate
    by c v + f tanh(v / v0).

    Arguments:
        angles, rates, command: of the joints, rad, rad/s and rad.
        memory: states of the joints' laws (`Arm.joint_laws`); without strain by default.
        pressures: supplied to the muscles of joints that have some (`Pneumatics`), Pa; by default
            those with which their controller holds the command.
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
    """Joint accelerations under joint torques (N m), gravity and drag, rad/s^2.

    Arguments:
        angles, rates: of the joints, rad and rad/s.
        wind, wind_rate: of the air in the base frame, m/s and m/s^2; still air by default.
        time: s, of a wind field.
    """
    return _accelerations(arm, angles, rates, torques, flow(arm, wind, wind_rate, time))


@eqx.filter_custom_jvp
def _accelerations(arm: Arm, angles: Array, rates: Array, torques: Array, wind: Flow) -> Array:
    return _eliminate_and_solve(arm, pose(arm, angles), rates, torques, wind)[1]


@_accelerations.def_jvp
def _accelerations_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    """Differentiate M a + h = tau at fixed a, and reuse the factors of M.

    Differentiating the Cholesky factorisation itself costs twice as much.
    """
    arm, angles, rates, torques, wind = primals
    t_arm, t_angles, t_rates, t_torques, t_wind = tangents
    here, t_here = eqx.filter_jvp(pose, (arm, angles), (t_arm, t_angles))
    pieces, accelerations = _eliminate_and_solve(arm, here, rates, torques, wind)

    def unbalanced(arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow) -> Array:
        return torques - required_torque(arm, here, rates, accelerations, wind)

    _, tangent = eqx.filter_jvp(
        unbalanced, (arm, here, rates, torques, wind), (t_arm, t_here, t_rates, t_torques, t_wind)
    )
    return accelerations, solve_eliminated(pieces, tangent)


def _eliminate_and_solve(
    arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow
) -> tuple[tuple[Piece, ...], Array]:
    load, inertia = carried_load(arm, here, rates, None, wind), carried_inertia(arm, here)
    carried = sum_from_tip(jnp.concatenate([load, inertia]))
    motion, momentum = motion_and_momentum(arm, here, carried[6:])
    torque = torques - load_torque(here, carried[:6])
    return eliminate_and_solve(motion, momentum, arm.joints.armature, torque)


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
    """Force that each joint passes on to the link beyond it, in the base frame, N.

    It is what all links beyond need to move so (Newton), less their weight and what buoyancy, the
    air and obstacles do of it.

    Arguments:
        angles, rates, accelerations: of the joints, rad, rad/s and rad/s^2.
        wind, wind_rate, skin, time: as of `acceleration`.
    """
    air = flow(arm, wind, wind_rate, time)
    needed = carried_load(arm, pose(arm, angles), rates, accelerations, air)[:3]
    if arm.contact is not None:
        needed = needed - touched(arm, angles, rates, skin)[1].sum(axis=1).T
    return sum_from_tip(needed).T


def kinetic_energy(arm: Arm, angles: PerJoint, rates: PerJoint) -> Scalar:
    """Energy of the links' motion (rad, rad/s), and of the air's where added mass is on, J."""
    return rates @ mass_matrix(arm, angles) @ rates / 2


def potential_energy(
    arm: Arm,
    angles: PerJoint,
    command: PerJoint,
    wind: Wind | None = None,
    memory: States | None = None,
) -> Scalar:
    """Energy of the joints' springs, of gravity and of buoyancy, J; zero at z = 0 and rest.

    Of joints with muscles it has what the balloons resist; the muscles' own is the air's, and
    `muscle_power` what they deliver.

    In a steady wind u added mass adds -1/2 u . M_a(q) u, which turns a link across the wind
    (the Munk moment): with it the sum of kinetic and potential energy changes by the powers of
    drag and of the joints alone. That of a wind field is left out, which is not a potential.

    Arguments:
        angles, command: of the joints, rad.
        wind: steady, of the air in the base frame, m/s; still air by default.
        memory: as of `joint_torque`.
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
    """Power that the air's drag delivers to the links, W; negative in still air.

    Arguments: as of `drag_force`.
    """
    (force, couple), velocity, omega = drag_in_motion(arm, angles, rates, wind, time)
    power = dot(force, velocity)
    if couple is not None:
        power = power + dot(couple, omega)
    return power.sum()


def damping_power(arm: Arm, rates: PerJoint) -> Scalar:
    """Power that the joints' damping and friction deliver at rates (rad/s), W; never positive."""
    laws, still = JointLaws(arm.joints.dampers), jnp.zeros_like(rates)
    return (laws.torque(laws.at(still, rates, still)) * rates).sum()


def hysteresis_power(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    memory: States | None = None,
    command: PerJoint | None = None,
) -> Scalar:
    """Power that the joints' hysteresis takes from the motion for good, W; never positive.

    With that of laws of one's own, to which the command may matter: 0 by default, as are strains.
    """
    command = jnp.zeros_like(angles) if command is None else command
    return -_lost(arm.further_laws, False, angles, rates, command, memory)


def muscle_power(
    arm: Arm, angles: PerJoint, rates: PerJoint, pressures: Float[Array, "2 joint"]
) -> Scalar:
    """Power that the pressures in the muscles (Pa) deliver to the joints, W; 0 without muscles.

    Muscles are without friction, so that it is the pressure times the rate of the volume where
    the law is virtual work of the gas (the ideal braid). Of joints with necks it is what muscles
    and necks deliver together, and no such work: what a neck stores depends on the muscles that
    press it, which do not shorten with it.
    """
    still = jnp.zeros_like(angles)
    return -_lost(arm.further_laws, True, angles, rates, still, None, pressures)


def _lost(laws: JointLaws, driven: bool, *state: Any) -> Scalar:
    """Power that is neither stored nor given to the joints by laws that pressures drive, or not."""
    parts = laws.each(laws.at(*state)) if laws.laws else ()
    lost = [law.dissipation(own).sum() for law, own in parts if law.takes_pressures == driven]
    return sum(lost, jnp.zeros(()))
