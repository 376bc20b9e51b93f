"""Inertia of the links, mass matrix, inverse dynamics, and the solution for accelerations."""

import itertools
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import (
    Array,
    Float,
    Scalar,
    cross,
    derivative_barrier,
    dot,
    factor_with_rows,
    scaled,
    solve_lower,
    solve_upper,
)
from ...runtime.programs import traced_once
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

# Spatial inertias about the base origin are additive, so the composite inertias are one reverse
# cumulative sum, and M[k, j] = S_k . (I_composite_j S_j) for k <= j (Featherstone, Rigid Body
# Dynamics Algorithms, ch. 6, in base coordinates).


def mass_matrix(arm: Arm, angles: PerJoint) -> Float[Array, "joint joint"]:
    """Return the mass matrix M(q) at joint angles (rad), kg m^2; symmetric, positive definite."""
    here = pose(arm, angles)
    motion, momentum = motion_and_momentum(arm, here, sum_from_tip(carried_inertia(arm, here)))
    upper = jnp.triu(mass_matrix_upper(motion, momentum))
    if arm.joints.armature is not None:
        upper = upper + jnp.diag(jnp.broadcast_to(arm.joints.armature, angles.shape))
    return upper + jnp.triu(upper, 1).T


def motion_and_momentum(
    arm: Arm, here: Pose, carried: Float[Array, "12 link"]
) -> tuple[Float[Array, "6 joint"], Float[Array, "6 joint"]]:
    """Return motion S and momentum I S of all links beyond each joint, per unit of its rate.

    Both refer to the base origin, with three angular rows followed by three linear rows.

    Arguments:
        arm: the arm.
        here: configuration of the arm.
        carried: `carried_inertia`, summed from the tip.
    """
    rod = added_mass(arm)
    mass = bodies(arm).mass if rod is None else bodies(arm).mass + rod.mass
    first, inertia = carried[:3], carried[3:].reshape(3, 3, -1)
    w = here.axis
    v = cross(here.joint, w)  # velocity at the origin of a body that rotates about the joint
    linear = scaled(sum_from_tip(mass[None])[0], v) + cross(w, first)
    turn = _tensor_times(inertia, w)
    motion = jnp.concatenate([w, v])
    momentum = jnp.concatenate([turn + cross(first, v), linear])
    if rod is not None:
        # The axial velocity of a link centre is the scalar product of `slip` and the link motion.
        slip = jnp.concatenate([cross(here.centre, here.direction), here.direction])
        along = sum_from_tip(scaled(rod.mass, slip)[:, None] * slip[None])
        momentum = momentum - jnp.sum(along * motion[None], axis=1)
    return motion, momentum


def mass_matrix_upper(
    motion: Float[Array, "6 joint"], momentum: Float[Array, "6 joint"]
) -> Float[Array, "joint joint"]:
    """Return the mass matrix without armature, valid only on and above the diagonal."""
    # A single product of six rows takes XLA twice as long.
    return motion[:3].T @ momentum[:3] + motion[3:].T @ momentum[3:]


def carried_inertia(arm: Arm, here: Pose) -> Float[Array, "12 link"]:
    """Return the moments of mass of each link with its added mass, to be summed from the tip."""
    body, e = bodies(arm), here.direction
    ring = body.axial - body.transverse
    spatial = _about_origin(body.mass, here.mass_centre, e, body.transverse, ring)
    uneven = _uneven(body, here)
    if uneven is not None:
        spatial = spatial.at[3:].add(uneven.reshape(9, -1))
    rod = added_mass(arm)
    if rod is not None:
        # This includes the axial inertia of the rod, which `motion_and_momentum` subtracts again.
        spatial = spatial + _about_origin(rod.mass, here.centre, e, rod.inertia, -rod.inertia)
    return spatial


