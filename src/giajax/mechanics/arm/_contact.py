"""Contact of inflated links with obstacles: geometry, forces, energy and stiffness."""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

import equinox.internal as eqxi
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Bool, Float, Int, Scalar, cross, dot, larger, limited, scaled
from ...runtime.text import InputError
from ..obstacles import Lines, Nearest, nearest, owners, patches, solids
from ._arm import Arm
from ._inverse_dynamics import load_torque
from ._joint_laws import PerJoint
from ._kinematics import Pose, Rows, angular_velocities, pose, sum_from_base, sum_from_tip
from ._parts import Contact

Points = Float[Array, "3 pair point"]
Numbers = Float[Array, "pair point"]


class Pairs(NamedTuple):
    """Pairs of a link and a box that may be in contact, with indices from 0.

    Attributes:
        link: index of the link of each pair.
        box: index of the box of each pair.
    """

    link: Int[Array, " pair"]
    box: Int[Array, " pair"]


class Meeting(NamedTuple):
    """Contact of links with boxes, at quadrature points on the link axes.

    The elastic force is the derivative of the energy as computed by the quadrature. Energy is
    therefore conserved when a link is pressed and released, even with few points.

    Attributes:
        link: index of the link of each pair.
        energy: elastic energy of all contacts, J.
        force: elastic force on the link of each pair, N.
        couple: elastic couple on this link about its joint, N m.
        place: positions of the points on the link axis, m.
        normal: unit vectors away from the box at the points.
        distance: distance of the axis from the surface of the box, m.
        depth: radius minus distance, at least 0, m.
        load: elastic force that each point represents, N.
        closing: rate of decrease of the distance, m/s.
        sliding: velocity of the skin of the link along the surface, m/s.
    """

    link: Int[Array, " pair"]
    energy: Scalar
    force: Float[Array, "3 pair"]
    couple: Float[Array, "3 pair"]
    place: Points
    normal: Points
    distance: Numbers
    depth: Numbers
    load: Numbers
    closing: Numbers
    sliding: Points

    def of_links(self, x: Float[Array, "row pair"], links: int) -> Float[Array, "row link"]:
        """Return the sum over the pairs of each link, for the given number of links."""
        return x @ jax.nn.one_hot(self.link, links, dtype=x.dtype)


def meeting(arm: Arm, contact: Contact, here: Pose, rates: PerJoint, pairs: Pairs) -> Meeting:
    """Compute the contact of the links of an arm with boxes in one state."""
    lines, frame = _lines(arm, contact, here, pairs)
    places, sizes = np.polynomial.legendre.leggauss(contact.points)
    nodes, weights = (jnp.asarray(x / 2, lines.start.dtype) for x in (1 + places, sizes))
    line = contact.line(arm.links)[pairs.link, None]

    def flat(pieces: Float[Array, "pair piece point"]) -> Numbers:
        return pieces.reshape(len(pieces), -1)

    def flattened(start: Array, direction: Array) -> tuple[Scalar, tuple[Array, ...]]:
        """Return the energy, and the quadrature points from which it is computed."""
        moved = lines._replace(start=start, direction=direction)
        found = patches(moved)
        # There are three pieces, and the distance is smooth in each of them.
        wide = jnp.diff(found.knots, axis=0).T[:, :, None]
        at = flat(found.knots[:-1].T[:, :, None] + wide * nodes[None, None])
        near = _look(moved, at)
        deep = larger(lines.radius[:, None] - near.distance, 0)
        depth = jnp.where(found.touching[:, None], deep, 0)
        load = line * depth * flat(wide * weights[None, None])
        return jnp.sum(load * depth) / 2, (at, near.distance, near.normal, depth, load)

    energy, slopes, (along, distance, normal, depth, load) = jax.vjp(
        flattened, lines.start, lines.direction, has_aux=True
    )
    by_start, by_direction = (_turned(frame, each) for each in slopes(jnp.ones_like(energy)))
    normal = _turned(frame, normal)
    direction = here.direction[:, pairs.link]

    omega = angular_velocities(here, rates)
    speed = cross(omega, scaled(arm.links.length, here.direction))
    first, turning = (sum_from_base(speed) - speed, cross(omega, here.direction))
    velocity = first[:, pairs.link, None] + turning[:, pairs.link, None] * along[None]
    spin = jnp.broadcast_to(omega[:, pairs.link, None], normal.shape)
    skin = velocity - cross(spin, scaled(distance, normal))
    return Meeting(
        link=pairs.link,
        energy=energy,
        force=-by_start,
        couple=-cross(direction, by_direction),
        place=here.joint[:, pairs.link, None] + direction[:, :, None] * along[None],
        normal=normal,
        distance=distance,
        depth=depth,
        load=load,
        closing=-dot(normal, velocity),
        sliding=skin - scaled(dot(normal, skin), normal),
    )


