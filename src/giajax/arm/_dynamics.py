"""Equations of motion in world-frame composite form.

Spatial inertias about the base origin simply add, so the composite inertias are one reverse
cumulative sum and M[k, j] = S_k . (I_composite_j S_j) for k <= j (Featherstone, Rigid Body
Dynamics Algorithms, ch. 6, in base coordinates).
"""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, scaled
from .._typing import Array, Float
from ._air import (
    Flow,
    added_mass,
    added_mass_load,
    drag,
    flow,
    lift_force,
    relative_velocity,
)
from ._bodies import Bodies, bodies
from ._chain import Arm
from ._kinematics import Pose, Rows, angular_velocities, pose, sum_from_base, sum_from_tip


def _uneven(body: Bodies, here: Pose) -> Float[Array, "3 3 link"] | None:
    """What off-axis masses add to the inertia, in the base frame."""
    if body.uneven is None:
        return None
    assert here.left is not None
    frame = jnp.stack([here.direction, here.left, here.up])
    xx, yy, zz, xy, xz, yz = body.uneven
    tensor = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    # X R', then R X R', with the columns of R in the rows of `frame`.
    turned = [_sum3(scaled(row[k], frame[k]) for k in range(3)) for row in tensor]
    return _sum3(frame[k][:, None] * turned[k][None] for k in range(3))


def _tensor_times(tensor: Float[Array, "3 3 *shape"], v: Rows) -> Rows:
    return _sum3(scaled(v[i], tensor[:, i]) for i in range(3))


def _sum3(terms: Iterable[Array]) -> Array:
    x, y, z = terms
    return x + y + z


def _inertia_times(body: Bodies, here: Pose, vector: Rows) -> Rows:
    """Rotational inertia of each link about its centre of mass, times a vector."""
    along = (body.axial - body.transverse) * dot(here.direction, vector)
    product = scaled(body.transverse, vector) + scaled(along, here.direction)
    uneven = _uneven(body, here)
    return product if uneven is None else product + _tensor_times(uneven, vector)


def _about_origin(
    mass: Array, x: Rows, direction: Rows, transverse: Array, ring: Array
) -> Float[Array, "12 link"]:
    """Moments of mass, about the base origin, of bodies that are round about the links' axes.

    The first moments, and the inertia as nine rows, where six would do: they come out of one
    product, and a stack of rows that are computed one by one costs more than their sum.
    `ring` is axial - transverse.
    """
    first = scaled(mass, x)
    round_part = transverse + dot(first, x)
    inertia = (
        scaled(ring, direction)[:, None] * direction[None]
        - first[:, None] * x[None]
        + np.eye(3, dtype=first.dtype)[:, :, None] * round_part[None, None]
    )
    return jnp.concatenate([first, inertia.reshape(9, -1)])


def _carried_inertia(arm: Arm, here: Pose) -> Float[Array, "12 link"]:
    """Moments of mass of each link and of the air that it moves, to be summed from the tip."""
    body, e = bodies(arm), here.direction
    ring = body.axial - body.transverse
    spatial = _about_origin(body.mass, here.mass_centre, e, body.transverse, ring)
    uneven = _uneven(body, here)
    if uneven is not None:
        spatial = spatial.at[3:].add(uneven.reshape(9, -1))
    rod = added_mass(arm)
    if rod is not None:
        # A rod that had its mass along itself, too; `_mass_matrix_upper` takes it away again.
        spatial = spatial + _about_origin(rod.mass, here.centre, e, rod.inertia, -rod.inertia)
    return spatial


def _mass_matrix_upper(
    arm: Arm, here: Pose, carried: Float[Array, "12 link"]
) -> Float[Array, "joint joint"]:
    """The mass matrix, right on and above the diagonal only, from summed moments of mass."""
    e, rod = here.direction, added_mass(arm)
    mass = bodies(arm).mass if rod is None else bodies(arm).mass + rod.mass
    first, inertia = carried[:3], carried[3:].reshape(3, 3, -1)
    w = here.axis
    v = cross(here.joint, w)  # velocity, at the origin, of a body turning about the joint
    momentum = scaled(sum_from_tip(mass[None])[0], v) + cross(w, first)
    turn = _tensor_times(inertia, w)
    upper = w.T @ (turn + cross(first, v)) + v.T @ momentum
    if rod is not None:
        # Velocity of each link's centre along itself, by the rate of each joint before it.
        slip = jnp.triu(w.T @ cross(here.centre, e) + v.T @ e)
        upper = upper - (slip * rod.mass[None]) @ slip.T
    if arm.joints.armature is not None:
        upper = upper + jnp.diag(jnp.broadcast_to(arm.joints.armature, w.shape[1:]))
    return upper