def _about_origin(
    mass: Array, x: Rows, direction: Rows, transverse: Array, ring: Array
) -> Float[Array, "12 link"]:
    """Return the moments of mass of axisymmetric bodies about the base origin.

    These are the first moments and nine rows of the inertia. Six rows would be sufficient, but
    computing nine rows in one product is faster than computing six rows separately.

    Arguments:
        mass: mass of each body, kg.
        x: centre of mass of each body, m.
        direction: axis of each body.
        transverse: transverse moment of inertia, kg m^2.
        ring: axial minus transverse moment of inertia, kg m^2.
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
    """Return the inertia of each link about its centre of mass, multiplied by a vector."""
    along = (body.axial - body.transverse) * dot(here.direction, vector)
    product = scaled(body.transverse, vector) + scaled(along, here.direction)
    uneven = _uneven(body, here)
    return product if uneven is None else product + _tensor_times(uneven, vector)


def gyroscopic(body: Bodies, here: Pose, omega: Rows, leaning: Rows) -> Rows:
    """Return the couple omega x (I omega) of each link.

    For an axisymmetric body, it depends only on the rotation about the axis.

    Arguments:
        body: rigid bodies of the links.
        here: configuration of the arm.
        omega: angular velocity of each link, rad/s.
        leaning: rate of change of the direction of each link, 1/s.
    """
    axial = (body.axial - body.transverse) * dot(here.direction, omega)
    couple = scaled(axial, leaning)
    uneven = _uneven(body, here)
    return couple if uneven is None else couple + cross(omega, _tensor_times(uneven, omega))


def _uneven(body: Bodies, here: Pose) -> Float[Array, "3 3 link"] | None:
    """Return the contribution of off-axis masses to the inertia, in the base frame."""
    if body.uneven is None:
        return None
    assert here.left is not None
    frame = jnp.stack([here.direction, here.left, here.up])
    xx, yy, zz, xy, xz, yz = body.uneven
    tensor = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    # Compute X R', then R X R'. The rows of `frame` contain the columns of R.
    turned = [_sum3(scaled(row[k], frame[k]) for k in range(3)) for row in tensor]
    return _sum3(frame[k][:, None] * turned[k][None] for k in range(3))


def _tensor_times(tensor: Float[Array, "3 3 *shape"], v: Rows) -> Rows:
    return _sum3(scaled(v[i], tensor[:, i]) for i in range(3))


def _sum3(terms: Iterable[Array]) -> Array:
    x, y, z = terms
    return x + y + z


# Accelerations from the mass matrix, computed block by block from the tip to the base.
#
# The matrix consists of the products M[k, j] = a_k . b_j for k <= j of the motion a_k = S_k and the
# momentum b_j = I_j S_j of the joints. If the joints from some joint to the tip are eliminated, the
# matrix of the remaining joints has the same form with b_j - Q a_j instead of b_j. Q is the part of
# the composite inertia that is free to follow, and the remainder is the articulated-body inertia
# (Featherstone, Rigid Body Dynamics Algorithms, ch. 7). If joints are eliminated one by one, this
# is his algorithm, and batches on a CPU use it. For a single arm and for derivatives, LAPACK
# eliminates many joints at once, because one call takes as long as about a thousand operations. It
# does not eliminate all joints of a long arm at once, because the time for one matrix is
# proportional to n^3.

# Largest number of joints that are eliminated together. At this number, two blocks of half the size
# take the same time.
_TOGETHER = 48


class Piece(NamedTuple):
    """A block of joints that are eliminated together.

    Attributes:
        motion: the vectors a of the joints.
        factor: lower Cholesky factor L of the block of the matrix, after all joints beyond it have
            been eliminated.
        reach: the vectors b for the remaining inertia, multiplied by L^-T; None for the block of
            the first joints.
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
    """Eliminate the joints from the tip to the base, and solve for the accelerations.

    Arguments:
        motion: vectors a of the matrix.
        momentum: vectors b of the matrix.
        armature: armature inertia that is added to the diagonal, kg m^2; one number, or one for
            each joint.
        torque: joint torques, N m.

    Returns:
        The blocks in order from the tip to the base, and the joint accelerations, rad/s^2.
    """
    count = len(torque)
    pieces, halves = [], []
    taken: Array | None = None
    for begin, end in _from_tip(count):
        a, b, pull = motion[:, begin:end], momentum[:, begin:end], torque[None, begin:end]
        if taken is not None:
            both = taken @ a
            b, pull = b - both[:6], pull - both[6:]
        # LAPACK reads only the lower triangle.
        matrix = mass_matrix_upper(a, b).T
        if armature is not None:
            matrix = matrix + jnp.diag(jnp.broadcast_to(armature, (count,))[begin:end])
        # No joints remain before the first block, so it needs no `reach`.
        rows = jnp.concatenate([b, pull]) if begin else pull
        factor, solved = factor_with_rows(matrix, rows)
        reach = solved[:6] if begin else None
        if reach is not None:
            followed = solved @ reach.T
            taken = followed if taken is None else taken + followed
        pieces.append(Piece(a, factor, reach))
        halves.append(solved[-1][:, None])
    return tuple(pieces), _back(pieces, halves)


