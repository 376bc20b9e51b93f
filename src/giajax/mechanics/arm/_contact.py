"""Contact of inflated links with obstacles: where they meet, forces, energy and stiffness."""

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
    """Which links are looked at beside which boxes, counted from 0."""

    link: Int[Array, " pair"]
    box: Int[Array, " pair"]


class Meeting(NamedTuple):
    """Points along the links' axes that are nearer to a box than the radius.

    The force is the derivative of the energy as it is computed, however few the points: a link
    that is let go has the energy that it took to press it. Forces and couples (about the links'
    joints) are elastic ones, N and N m; each point stands for its `load`, N. `normal` is away from
    the box, `distance` that of the axis from the surface, `depth` what the radius has more, m;
    `closing` is how fast that grows, `sliding` how the link's skin moves along the surface, m/s.
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
        """Sums over the pairs of each of so many links."""
        return x @ jax.nn.one_hot(self.link, links, dtype=x.dtype)


def meeting(arm: Arm, contact: Contact, here: Pose, rates: PerJoint, pairs: Pairs) -> Meeting:
    """How links of an arm meet boxes in one state."""
    lines, frame = _lines(arm, contact, here, pairs)
    places, sizes = np.polynomial.legendre.leggauss(contact.points)
    nodes, weights = (jnp.asarray(x / 2, lines.start.dtype) for x in (1 + places, sizes))
    line = contact.line(arm.links)[pairs.link, None]

    def flat(pieces: Float[Array, "pair piece point"]) -> Numbers:
        return pieces.reshape(len(pieces), -1)

    def flattened(start: Array, direction: Array) -> tuple[Scalar, tuple[Array, ...]]:
        """Energy, and the points that it is a sum of."""
        moved = lines._replace(start=start, direction=direction)
        found = patches(moved)
        # Three pieces, in each of which the distance is smooth.
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
    """By how much the axes of links are nearer to boxes than their radius, m, at the most.

    Outside a box that is at the nearest place. Inside, the distance is the largest of those to six
    planes: convex, and lowest where two of them are alike, or at an end.
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
    """Distances of the skin of links from the boxes of obstacles, m; negative where it is beyond.

    The box of a plane is that half space, and an opening has eight boxes around it. An axis that
    is within a box is as deep as it is half-way through, which need not be the deepest.

    Arguments:
        angles: of the joints, rad.

    Raises:
        InputError: an arm with nothing around it.
    """
    if arm.contact is None:
        raise InputError("the arm has no obstacles to keep clear of: add obstacles")
    boxes = len(owners(arm.contact.obstacles))
    link, box = (grid.ravel() for grid in jnp.indices((arm.count, boxes)))
    lines, _ = _lines(arm, arm.contact, pose(arm, angles), Pairs(link, box))
    # A link that is beyond a shared face is near the box, too; nobody leaves a box through one.
    alone = lines._replace(shared=jnp.zeros_like(lines.shared))
    # To first order the distance does not depend on the nearest place.
    near = jax.lax.stop_gradient(patches(alone).nearest)
    distance = _look(lines, near[:, None]).distance[:, 0] - lines.radius
    return distance.reshape(arm.count, boxes)


def in_reach(arm: Arm, contact: Contact, here: Pose) -> Bool[Array, "link box"]:
    """Whether links are so near to boxes that they might touch: a quick look from afar."""
    arm, contact, here = jax.lax.stop_gradient((arm, contact, here))
    boxes = solids(contact.obstacles)
    beside = here.centre[:, :, None] - boxes.centre[:, None]
    middle = jnp.sum(boxes.frame[:, :, None] * beside[:, None], axis=0)
    outside = larger(jnp.abs(middle) - boxes.half[:, None], 0)
    reach = (arm.links.length + arm.links.diameter) / 2
    return dot(outside, outside) < reach[:, None] ** 2


def _lines(arm: Arm, contact: Contact, here: Pose, pairs: Pairs) -> tuple[Lines, Array]:
    """Axes of links in the frames of boxes, and these frames."""
    boxes, links = solids(contact.obstacles), arm.links
    frame = boxes.frame[:, :, pairs.box]
    back = jnp.swapaxes(frame, 0, 1)
    beside = here.joint[:, pairs.link] - boxes.centre[:, pairs.box]
    shared = jnp.asarray(boxes.shared, beside.dtype)[:, :, pairs.box]
    length, radius = links.length[pairs.link], links.diameter[pairs.link] / 2
    start, direction = _turned(back, beside), _turned(back, here.direction[:, pairs.link])
    return Lines(start, direction, length, radius, boxes.half[:, pairs.box], shared), frame


def _turned(frame: Float[Array, "3 3 pair"], x: Float[Array, "3 pair *point"]) -> Array:
    """Vectors in the base frame, from those in the frames of boxes."""
    return jnp.sum(frame.reshape(*frame.shape, *(1,) * (x.ndim - 2)) * x[None], axis=1)


def _look(lines: Lines, places: Numbers) -> Nearest:
    x = lines.start[..., None] + lines.direction[..., None] * places[None]
    return nearest(x, lines.half[..., None], lines.shared[..., None])


T = TypeVar("T")

_FEW = 24  # pairs of links and boxes that are looked at together where no more are near each other


class Touch(NamedTuple):
    """What obstacles do to an arm in one state: torques of the joints (N m), how fast the stretch
    of each link's skin grows while it sticks (m/s), and the force that presses each link (N).
    """

    torque: PerJoint
    slip: Rows
    normal: Float[Array, " link"]