def _carried_load(
    arm: Arm,
    here: Pose,
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"] | None,
    wind: Flow,
) -> Float[Array, "6 link"]:
    """Force that each link needs and its moment about the origin, to be summed from the tip.

    No accelerations stand for zero accelerations.
    """
    links, body, e = arm.links, bodies(arm), here.direction
    span = scaled(links.length, e)

    turning = scaled(rates, here.axis)
    omega = angular_velocities(here, rates)
    # The axis of a joint turns with the links before it, which is the Coriolis term.
    gain = cross(omega, turning)
    if accelerations is not None:
        gain = gain + scaled(accelerations, here.axis)
    span_velocity = cross(omega, span)
    # Sums along the chain are what an evaluation spends its time on, few rows or many.
    summed = sum_from_base(jnp.concatenate([gain, span_velocity]))
    alpha, end_velocity = summed[:3], summed[3:]

    def acceleration_of(offset: Rows) -> Rows:
        return cross(alpha, offset) + cross(omega, cross(omega, offset))

    span_acceleration = cross(alpha, span) + cross(omega, span_velocity)
    centre_velocity = end_velocity - span_velocity / 2
    joint_acceleration = sum_from_base(span_acceleration) - span_acceleration
    mass_acceleration = joint_acceleration + acceleration_of(here.mass_centre - here.joint)
    upwards = jnp.zeros((3, 1), span.dtype).at[2, 0].set(1) * arm.gravity
    inertial = scaled(body.mass, mass_acceleration + upwards)
    spin = _inertia_times(body, here, alpha) + cross(omega, _inertia_times(body, here, omega))

    relative = relative_velocity(arm, centre_velocity, wind)
    leaning = cross(omega, e)
    load = drag(arm, here, relative, leaning)
    force = load.force
    if load.couple is not None:
        spin = spin - load.couple
    lifted = lift_force(arm)
    if lifted is not None:
        force = force + lifted
    rod = added_mass(arm)
    if rod is not None:
        centre_acceleration = joint_acceleration + span_acceleration / 2
        push, couple = added_mass_load(
            arm, rod, here, relative, leaning, omega, alpha, centre_acceleration, wind
        )
        force, spin = force + push, spin - couple
    moment = spin + cross(here.mass_centre, inertial) - cross(here.centre, force)
    return jnp.concatenate([inertial - force, moment])


def _load_torque(here: Pose, carried: Float[Array, "6 link"]) -> Float[Array, " joint"]:
    """Torque about each joint's axis of what is carried beyond it."""
    return dot(here.axis, carried[3:] - cross(here.joint, carried[:3]))


def _required_torque(
    arm: Arm,
    here: Pose,
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"],
    wind: Flow,
) -> Float[Array, " joint"]:
    """Inverse dynamics."""
    carried = sum_from_tip(_carried_load(arm, here, rates, accelerations, wind))
    torque = _load_torque(here, carried)
    if arm.joints.armature is not None:
        torque = torque + arm.joints.armature * accelerations
    return torque


def mass_matrix(arm: Arm, angles: Float[Array, " joint"]) -> Float[Array, "joint joint"]:
    """Joint-space mass matrix M(q), kg m^2; symmetric and positive definite.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
    """
    here = pose(arm, angles)
    upper = jnp.triu(_mass_matrix_upper(arm, here, sum_from_tip(_carried_inertia(arm, here))))
    return upper + jnp.triu(upper, 1).T


def inverse_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    accelerations: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
    wind_rate: Float[Array, "3"] | None = None,
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
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.
    """
    return _required_torque(
        arm, pose(arm, angles), rates, accelerations, flow(arm, wind, wind_rate)
    )


def forward_dynamics(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    torques: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
    wind_rate: Float[Array, "3"] | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations under given joint torques, gravity and drag, rad/s^2.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        torques: joint torques, N m.
        wind: velocity of the air in the base frame, m/s; still air by default.
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.
    """
    return _accelerations(arm, angles, rates, torques, flow(arm, wind, wind_rate))


def _factor_and_solve(
    arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow
) -> tuple[Array, Array]:
    load, inertia = _carried_load(arm, here, rates, None, wind), _carried_inertia(arm, here)
    carried = sum_from_tip(jnp.concatenate([load, inertia]))
    # LAPACK reads the lower triangle only, so the upper one need not be copied there.
    matrix = _mass_matrix_upper(arm, here, carried[6:]).T
    factor = jax.lax.linalg.cholesky(matrix, symmetrize_input=False)
    return factor, _solve(factor, torques - _load_torque(here, carried[:6]))


def _solve(factor: Float[Array, "joint joint"], b: Float[Array, " joint"]) -> Array:
    half = jax.lax.linalg.triangular_solve(factor, b[:, None], left_side=True, lower=True)
    return jax.lax.linalg.triangular_solve(
        factor, half, left_side=True, lower=True, transpose_a=True
    )[:, 0]


@eqx.filter_custom_jvp
def _accelerations(arm: Arm, angles: Array, rates: Array, torques: Array, wind: Flow) -> Array:
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

    def unbalanced(arm: Arm, here: Pose, rates: Array, torques: Array, wind: Flow) -> Array:
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
    """Torque of the joints' springs, dampers and friction, N m.

    The spring of a joint pulls towards its commanded angle (paper, III.A: a spring whose
    initial length can change); damping c and Coulomb friction f act against the joint's rate
    by c v + f tanh(v / v0).

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
    """
    return arm.joints.stiffness * (command - angles) - arm.joints.resistance(rates)


def acceleration(
    arm: Arm,
    angles: Float[Array, " joint"],
    rates: Float[Array, " joint"],
    command: Float[Array, " joint"],
    wind: Float[Array, "3"] | None = None,
    wind_rate: Float[Array, "3"] | None = None,
    torque: Float[Array, " joint"] | None = None,
) -> Float[Array, " joint"]:
    """Joint accelerations of the arm under its commands, rad/s^2: its equation of motion.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        rates: joint rates, rad/s.
        command: commanded angles, rad.
        wind: velocity of the air in the base frame, m/s; still air by default.
        wind_rate: its rate of change, m/s^2, which added mass feels; 0 by default.
        torque: of the joints' drives, beside springs and dampers, N m; none by default.
    """
    total = joint_torque(arm, angles, rates, command)
    if torque is not None:
        total = total + torque
    return forward_dynamics(arm, angles, rates, total, wind, wind_rate)