@jax.custom_batching.custom_vmap
def solve_accelerations(
    motion: Float[Array, "6 joint"],
    momentum: Float[Array, "6 joint"],
    armature: Array | None,
    torque: PerJoint,
) -> PerJoint:
    """Return the joint accelerations of `eliminate_and_solve`.

    A batch of at least four items is solved joint by joint on a CPU, for all items at once, which
    are stored last. This takes half as long as LAPACK calls for each item. Derivatives use
    `eliminate_and_solve` instead.
    """
    return eliminate_and_solve(motion, momentum, armature, torque)[1]


# For 20 joints, the time is the same for three items (on one core: 5.7 us for each of two items in
# both ways, 5.4 and 5.0 us of four, 4.3 and 3.3 us of 64).
_MANY = 4


@solve_accelerations.def_vmap
def _solve_batch(size: int, batched: Any, *given: Any) -> tuple[Array, bool]:
    def items(x: Array, has: bool) -> Array:
        return x if has else jnp.broadcast_to(x, (size, *x.shape))

    given = jax.tree.map(items, given, tuple(batched))
    by_item = jax.vmap(lambda *each: eliminate_and_solve(*each)[1])
    if size < _MANY:
        return by_item(*given), True
    return jax.lax.platform_dependent(*given, cpu=_joint_by_joint, default=by_item), True


def _joint_by_joint(
    motion: Float[Array, "item 6 joint"],
    momentum: Float[Array, "item 6 joint"],
    armature: Float[Array, "item *joint"] | None,
    torque: Float[Array, "item joint"],
) -> Float[Array, "item joint"]:
    """Eliminate one joint after the other: the articulated-body algorithm."""
    size = len(torque)
    added = None
    if armature is not None:
        added = jnp.broadcast_to(armature.reshape(size, -1), torque.shape).T.astype(torque.dtype)
    # With the items last, each operation works on whole vector registers.
    joints = motion.transpose(2, 1, 0), momentum.transpose(2, 1, 0), torque.T, added

    def product(x: Float[Array, "*row 6 item"], y: Float[Array, "6 item"]) -> Any:
        y = y.reshape(*(1,) * (x.ndim - 2), *y.shape)
        return sum(x[..., k, :] * y[..., k, :] for k in range(6))

    def eliminate(taken: Array, joint: Any) -> tuple[Array, tuple[Array, Array]]:
        # `taken` is Q, and below it a row for the torque.
        a, b, torque, added = joint
        moved = product(taken, a)
        row, pull = b - moved[:6], torque - moved[6]
        pivot = product(row, a)
        if added is not None:
            pivot = pivot + added
        # As a Cholesky factorisation, this fails for a matrix that is not positive definite.
        pivot = jnp.where(pivot > 0, pivot, jnp.nan)
        reach = row / pivot[None]
        taken = taken + jnp.concatenate([row, pull[None]])[:, None] * reach[None]
        return taken, (reach, pull / pivot)

    def substitute(moved: Array, joint: Any) -> tuple[Array, Array]:
        a, reach, half = joint
        found = half - product(reach, moved)
        return moved + a * found[None], found

    none = jnp.zeros((7, 6, size), torque.dtype)
    _, (reach, half) = jax.lax.scan(eliminate, none, joints, reverse=True)
    found: Array = jax.lax.scan(substitute, none[0], (joints[0], reach, half))[1]
    return found.T


