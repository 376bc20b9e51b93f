"""Equations of motion in world-frame composite form.

Spatial inertias about the base origin simply add, so the composite inertias are one reverse
cumulative sum and M[k, j] = S_k . (I_composite_j S_j) for k <= j (Featherstone, Rigid Body
Dynamics Algorithms, ch. 6, in base coordinates).
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._maths import cross, dot, scaled
from .._typing import Array, Float
from ._chain import Arm
from ._drag import drag_rows
from ._kinematics import Pose, Rows, angular_velocities, pose, sum_from_base, sum_from_tip


def _inertia_times(arm: Arm, direction: Rows, vector: Rows) -> Rows:
    """Rotational inertia of each link about its centre of mass, times a vector."""
    transverse, axial = arm.links.inertia_transverse, arm.links.inertia_axial
    along = (axial - transverse) * dot(direction, vector)
    return scaled(transverse, vector) + scaled(along, direction)


def _mass_matrix_upper(arm: Arm, here: Pose) -> Float[Array, "joint joint"]:
    """The mass matrix, right on and above the diagonal only."""
    links = arm.links
    x, e = here.mass_centre, here.direction
    first = scaled(links.mass, x)
    ring = links.inertia_axial - links.inertia_transverse

    def about_origin(i: int, j: int) -> Array:
        return ring * e[i] * e[j] - first[i] * x[j]

    round_part = links.inertia_transverse + dot(first, x)
    composite = sum_from_tip(
        jnp.stack(
            [
                links.mass,
                *first,
                round_part + about_origin(0, 0),
                round_part + about_origin(1, 1),
                round_part + about_origin(2, 2),
                about_origin(0, 1),
                about_origin(0, 2),
                about_origin(1, 2),
            ]
        )
    )
    mass, first, (xx, yy, zz, xy, xz, yz) = composite[0], composite[1:4], composite[4:]
    w = here.axis
    v = cross(here.joint, w)  # velocity, at the origin, of a body turning about the joint
    momentum = scaled(mass, v) + cross(w, first)
    turn = jnp.stack(
        [
            xx * w[0] + xy * w[1] + xz * w[2],
            xy * w[0] + yy * w[1] + yz * w[2],
            xz * w[0] + yz * w[1] + zz * w[2],
        ]
    )
    angular_momentum = turn + cross(first, v)
    return jnp.concatenate([w, v]).T @ jnp.concatenate([angular_momentum, momentum])


def _required_torque(
    arm: Arm,
    here: Pose,
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"] | None,
    wind: Float[Array, "3"],
) -> Float[Array, " joint"]:
    """Inverse dynamics; no accelerations stand for zero accelerations."""
    links = arm.links
    span = scaled(links.length, here.direction)
    arm_of_mass = scaled(links.centre_of_mass, here.direction)

    turning = scaled(rates, here.axis)
    omega = angular_velocities(here, rates)
    # The axis of a joint turns with the links before it, which is the Coriolis term.
    gain = cross(omega, turning)
    if accelerations is not None:
        gain = gain + scaled(accelerations, here.axis)
    alpha = sum_from_base(gain)

    def acceleration_of(offset: Rows) -> Rows:
        return cross(alpha, offset) + cross(omega, cross(omega, offset))

    span_velocity = cross(omega, span)
    span_acceleration = cross(alpha, span) + cross(omega, span_velocity)
    centre_velocity = sum_from_base(span_velocity) - span_velocity / 2
    mass_acceleration = (
        sum_from_base(span_acceleration) - span_acceleration + acceleration_of(arm_of_mass)
    )
    upwards = jnp.zeros((3, 1), span.dtype).at[2, 0].set(1) * arm.gravity
    inertial = scaled(links.mass, mass_acceleration + upwards)
    drag = drag_rows(arm, centre_velocity, wind)
    spin = _inertia_times(arm, here.direction, alpha) + cross(
        omega, _inertia_times(arm, here.direction, omega)
    )
    moment = spin + cross(here.mass_centre, inertial) - cross(here.centre, drag)
    carried = sum_from_tip(jnp.concatenate([inertial - drag, moment]))
    return dot(here.axis, carried[3:] - cross(here.joint, carried[:3]))


def mass_matrix(arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "joint joint"]:
    """Joint-space mass matrix M(q), kg m^2; symmetric and positive definite.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
    """
    upper = jnp.triu(_mass_matrix_upper(arm, pose(arm, angles)))
    return upper + jnp.triu(upper, 1).T


def inverse_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
) -> Float[Array, " joint"]:
    """Joint torques that produce given accelerations against inertia, gravity and drag, N m.

    Springs and dampers of the joints are part of the torque, not of the load; see
    `joint_torque`.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        accelerations: joint accelerations, rad/s^2.
        wind: velocity of the air in the base frame, m/s; still air by default.
    """
    wind = jnp.zeros(3, angles.dtype) if wind is None else wind
    return _required_torque(arm, pose(arm, angles), rates, accelerations, wind)


def forward_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    torques: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations under given joint torques, gravity and drag, rad/s^2.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        torques: joint torques, N m.
        wind: velocity of the air in the base frame, m/s; still air by default.
    """
    wind = jnp.zeros(3, angles.dtype) if wind is None else wind
    return _accelerations(arm, angles, rates, torques, wind)


