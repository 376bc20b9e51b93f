"""Inertia of the links, the mass matrix, and the torque that a motion needs."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import (
    Array,
    Float,
    cross,
    derivative_barrier,
    dot,
    factor_with_rows,
    scaled,
    solve_lower,
    solve_upper,
)
from ._air import (
    Flow,
    Wind,
    added_mass,
    added_mass_load,
    drag,
    flow,
    lift_force,
    relative_velocity,
    with_field,
)
from ._arm import Arm, Bodies, bodies
from ._joint_laws import PerJoint
from ._kinematics import (
    Pose,
    Rows,
    angular_velocities,
    beside_axis,
    pose,
    sum_from_base,
    sum_from_tip,
)

# Spatial inertias about the base origin simply add, so the composite inertias are one reverse
# cumulative sum and M[k, j] = S_k . (I_composite_j S_j) for k <= j (Featherstone, Rigid Body
# Dynamics Algorithms, ch. 6, in base coordinates).


def mass_matrix(arm: Arm, angles: PerJoint) -> Float[Array, "joint joint"]:
    """Joint-space mass matrix M(q) at angles (rad), kg m^2; symmetric and positive definite."""
    here = pose(arm, angles)
    motion, momentum = motion_and_momentum(arm, here, sum_from_tip(carried_inertia(arm, here)))
    upper = jnp.triu(mass_matrix_upper(motion, momentum))
    if arm.joints.armature is not None:
        upper = upper + jnp.diag(jnp.broadcast_to(arm.joints.armature, angles.shape))
    return upper + jnp.triu(upper, 1).T


def motion_and_momentum(
    arm: Arm, here: Pose, carried: Float[Array, "12 link"]
) -> tuple[Float[Array, "6 joint"], Float[Array, "6 joint"]]:
    """Of each joint's unit rate: the motion S, and the momentum I S of all links that it carries.

    Both about the base origin, three angular rows before three linear ones; `carried` is
    `carried_inertia`, summed from the tip.
    """
    rod = added_mass(arm)
    mass = bodies(arm).mass if rod is None else bodies(arm).mass + rod.mass
    first, inertia = carried[:3], carried[3:].reshape(3, 3, -1)
    w = here.axis
    v = cross(here.joint, w)  # velocity, at the origin, of a body turning about the joint
    linear = scaled(sum_from_tip(mass[None])[0], v) + cross(w, first)
    turn = _tensor_times(inertia, w)
    motion = jnp.concatenate([w, v])
    momentum = jnp.concatenate([turn + cross(first, v), linear])
    if rod is not None:
        # Velocity of a link's centre along itself is this times the motion of the link.
        slip = jnp.concatenate([cross(here.centre, here.direction), here.direction])
        along = sum_from_tip(scaled(rod.mass, slip)[:, None] * slip[None])
        momentum = momentum - jnp.sum(along * motion[None], axis=1)
    return motion, momentum


def mass_matrix_upper(
    motion: Float[Array, "6 joint"], momentum: Float[Array, "6 joint"]
) -> Float[Array, "joint joint"]:
    """The mass matrix without armature, right on and above the diagonal only."""
    # XLA takes twice as long over one product of six rows.
    return motion[:3].T @ momentum[:3] + motion[3:].T @ momentum[3:]


def carried_inertia(arm: Arm, here: Pose) -> Float[Array, "12 link"]:
    """Moments of mass of each link and of the air that it moves, to be summed from the tip."""
    body, e = bodies(arm), here.direction
    ring = body.axial - body.transverse
    spatial = _about_origin(body.mass, here.mass_centre, e, body.transverse, ring)
    uneven = _uneven(body, here)
    if uneven is not None:
        spatial = spatial.at[3:].add(uneven.reshape(9, -1))
    rod = added_mass(arm)
    if rod is not None:
        # A rod that had its mass along itself, too; `motion_and_momentum` takes it away again.
        spatial = spatial + _about_origin(rod.mass, here.centre, e, rod.inertia, -rod.inertia)
    return spatial


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


def inertia_times(body: Bodies, here: Pose, vector: Rows) -> Rows:
    """Rotational inertia of each link about its centre of mass, times a vector."""
    along = (body.axial - body.transverse) * dot(here.direction, vector)
    product = scaled(body.transverse, vector) + scaled(along, here.direction)
    uneven = _uneven(body, here)
    return product if uneven is None else product + _tensor_times(uneven, vector)


def gyroscopic(body: Bodies, here: Pose, omega: Rows, leaning: Rows) -> Rows:
    """The couple omega x (I omega) of each link; `leaning` is the rate of its direction.

    Of a body that is round about its axis, only what it turns about that counts.
    """
    axial = (body.axial - body.transverse) * dot(here.direction, omega)
    couple = scaled(axial, leaning)
    uneven = _uneven(body, here)
    return couple if uneven is None else couple + cross(omega, _tensor_times(uneven, omega))


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


# Accelerations from the mass matrix, some joints at a time, from the tip to the base.
#
# The matrix is that of products, M[k, j] = a_k . b_j for k <= j, of the motion a = S_k and the
# momentum b = I_j S_j that go with each joint. Where the joints from some place to the tip are
# free to follow, what is left for those before it is of the same form, with b_j - Q a_j for b_j:
# Q is the part of the composite inertia that follows, and what remains is the articulated one
# (Featherstone, Rigid Body Dynamics Algorithms, ch. 7). Joint by joint that is his algorithm.
# Here LAPACK eliminates many joints at once, as a call of it takes as long as some thousand
# operations, but not all of a long arm, whose matrix takes n^3.

# Joints that are eliminated together, at most: two pieces of half as many take as long.
_TOGETHER = 48


class Piece(NamedTuple):
    """Joints that are eliminated together: their a, the lower Cholesky factor L of their part of
    the matrix, where all that follow are free, and their reach: b, of what is left of the inertia,
    times L^-T; None of the first joints.
    """

    motion: Float[Array, "6 joint"]
    factor: Float[Array, "joint joint"]
    reach: Float[Array, "6 joint"] | None


def eliminate_and_solve(
    motion: Float[Array, "6 joint"],
    momentum: Float[Array, "6 joint"],
    armature: Array | None,
    torque: PerJoint,
) -> tuple[tuple[Piece, ...], PerJoint]:
    """The pieces from the tip to the base, and the accelerations that a torque (N m) gives the
    joints.

    `motion` and `momentum` are a and b of the matrix, to whose diagonal `armature` is added, one
    number or one for each joint.
    """
    count = len(torque)
    pieces, halves = [], []
    taken: Array | None = None
    for begin, end in _from_tip(count):
        a, b, pull = motion[:, begin:end], momentum[:, begin:end], torque[None, begin:end]
        if taken is not None:
            both = taken @ a
            b, pull = b - both[:6], pull - both[6:]
        # LAPACK reads the lower triangle alone.
        matrix = mass_matrix_upper(a, b).T
        if armature is not None:
            matrix = matrix + jnp.diag(jnp.broadcast_to(armature, (count,))[begin:end])
        # For the first joints there is nobody to follow.
        rows = jnp.concatenate([b, pull]) if begin else pull
        factor, solved = factor_with_rows(matrix, rows)
        reach = solved[:6] if begin else None
        if reach is not None:
            followed = solved @ reach.T
            taken = followed if taken is None else taken + followed
        pieces.append(Piece(a, factor, reach))
        halves.append(solved[-1][:, None])
    return tuple(pieces), _back(pieces, halves)


def solve_eliminated(pieces: tuple[Piece, ...], torque: PerJoint) -> PerJoint:
    """The accelerations that another torque (N m) gives the joints whose pieces these are."""
    halves = []
    taken: Array | None = None
    for piece, (begin, end) in zip(pieces, _from_tip(len(torque)), strict=True):
        pull = torque[begin:end, None]
        if taken is not None:
            pull = pull - piece.motion.T @ taken
        half = solve_lower(piece.factor, pull)
        if piece.reach is not None:
            followed = piece.reach @ half
            taken = followed if taken is None else taken + followed
        halves.append(half)
    return _back(pieces, halves)


def _back(pieces: Sequence[Piece], halves: Sequence[Array]) -> Array:
    """Accelerations from the base to the tip, from L^-1 times the torques of each piece."""
    found = []
    carried: Array | None = None
    for piece, half in zip(reversed(pieces), reversed(halves), strict=True):
        if carried is not None:
            assert piece.reach is not None
            half = half - piece.reach.T @ carried
        found.append(solve_upper(piece.factor, half))
        if len(found) < len(pieces):
            moved = piece.motion @ found[-1]
            carried = moved if carried is None else carried + moved
    return jnp.concatenate(found)[:, 0]


def _from_tip(count: int) -> list[tuple[int, int]]:
    """Where pieces of about the same number of joints begin and end, the last ones first."""
    pieces = -(-count // _TOGETHER)
    ends = [count * each // pieces for each in range(pieces, -1, -1)]
    return [(begin, end) for end, begin in itertools.pairwise(ends)]


def inverse_dynamics(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    accelerations: PerJoint,
    wind: Wind | None = None,
    wind_rate: Wind | None = None,
    time: Any = 0.0,
) -> PerJoint:
    """Joint torques that produce accelerations against inertia, gravity and drag, N m.

    Springs and dampers of the joints are part of the torque, not of the load; see
    `joint_torque`.

    Arguments:
        angles, rates, accelerations: of the joints, rad, rad/s and rad/s^2.
        wind, wind_rate: of the air in the base frame, m/s and m/s^2; still air by default.
        time: s, of a wind field.
    """
    air = flow(arm, wind, wind_rate, time)
    return required_torque(arm, pose(arm, angles), rates, accelerations, air)


def required_torque(
    arm: Arm, here: Pose, rates: PerJoint, accelerations: PerJoint, wind: Flow
) -> PerJoint:
    """Inverse dynamics."""
    carried = sum_from_tip(carried_load(arm, here, rates, accelerations, wind))
    torque = load_torque(here, carried)
    if arm.joints.armature is not None:
        torque = torque + arm.joints.armature * accelerations
    return torque


def load_torque(here: Pose, carried: Float[Array, "6 link"]) -> PerJoint:
    """Torque about each joint's axis of what is carried beyond it."""
    return dot(here.axis, carried[3:] - cross(here.joint, carried[:3]))