def touch(
    arm: Arm, angles: PerJoint, rates: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Touch:
    """Torques of contact, and what the states of its friction need.

    Derivatives are those of the penalty; at first touch, where it begins with a kink in the force,
    they are those of an arm that does not touch.

    Arguments:
        angles, rates: of the joints, rad and rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.
    """
    assert arm.contact is not None
    contact, here = arm.contact, pose(arm, angles)
    return of_near(arm, contact, here, lambda p: _touch(arm, contact, here, rates, strain, p))


def contact_energy(
    arm: Arm, angles: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Scalar:
    """Energy of flattened links and stretched skin, J; 0 without obstacles.

    Arguments:
        angles: of the joints, rad.
        strain: stretch of the links' skin, m, where contact has friction; none by default.
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
    """What `of` makes of the pairs of links and boxes that are near each other.

    Seldom are they many: the arrays of most states are short.
    """
    near = in_reach(arm, contact, here)
    every = Pairs(*(jnp.asarray(index.ravel()) for index in np.indices(near.shape)))
    shapes = jax.eval_shape(of, every)

    def none() -> T:
        return jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), shapes)

    def few() -> T:
        chosen = jax.lax.top_k(near.ravel().astype(jnp.int32), _FEW)[1]
        return of(Pairs(every.link[chosen], every.box[chosen]))

    # In a batch, all take the way of the one that has most.
    count = eqxi.unvmap_max(jnp.sum(near))
    branches = [none, few, lambda: of(every)] if near.size > _FEW else [none, lambda: of(every)]
    which = (count > 0).astype(jnp.int32) + (count > _FEW).astype(jnp.int32)
    return jax.lax.switch(which, branches)


def pressing(contact: Contact, met: Meeting) -> Numbers:
    """Normal forces at the points of a meeting, N."""
    return met.load * larger(1 + contact.damping * met.closing, 0)


def friction_force(
    contact: Contact, met: Meeting, normal: Numbers, total: Float[Array, " link"], strain: Rows
) -> Points:
    """Friction at points, in proportion to the normal forces there, N; `total`: those of links."""
    held = -contact.friction_stiffness * contact.hold(strain, total)
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    force = jnp.broadcast_to(held[:, met.link, None], met.normal.shape)
    return scaled(share, force - scaled(dot(met.normal, force), met.normal))


def _touch(
    arm: Arm, contact: Contact, here: Pose, rates: Array, strain: Rows | None, pairs: Pairs
) -> Touch:
    met = meeting(arm, contact, here, rates, pairs)
    normal = pressing(contact, met)
    # What damping adds to the elastic force, which is known as a whole.
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
    """Flattening of each link by each obstacle, m, and the force of the obstacle on it, N.

    Arguments:
        angles, rates: of the joints, rad and rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.
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
    """How the torques of contact change with the state.

    Attributes:
        angles: with the angles of the joints, N m/rad; symmetric and not negative.
        rates: with their rates, N m s/rad; likewise.
        sticking: velocity of the skin of links that stick, with the rates of the joints, m; the
            stretch of the skin acts on the joints through its transpose. None without friction.
        skin: stiffness of the skin along an obstacle, N/m.
    """

    angles: Float[Array, "joint joint"]
    rates: Float[Array, "joint joint"]
    sticking: Float[Array, "3 link joint"] | None
    skin: Scalar


def contact_stiffness(
    arm: Arm, angles: PerJoint, rates: PerJoint, strain: Float[Array, "3 link"] | None = None
) -> Stiffness:
    """How the torques of pressed contacts change, but for the turning of normals.

    Arguments:
        angles, rates: of the joints, rad and rad/s.
        strain: stretch of the links' skin, m, where contact has friction; none by default.
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
    """Sum of weighted squares of how joints move points along their normals.

    As for the mass matrix: squares of wrenches about the base origin are summed from the tip.
    """
    wrench = jnp.concatenate([met.normal, cross(met.place, met.normal)])
    square = jnp.einsum("ikp,jkp,kp->ijk", wrench, wrench, weight)
    count = here.joint.shape[1]
    carried = sum_from_tip(met.of_links(square.reshape(36, -1), count)).reshape(6, 6, count)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    upper = jnp.triu(screw.T @ jnp.einsum("ijl,jl->il", carried, screw))
    return upper + jnp.triu(upper, 1).T


def _sticking(contact: Contact, here: Pose, met: Meeting, strain: Rows) -> Array:
    """Velocity of the skin with the rates of the joints, of the links that stick."""
    count = here.joint.shape[1]
    normal = pressing(contact, met)
    total = met.of_links(jnp.sum(normal, axis=1)[None], count)[0]
    share = normal / jnp.where(total > 0, total, 1)[met.link, None]
    place = met.place - scaled(met.distance, met.normal)
    screw = jnp.concatenate([cross(here.joint, here.axis), here.axis])
    # Velocity of the place by each component of a velocity of the origin, and of a turn.
    moves = [jnp.broadcast_to(unit[:, None, None], place.shape) for unit in np.eye(3)]
    moves += [cross(unit, place) for unit in moves]
    slides = [move - scaled(dot(met.normal, move), met.normal) for move in moves]
    by_link = [met.of_links(jnp.sum(scaled(share, slide), axis=2), count) for slide in slides]
    sticks = jnp.all(contact.hold(strain, total) == strain, axis=0) & (total > 0)
    by_joint = jnp.einsum("kil,kj->ilj", jnp.stack(by_link), screw)
    before = np.tri(count, dtype=bool)[None] & sticks[None, :, None]
    return jnp.where(before, by_joint, 0)