def _factor_and_solve(
    arm: Arm, here: Pose, rates: Array, torques: Array, wind: Array
) -> tuple[Array, Array]:
    # LAPACK reads the lower triangle only, so the upper one need not be copied there.
    factor = jax.lax.linalg.cholesky(_mass_matrix_upper(arm, here).T, symmetrize_input=False)
    load = _required_torque(arm, here, rates, None, wind)
    return factor, _solve(factor, torques - load)


def _solve(factor: Float[Array, "joint joint"], b: Float[Array, " joint"]) -> Array:
    half = jax.lax.linalg.triangular_solve(factor, b[:, None], left_side=True, lower=True)
    return jax.lax.linalg.triangular_solve(
        factor, half, left_side=True, lower=True, transpose_a=True
    )[:, 0]


@eqx.filter_custom_jvp
def _accelerations(arm: Arm, angles: Array, rates: Array, torques: Array, wind: Array) -> Array:
    return _factor_and_solve(arm, pose(arm, angles), rates, torques, wind)[1]


@_accelerations.def_jvp
def _accelerations_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Array, Array]:
    """Differentiate M a + h = tau at fixed a, and reuse the factor of M.

    Differentiating the Cholesky factorisation itself costs twice as much.
    """
    arm, angles, rates, torques, wind = primals
    t_arm, t_angles, t_rates, t_torques, t_wind = tangents
    here, t_here = eqx.filter_jvp(pose, (arm, angles), (t_arm, t_angles))
    factor, accelerations = _factor_and_solve(arm, here, rates, torques, wind)

    def unbalanced(arm: Arm, here: Pose, rates: Array, torques: Array, wind: Array) -> Array:
        return torques - _required_torque(arm, here, rates, accelerations, wind)

    _, tangent = eqx.filter_jvp(
        unbalanced,
        (arm, here, rates, torques, wind),
        (t_arm, t_here, t_rates, t_torques, t_wind),
    )
    return accelerations, _solve(factor, tangent)


def joint_torque(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    command: Float[Array, " joint"],
) -> Float[Array, " joint"]:
    """Torque of the joints' springs and dampers, N m.

    The spring of a joint pulls towards its commanded angle (paper, III.A: a spring whose
    initial length can change); the damper acts on the joint's rate.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
    """
    return arm.joints.stiffness * (command - angles) - arm.joints.damping * rates


def acceleration(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    command: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations of the arm under its commands, rad/s^2: its equation of motion.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
        wind: velocity of the air in the base frame, m/s; still air by default.
    """
    return forward_dynamics(arm, angles, rates, joint_torque(arm, angles, rates, command), wind)
