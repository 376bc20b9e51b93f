"""Where links meet obstacles, and how fast."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from .._maths import cross, dot, scaled
from .._typing import Array, Bool, Float, Int, Scalar
from ..obstacles import Lines, Nearest, nearest, patches, solids
from ._arm import Arm
from ._contact import Contact
from ._kinematics import Pose, angular_velocities, sum_from_base

Points = Float[Array, "3 pair point"]
Numbers = Float[Array, "pair point"]


class Pairs(NamedTuple):
    """Which links are looked at beside which boxes, counted from 0."""

    link: Int[Array, " pair"]
    box: Int[Array, " pair"]


class Meeting(NamedTuple):
    """Points along the links' axes that are nearer to a box than the radius.

    The force is the derivative of the energy as it is computed, however few the points: a link
    that is let go has the energy that it took to press it.

    Attributes:
        link: the link of each pair.
        energy: of the flattened links, J.
        force: elastic force on the link of each pair, N.
        couple: its moment about the link's joint, N m.
        place: in the base frame, m.
        normal: unit vector away from the box.
        distance: of the axis from the surface, m.
        depth: radius less distance, m; 0 where nothing touches.
        load: elastic force that the point stands for, N.
        closing: how fast the depth grows, m/s.
        sliding: velocity of the link's skin along the surface, m/s.
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


def meeting(
    arm: Arm, contact: Contact, here: Pose, rates: Float[Array, " joint"], pairs: Pairs
) -> Meeting:
    """How links of an arm meet boxes in one state."""
    lines, frame = _lines(arm, contact, here, pairs)
    places, sizes = np.polynomial.legendre.leggauss(contact.points)
    nodes, weights = (jnp.asarray(x / 2, lines.start.dtype) for x in (1 + places, sizes))
    line = contact.line(arm.count)[pairs.link, None]

    def flattened(start: Array, direction: Array) -> tuple[Scalar, tuple[Array, ...]]:
        """Energy, and the points that it is a sum of."""
        moved = lines._replace(start=start, direction=direction)
        found = patches(moved)
        # Three pieces, in each of which the distance is smooth.
        wide = jnp.diff(found.knots, axis=0).T[:, :, None]
        at = _flat(found.knots[:-1].T[:, :, None] + wide * nodes[None, None])
        near = _look(moved, at)
        deep = jnp.maximum(lines.radius[:, None] - near.distance, 0)
        depth = jnp.where(found.touching[:, None], deep, 0)
        load = line * depth * _flat(wide * weights[None, None])
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


def _flat(pieces: Float[Array, "pair piece point"]) -> Numbers:
    return pieces.reshape(len(pieces), -1)


def flattening(arm: Arm, contact: Contact, here: Pose, pairs: Pairs) -> Float[Array, " pair"]:
    """By how much the axes of links are nearer to boxes than their radius, m, at the most.

    Outside a box that is at the nearest place. Inside, where the axis is in a wall, the distance
    is the largest of those to six planes: convex, and lowest where two of them are alike, or at
    an end.
    """
    lines, _ = _lines(arm, contact, here, pairs)
    found = patches(lines)
    faces = jnp.concatenate([lines.start, -lines.start]) - jnp.tile(lines.half, (2, 1))
    slopes = jnp.concatenate([lines.direction, -lines.direction])
    one, other = np.triu_indices(6, 1)
    turning = slopes[one] - slopes[other]
    alike = (faces[other] - faces[one]) / jnp.where(turning == 0, jnp.inf, turning)
    begin, end = found.knots[:1], found.knots[-1:]
    places = jnp.concatenate([begin, found.nearest[None], jnp.clip(alike, begin, end), end])
    depth = lines.radius - jnp.min(_look(lines, places.T).distance, axis=1)
    return jnp.where(found.touching, jnp.maximum(depth, 0), 0)


def in_reach(arm: Arm, contact: Contact, here: Pose) -> Bool[Array, "link box"]:
    """Whether links are so near to boxes that they might touch: a quick look from afar."""
    arm, contact, here = jax.lax.stop_gradient((arm, contact, here))
    boxes = solids(contact.obstacles)
    beside = here.centre[:, :, None] - boxes.centre[:, None]
    middle = jnp.sum(boxes.frame[:, :, None] * beside[:, None], axis=0)
    outside = jnp.maximum(jnp.abs(middle) - boxes.half[:, None], 0)
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