def solve_eliminated(pieces: tuple[Piece, ...], torque: PerJoint) -> PerJoint:
    """Return the joint accelerations for another torque (N m), from the eliminated blocks."""
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
    """Substitute backwards from the base to the tip, from L^-1 times the torques of each block."""
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
    """Return the index ranges of blocks of about equal size, in order from the tip to the base."""
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
    """Return the joint torques required for accelerations against inertia, gravity and drag, N m.

    The springs and dampers of the joints contribute to these torques; see `joint_torque`.

    Arguments:
        arm: the arm.
        angles, rates, accelerations: joint angles, rad, joint rates, rad/s, and joint
            accelerations, rad/s^2.
        wind, wind_rate: velocity of the air in the base frame, m/s, and its rate of change, m/s^2;
            still air by default.
        time: time at which a wind field is evaluated, s.
    """
    # A program is specialised to the value of a Python number. As an array, this number remains
    # weakly typed and does not change the precision.
    at = jnp.asarray(time)
    return _inverse_dynamics(arm, angles, rates, accelerations, wind, wind_rate, at)


@traced_once
def _inverse_dynamics(
    arm: Arm,
    angles: PerJoint,
    rates: PerJoint,
    accelerations: PerJoint,
    wind: Wind | None,
    wind_rate: Wind | None,
    time: Scalar,
) -> PerJoint:
    air = flow(arm, wind, wind_rate, time)
    return required_torque(arm, pose(arm, angles), rates, accelerations, air)


def required_torque(
    arm: Arm, here: Pose, rates: PerJoint, accelerations: PerJoint, wind: Flow
) -> PerJoint:
    """Return the inverse dynamics for a given pose: the required joint torques, N m."""
    carried = sum_from_tip(carried_load(arm, here, rates, accelerations, wind))
    torque = load_torque(here, carried)
    if arm.joints.armature is not None:
        torque = torque + arm.joints.armature * accelerations
    return torque


def load_torque(here: Pose, carried: Float[Array, "6 link"]) -> PerJoint:
    """Return the torque about each joint axis due to the loads beyond the joint, N m."""
    return dot(here.axis, carried[3:] - cross(here.joint, carried[:3]))


def carried_load(
    arm: Arm, here: Pose, rates: PerJoint, accelerations: PerJoint | None, wind: Flow
) -> Float[Array, "6 link"]:
    """Return the force required by each link and its moment about the origin.

    The result must be summed from the tip.
    """
    links, body, e = arm.links, bodies(arm), here.direction

    turning = scaled(rates, here.axis)
    omega = angular_velocities(here, rates)
    # The axis of a joint rotates with the links before it, which causes the Coriolis term.
    gain = cross(omega, turning)
    if accelerations is not None:
        gain = gain + scaled(accelerations, here.axis)
    # The velocities and accelerations of all points on the axes are computed from the first and
    # second derivatives of the directions. This needs fewer cross products, for which XLA computes
    # the operands again in each component.
    leaning = cross(omega, e)
    span_velocity = scaled(links.length, leaning)
    # Sums along the chain take most of the time of an evaluation, almost independently of the
    # number of rows, so both sums are computed together.
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
    # For axisymmetric bodies alone, `spin` requires few operations and is not put behind the
    # barrier.
    heavy = rod is not None or body.uneven is not None or load.couple is not None
    apart = derivative_barrier(jnp.concatenate([inertial, force, *([spin] if heavy else [])]))
    inertial, force, spin = apart[:3], apart[3:6], apart[6:] if heavy else spin
    moment = spin + cross(here.mass_centre, inertial) - cross(here.centre, force)
    return jnp.concatenate([inertial - force, moment])


def _from_rest(
    arm: Arm, here: Pose, accelerations: PerJoint | None
) -> tuple[Rows, Rows, Rows, Rows, Rows]:
    """Return the motion of the links at zero velocity, in the argument order of `added_mass_load`.

    Only the accelerations are not zero.
    """
    still = jnp.zeros_like(here.direction)
    if accelerations is None:
        return still, still, still, still, still
    alpha = sum_from_base(scaled(accelerations, here.axis))
    leap = scaled(arm.links.length, cross(alpha, here.direction))
    return still, still, still, alpha, sum_from_base(leap) - leap / 2