def carried_load(
    arm: Arm, here: Pose, rates: PerJoint, accelerations: PerJoint | None, wind: Flow
) -> Float[Array, "6 link"]:
    """Force that each link needs and its moment about the origin, to be summed from the tip."""
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

    wind = with_field(arm, here, wind)
    relative = relative_velocity(arm, centre_velocity, wind)
    load = drag(arm, here, relative, omega, wind)
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
    # Of a round body alone, what turns it is made of few operations.
    heavy = rod is not None or body.uneven is not None or load.couple is not None
    apart = derivative_barrier(jnp.concatenate([inertial, force, *([spin] if heavy else [])]))
    inertial, force, spin = apart[:3], apart[3:6], apart[6:] if heavy else spin
    moment = spin + cross(here.mass_centre, inertial) - cross(here.centre, force)
    return jnp.concatenate([inertial - force, moment])


def _from_rest(
    arm: Arm, here: Pose, accelerations: PerJoint | None
) -> tuple[Rows, Rows, Rows, Rows, Rows]:
    """What moves the links without any velocity, in the order of `added_mass_load`."""
    still = jnp.zeros_like(here.direction)
    if accelerations is None:
        return still, still, still, still, still
    alpha = sum_from_base(scaled(accelerations, here.axis))
    leap = scaled(arm.links.length, cross(alpha, here.direction))
    return still, still, still, alpha, sum_from_base(leap) - leap / 2