def flattening(arm: Arm, contact: Contact, here: Pose, pairs: Pairs) -> Float[Array, " pair"]:
    """Return the largest flattening of links by boxes, m.

    The flattening is the radius of the link minus the distance of its axis from the box. If the
    axis is outside the box, the distance is smallest at the nearest position. Inside, the distance
    is the maximum of the signed distances from six planes. It is convex, and smallest where two of
    these distances are equal, or at an end.
    """
    lines, _ = _lines(arm, contact, here, pairs)
    found = patches(lines)
    faces = jnp.concatenate([lines.start, -lines.start]) - jnp.tile(lines.half, (2, 1))
    slopes = jnp.concatenate([lines.direction, -lines.direction])
    one, other = np.triu_indices(6, 1)
    turning = slopes[one] - slopes[other]
    alike = (faces[other] - faces[one]) / jnp.where(turning == 0, jnp.inf, turning)
    begin, end = found.knots[:1], found.knots[-1:]
    places = jnp.concatenate([begin, found.nearest[None], limited(alike, begin, end), end])
    depth = lines.radius - jnp.min(_look(lines, places.T).distance, axis=1)
    return jnp.where(found.touching, larger(depth, 0), 0)


def clearance(arm: Arm, angles: PerJoint) -> Float[Array, "link box"]:
    """Return the distances of the skin of links from the boxes of obstacles, m.

    A distance is negative if the link penetrates the box. The box of a plane is the half space, and
    an opening is surrounded by eight boxes. If the axis of a link passes through a box, the
    distance is evaluated in the middle of the part inside, which need not be the deepest point.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.

    Raises:
        InputError: the arm has no obstacles.
    """
    if arm.contact is None:
        raise InputError("the arm has no obstacles, so it has no clearance: add obstacles")
    boxes = len(owners(arm.contact.obstacles))
    link, box = (grid.ravel() for grid in jnp.indices((arm.count, boxes)))
    lines, _ = _lines(arm, arm.contact, pose(arm, angles), Pairs(link, box))
    # Find the nearest position as if no face were shared, because a link beyond a shared face is
    # also near the box. The distance below excludes shared faces, because a link cannot leave a box
    # through them.
    alone = lines._replace(shared=jnp.zeros_like(lines.shared))
    # To first order, the distance does not depend on the nearest position.
    near = jax.lax.stop_gradient(patches(alone).nearest)
    distance = _look(lines, near[:, None]).distance[:, 0] - lines.radius
    return distance.reshape(arm.count, boxes)


def in_reach(arm: Arm, contact: Contact, here: Pose) -> Bool[Array, "link box"]:
    """Return whether links may be in contact with boxes, from an inexpensive upper bound."""
    arm, contact, here = jax.lax.stop_gradient((arm, contact, here))
    boxes = solids(contact.obstacles)
    beside = here.centre[:, :, None] - boxes.centre[:, None]
    middle = jnp.sum(boxes.frame[:, :, None] * beside[:, None], axis=0)
    outside = larger(jnp.abs(middle) - boxes.half[:, None], 0)
    reach = (arm.links.length + arm.links.diameter) / 2
    return dot(outside, outside) < reach[:, None] ** 2


def _lines(arm: Arm, contact: Contact, here: Pose, pairs: Pairs) -> tuple[Lines, Array]:
    """Return the axes of links in the frames of boxes, and these frames."""
    boxes, links = solids(contact.obstacles), arm.links
    frame = boxes.frame[:, :, pairs.box]
    back = jnp.swapaxes(frame, 0, 1)
    beside = here.joint[:, pairs.link] - boxes.centre[:, pairs.box]
    shared = jnp.asarray(boxes.shared, beside.dtype)[:, :, pairs.box]
    length, radius = links.length[pairs.link], links.diameter[pairs.link] / 2
    start, direction = _turned(back, beside), _turned(back, here.direction[:, pairs.link])
    return Lines(start, direction, length, radius, boxes.half[:, pairs.box], shared), frame


def _turned(frame: Float[Array, "3 3 pair"], x: Float[Array, "3 pair *point"]) -> Array:
    """Transform vectors from the frames of boxes to the base frame."""
    return jnp.sum(frame.reshape(*frame.shape, *(1,) * (x.ndim - 2)) * x[None], axis=1)


def _look(lines: Lines, places: Numbers) -> Nearest:
    x = lines.start[..., None] + lines.direction[..., None] * places[None]
    return nearest(x, lines.half[..., None], lines.shared[..., None])


T = TypeVar("T")

_FEW = 24  # number of pairs in the small arrays, which are used if no more pairs are near


