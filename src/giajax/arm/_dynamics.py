"""Equation of motion: accelerations of the joints under their torques."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Float
from ._air import Flow, Wind, flow
from ._arm import Arm
from ._elimination import Piece, eliminate_and_solve, solve_eliminated
from ._inertia import carried_inertia, motion_and_momentum
from ._kinematics import Pose, pose, sum_from_tip
from ._load import carried_load, load_torque, required_torque
from ._touch import touch


def acceleration(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    command: Float[Array, " joint"],
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
    torque: Float[Array, " joint"] | None = None,
    memory: Float[Array, "row joint"] | None = None,
    pressures: Float[Array, "2 joint"] | None = None,
    skin: Float[Array, "3 link"] | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations of the arm under its commands, rad/s^2: its equation of motion.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
        wind: velocity of the air in the base frame, m/s, one for the arm or one for each
            link; still air by default.
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.
        torque: of the joints' drives, beside springs and dampers, N m; none by default.
        memory: states of the joints' hysteresis (`JointHysteresis`); without strain by default.
        pressures: in the muscles of joints that have some (`Pneumatics`), Pa; by default those with
            which their controller holds the command.
        skin: stretch of the links' skin along obstacles (`Contact`), m; none by default.

    Returns:
        Accelerations, rad/s^2, shape (joint,).
    """
    total = joint_torque(arm, angles, rates, command, memory, pressures)
    if torque is not None:
        total = total + torque
    if arm.contact is not None:
        total = total + touch(arm, angles, rates, skin).torque
    return forward_dynamics(arm, angles, rates, total, wind, wind_rate)


def joint_torque(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    command: Float[Array, " joint"],
    memory: Float[Array, "row joint"] | None = None,
    pressures: Float[Array, "2 joint"] | None = None,
) -> Float[Array, " joint"]:
    """Torque of the joints' springs or muscles, dampers, friction and hysteresis, N m.

    The spring of a joint pulls towards its commanded angle (paper, III.A: a spring whose
    initial length can change); damping c and Coulomb friction f act against the joint's rate
    by c v + f tanh(v / v0).

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
        memory: states of the joints' hysteresis (`JointHysteresis`); without strain by default.
        pressures: in the muscles of joints that have some (`Pneumatics`), Pa; by default those with
            which their controller holds the command.

    Returns:
        Torques, N m, shape (joint,).
    """
    torque = arm.spring_stiffness * (command - angles) - arm.joints.resistance(rates)
    if arm.pneumatics is not None:
        if pressures is None:
            pressures = arm.pneumatics.commanded(command)
        torque = torque + arm.pneumatics.torque(angles, pressures)
    if memory is None or not arm.joints.hysteresis.rows:
        return torque
    return torque - arm.joints.hysteresis.torque(angles, memory)


def forward_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    torques: Float[Array, " joint"],
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations under joint torques, gravity and drag, rad/s^2.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        torques: joint torques, N m.
        wind: velocity of the air in the base frame, m/s, one for the arm or one for each
            link; still air by default.
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.

    Returns:
        Accelerations, rad/s^2, shape (joint,).
    """
    return _accelerations(arm, angles, rates, torques, flow(arm, wind, wind_rate))


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
        unbalanced,
        (arm, here, rates, torques, wind),
        (t_arm, t_here, t_rates, t_torques, t_wind),
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