class Touch(NamedTuple):
    """Effect of obstacles on an arm in one state.

    Attributes:
        torque: joint torques due to contact, N m.
        slip: rate of the stretch of the skin of each link while it sticks, m/s.
        normal: total normal force on each link, N.
    """

    torque: PerJoint
    slip: Rows
    normal: Float[Array, " link"]


def touch(
    arm: Arm, angles: PerJoint, rates: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Touch:
    """Return the joint torques due to contact, and the inputs of the friction states.

    Derivatives are those of the penalty force. At first contact, where the force has a kink, they
    are those of an arm without contact.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        strain: stretch of the skin of the links, m, if contact has friction; none by default.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)
    return of_near(arm, contact, here, lambda p: _touch(arm, contact, here, rates, strain, p))


def contact_energy(
    arm: Arm, angles: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Scalar:
    """Return the energy of flattened links and of stretched skin, J; 0 without obstacles.

    Arguments:
        arm: the arm.
        angles: joint angles, rad.
        strain: stretch of the skin of the links, m, if contact has friction; none by default.
    """
    if arm.contact is None:
        return jnp.zeros(())
    contact, here = arm.contact, pose(arm, angles)
    still = jnp.zeros_like(angles)
    energy = of_near(arm, contact, here, lambda p: meeting(arm, contact, here, still, p).energy)
    if strain is None or contact.friction is None:
        return energy
    return energy + contact.friction_stiffness * jnp.sum(strain * strain) / 2


def of_near(arm: Arm, contact: Contact, here: Pose, of: Callable[[Pairs], T]) -> T:
    """Return the value of a function of those pairs of links and boxes that are near each other.

    Such pairs are usually few, so short arrays are used if possible. Pairs that are not near each
    other may be among the arguments of `of`.
    """
    near = in_reach(arm, contact, here)
    every = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices(near.shape)))
    shapes = jax.eval_shape(of, every)

    def none() -> T:
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def few() -> T:
        chosen = jax.lax.top_k(near.ravel().astype(jnp.int32), _FEW)[1]
        return of(Pairs(every.link[chosen], every.box[chosen]))

    # In a batch, the element with the largest number of pairs determines the branch for all.
    count = eqxi.unvmap_max(jnp.sum(near))
    branches = [none, few, lambda: of(every)] if near.size > _FEW else [none, lambda: of(every)]
    which = (count > 0).astype(jnp.int32) + (count > _FEW).astype(jnp.int32)
    return jax.lax.switch(which, branches)


def pressing(contact: Contact, met: Meeting) -> Numbers:
    """Return the normal forces at the points of a contact, including damping, N."""
    return met.load * larger(1 + contact.damping * met.closing, 0)


def friction_force(
    contact: Contact, met: Meeting, normal: Numbers, total: Float[Array, " link"], strain: Rows
) -> Points:
    """Return the friction forces at contact points, N.

    Arguments:
        contact: the contact law.
        met: the contact points.
        normal: normal forces at the points, N; the friction is distributed in proportion to them.
        total: total normal force on each link, N.
        strain: stretch of the skin of the links, m.
    """
    held = -contact.friction_stiffness * contact.hold(strain, total)
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    force = jnp.broadcast_to(held[:, met.link, None], met.normal.shape)
    return scaled(share, force - scaled(dot(met.normal, force), met.normal))


def _touch(
    arm: Arm, contact: Contact, here: Pose, rates: Array, strain: Rows | None, pairs: Pairs
) -> Touch:
    met = meeting(arm, contact, here, rates, pairs)
    normal = pressing(contact, met)
    # The elastic force is in `met.force`. This is the additional force due to damping.
    push = scaled(normal - met.load, met.normal)
    moment = cross(met.place, push)
    total = met.of_links(jnp.sum(normal, axis=1)[None], arm.count)[0]
    slip = jnp.zeros_like(here.joint)
    if contact.friction is not None:
        share = normal / jnp.where(total > 0, total, 1)[met.link, None]
        slip = met.of_links(jnp.sum(scaled(share, met.sliding), axis=2), arm.count)
        if strain is not None:
            drag = friction_force(contact, met, normal, total, strain)
            push = push + drag
            moment = moment + cross(met.place - scaled(met.distance, met.normal), drag)
    force = met.force + jnp.sum(push, axis=2)
    turn = met.couple + cross(here.joint[:, met.link], met.force) + jnp.sum(moment, axis=2)
    load = met.of_links(jnp.concatenate([force, turn]), arm.count)
    return Touch(load_torque(here, sum_from_tip(load)), slip, total)


def touched(
    arm: Arm, angles: PerJoint, rates: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> tuple[Float[Array, "link obstacle"], Float[Array, "link obstacle 3"]]:
    """Return the flattening of each link by each obstacle, m, and the force on the link, N.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        strain: stretch of the skin of the links, m, if contact has friction; none by default.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)
    owner = owners(contact.obstacles)
    shape = (arm.count, owner.size)
    pairs = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices(shape)))
    met = meeting(arm, contact, here, rates, pairs)
    normal = pressing(contact, met)
    push = scaled(normal - met.load, met.normal)
    if strain is not None and contact.friction is not None:
        total = jnp.sum(normal.reshape(arm.count, -1), axis=1)
        push = push + friction_force(contact, met, normal, total, strain)
    force = (met.force + jnp.sum(push, axis=2)).reshape(3, *shape)
    deep = flattening(arm, contact, here, pairs).reshape(shape)
    of = [np.flatnonzero(owner == each) for each in range(len(contact.obstacles))]
    flattened = jnp.stack([jnp.max(deep[:, boxes], axis=1) for boxes in of], axis=1)
    forces = jnp.stack([jnp.sum(force[:, :, boxes], axis=2) for boxes in of], axis=2)
    return flattened, jnp.moveaxis(forces, 0, -1)


class Stiffness(NamedTuple):
    """Derivatives of the contact torques with respect to the state.

    Attributes:
        angles: stiffness with respect to the joint angles, N m/rad; positive semidefinite.
        rates: damping with respect to the joint rates, N m s/rad; positive semidefinite.
        sticking: velocity of the skin of sticking links per unit of the joint rates, m. Its
            transpose maps the stretch of the skin to joint torques. None without friction.
        skin: stiffness of the skin along an obstacle, N/m.
    """

    angles: Float[Array, "joint joint"]
    rates: Float[Array, "joint joint"]
    sticking: Float[Array, "3 link joint"] | None
    skin: Scalar


def contact_stiffness(
    arm: Arm, angles: PerJoint, rates: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Stiffness:
    """Return the derivatives of the contact torques, except for the rotation of the normals.

    Arguments:
        arm: the arm.
        angles, rates: joint angles, rad, and joint rates, rad/s.
        strain: stretch of the skin of the links, m, if contact has friction; none by default.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)

    def of(pairs: Pairs) -> Stiffness:
        met = meeting(arm, contact, here, rates, pairs)
        harder = larger(1 + contact.damping * met.closing, 0)
        deep = met.depth > 0
        line = jnp.where(deep, met.load / jnp.where(deep, met.depth, 1), 0)
        damper = jnp.where(harder > 0, met.load * contact.damping, 0)
        sticking = None if strain is None else _sticking(contact, here, met, strain)
        spring, resistance = (_of_joints(here, met, each) for each in (line * harder, damper))
        return Stiffness(spring, resistance, sticking, contact.friction_stiffness)

    return of_near(arm, contact, here, of)


def _of_joints(here: Pose, met: Meeting, weight: Array) -> Float[Array, "joint joint"]:
    """Return the weighted sum of outer products of the normal velocities per unit of joint rates.

    As for the mass matrix, outer products of wrenches about the base origin are summed from the
    tip.
    """
    wrench = jnp.concatenate([met.normal, cross(met.place, met.normal)])
    square = jnp.einsum("ikp,jkp,kp->ijk", wrench, wrench, weight)
    count = here.joint.shape[1]
    carried = sum_from_tip(met.of_links(square.reshape(36, -1), count)).reshape(6, 6, count)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    upper = jnp.triu(screw.T @ jnp.einsum("ijl,jl->il", carried, screw))
    return upper + jnp.triu(upper, 1).T


def _sticking(contact: Contact, here: Pose, met: Meeting, strain: Rows) -> Array:
    """Return the velocity of the skin of sticking links per unit of the joint rates, m."""
    count = here.joint.shape[1]
    normal = pressing(contact, met)
    total = met.of_links(jnp.sum(normal, axis=1)[None], count)[0]
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    place = met.place - scaled(met.distance, met.normal)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    # Velocity of each point for unit components of a translation and of a rotation.
    moves = [jnp.broadcast_to(unit[:, None, None], place.shape) for unit in np.eye(3)]
    moves += [cross(unit, place) for unit in moves]
    slides = [move - scaled(dot(met.normal, move), met.normal) for move in moves]
    by_link = [met.of_links(jnp.sum(scaled(share, slide), axis=2), count) for slide in slides]
    sticks = jnp.all(contact.hold(strain, total) == strain, axis=0) & (total > 0)
    by_joint = jnp.einsum("kil,kj->ilj", jnp.stack(by_link), screw)
    before = np.tri(count, dtype=bool)[None] & sticks[None, :, None]
    return jnp.where(before, by_joint, 0)
