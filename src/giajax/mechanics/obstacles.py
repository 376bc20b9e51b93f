"""Obstacles around an arm (boxes, planes, walls with an opening) and the distances to them."""

import abc
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..runtime.arrays import (
    Array,
    Bool,
    Float,
    dot,
    larger,
    limited,
    on_device,
    rotate,
    rotation_vector_to_quaternion,
    safe_norm,
)
from ..runtime.text import InputError
from ..schema.parameters import is_concrete

PerPair = Float[Array, " pair"]
Vectors = Float[Array, "3 pair"]


class Lines(NamedTuple):
    """Line segments with a radius, each in the frame of one box.

    Attributes:
        start: first point of each line, m.
        direction: unit vector along each line.
        length: length of each line, m.
        radius: radius about each line within which the box counts as touched, m.
        half: half of the dimensions of the box, m.
        shared: 1 for each face that the box shares with another box, otherwise 0; the first row
            contains the lower faces, the second row the upper faces.
    """

    start: Vectors
    direction: Vectors
    length: PerPair
    radius: PerPair
    half: Vectors
    shared: Float[Array, "2 3 pair"]

    def at(self, place: Array) -> Array:
        """Return the points at distances `place` (m) along the lines."""
        return self.start + self.direction * place[None]

    def out(self, place: Array) -> Array:
        """Return the vectors from the nearest point of the box to points of the lines, m."""
        x = self.at(place)
        return jnp.sign(x) * larger(jnp.abs(x) - self.half, 0)


def within_faces(lines: Lines) -> tuple[PerPair, PerPair, tuple[Vectors, Vectors]]:
    """Clip lines to the part that does not lie beyond a shared face.

    Returns:
        Start and end of this part along each line, m, and the normals of the faces at which it
        starts and ends (zero where it starts or ends with the line).
    """
    start, direction, half = lines.start, lines.direction, lines.half
    first, last = jnp.zeros_like(start[0]), lines.length
    faces = [jnp.zeros_like(start), jnp.zeros_like(start)]
    flat = direction == 0
    for side, sign in enumerate((-1, 1)):
        for k in range(3):
            here = lines.shared[side, k] > 0
            place = (sign * half[k] - start[k]) / jnp.where(flat[k], 1, direction[k])
            leaves = sign * direction[k] > 0
            normal = jnp.zeros_like(start).at[k].set(1)
            ends = here & leaves & (place < last)
            begins = here & ~leaves & ~flat[k] & (place > first)
            last = jnp.where(ends, place, last)
            first = jnp.where(begins, place, first)
            where = (begins[None], ends[None])
            faces = [jnp.where(at, normal, of) for at, of in zip(where, faces, strict=True)]
            beyond = here & flat[k] & (sign * start[k] > half[k])
            last = jnp.where(beyond, first - 1, last)
    return first, last, (faces[0], faces[1])


class Nearest(NamedTuple):
    """Distance from points to the surface of boxes.

    Attributes:
        distance: signed distance to the surface, m; negative inside the box.
        normal: unit vector normal to the surface at its nearest point, pointing outwards, in the
            frame of the box.
    """

    distance: Float[Array, "*shape"]
    normal: Float[Array, "3 *shape"]


def nearest(
    x: Float[Array, "3 *shape"],
    half: Float[Array, "3 *#shape"],
    shared: Float[Array, "2 3 *#shape"],
) -> Nearest:
    """Return the signed distance of points from the surface of boxes, and the normal there.

    Inside a box, only the faces that are not shared are considered. Where several faces are
    equally near, the first of them is used, and the distance has a kink. Along a line the distance
    is convex.

    Arguments:
        x: points in the frames of the boxes, m.
        half, shared: see `Lines`.
    """
    outside = larger(jnp.abs(x) - half, 0)
    length = safe_norm(outside)
    out = length > 0
    # The offset of 1e6 m excludes shared faces. The upper faces come before the lower faces.
    depth = jnp.concatenate([x - half - 1e6 * shared[1], -x - half - 1e6 * shared[0]])
    face = jnp.argmax(depth, axis=0)
    inside = jnp.max(depth, axis=0)
    faces = np.arange(3).reshape(3, *(1,) * (x.ndim - 1))
    axis = (face[None] == faces).astype(x.dtype) - (face[None] == faces + 3).astype(x.dtype)
    pointing = jnp.sign(x) * outside / jnp.where(out, length, 1)[None]
    return Nearest(jnp.where(out, length, inside), jnp.where(out[None], pointing, axis))


class Patches(NamedTuple):
    """Sections of lines whose distance from a box is less than the radius.

    Attributes:
        knots: four positions along the line, m: the start of the section, the two crossings of
            face planes on either side of the nearest position, and the end of the section. Between
            two knots the distance is smooth.
        nearest: position along the line that is nearest to the box, m.
        touching: whether the line has such a section.
    """

    knots: Float[Array, "4 pair"]
    nearest: PerPair
    touching: Bool[Array, " pair"]


class _Knot(NamedTuple):
    """One knot of each line, and the condition that defines it.

    Attributes:
        place: position along the line, m.
        on_radius: whether the distance from the box equals the radius there.
        face: normal of the face whose plane the line crosses there; zero where the knot is an end
            of the line, and where `on_radius` is true.
    """

    place: PerPair
    on_radius: Bool[Array, " pair"]
    face: Vectors


class _Found(NamedTuple):
    knots: list[_Knot]
    nearest: PerPair
    touching: Bool[Array, " pair"]


def patches(lines: Lines) -> Patches:
    """Find the sections of lines that are nearer to boxes than their radius, in closed form."""
    found = _search(jax.lax.stop_gradient(lines))
    return Patches(_places(lines, found), found.nearest, found.touching)


@eqx.filter_custom_jvp
def _places(lines: Lines, found: _Found) -> Float[Array, "4 pair"]:
    return jnp.stack([knot.place for knot in found.knots])


@_places.def_jvp
def _places_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Differentiate the knots implicitly through the conditions that define them.

    The search itself is not differentiated. The nearest position is treated as constant, because
    the distance there does not depend on it to first order.
    """
    lines, found = primals
    places = _places(lines, found)
    moved = Lines(
        *(jnp.zeros_like(x) if t is None else t for x, t in zip(lines, tangents[0], strict=True))
    )

    def rate(knot: _Knot, place: PerPair, at_end_of_line: Array) -> PerPair:
        out = lines.out(place)
        along = jnp.where(knot.on_radius[None], out, knot.face)
        sign = jnp.sign(lines.at(place))
        drift = moved.start + moved.direction * place[None] - sign * moved.half
        change = jnp.where(knot.on_radius, lines.radius * moved.radius, 0) - dot(along, drift)
        slope = dot(along, lines.direction)
        free = slope != 0
        return jnp.where(free, change / jnp.where(free, slope, 1), at_end_of_line)

    zero = jnp.zeros_like(places[0])
    resting = (zero, zero, moved.length, moved.length)
    rates = jnp.stack([rate(*each) for each in zip(found.knots, places, resting, strict=True)])
    return places, jnp.where(found.touching[None], rates, 0)


def _search(lines: Lines) -> _Found:
    """Find the sections in closed form, without iteration.

    The squared distance to a box is convex along a line. Between the crossings of the face planes
    it is a parabola. One of these pieces contains the minimum, and one piece contains each end of
    the section.
    """
    first, last, faces = within_faces(lines)
    some = last > first
    last = larger(last, first)
    flat = lines.direction == 0
    slope = jnp.where(flat, 1, lines.direction)
    crossings = [(sign * lines.half - lines.start) / slope for sign in (-1, 1)]
    every = jnp.concatenate([first[None], last[None], *crossings])
    places = limited(every, first[None], last[None])

    def look(place: Array) -> tuple[Array, Array]:
        """Return the squared distance at a position, and half of its derivative."""
        out = lines.out(place)
        return dot(out, out), dot(out, lines.direction)

    squares, slopes = jax.vmap(look)(places)
    low = jnp.max(jnp.where(slopes <= 0, places, first[None]), axis=0)
    high = jnp.min(jnp.where(slopes >= 0, places, last[None]), axis=0)
    below, above = look(low)[1], look(high)[1]
    change = above - below
    part = jnp.where(change > 0, -below / jnp.where(change > 0, change, 1), 0.5)
    lowest = low + (high - low) * limited(part, 0, 1)
    limit = lines.radius**2
    touching = some & (look(lowest)[0] < limit)

    def end(sign: int) -> _Knot:
        """Return the end of the section before (-1) or after (1) the nearest position."""
        there = sign * (places - lowest[None]) >= 0
        far = jnp.where(there & (squares >= limit[None]), sign * places, jnp.inf)
        outer = sign * jnp.min(far, axis=0)
        reached = jnp.isfinite(outer)
        outer = jnp.where(reached, outer, last if sign > 0 else first)
        within = there & (squares < limit[None]) & (sign * places <= sign * outer[None])
        inner = sign * jnp.max(jnp.where(within, sign * places, sign * lowest[None]), axis=0)
        (square, tilt), (_, tilt_within) = look(outer), look(inner)
        width = jnp.abs(outer - inner)
        tilt, tilt_within = sign * tilt, sign * tilt_within
        bend = (tilt - tilt_within) / jnp.where(width > 0, width, 1)
        # Solve the parabola for the root that is next to `outer`.
        excess = square - limit
        root = tilt + jnp.sqrt(larger(tilt * tilt - bend * excess, 0))
        back = excess / jnp.where(root > 0, root, 1)
        place = jnp.where(reached, outer - sign * limited(back, 0, width), outer)
        place = jnp.where(touching, place, first)
        face = jnp.where(reached[None], 0, faces[1 if sign > 0 else 0])
        return _Knot(place, reached, face)

    planes = jnp.where(jnp.concatenate([flat, flat]), jnp.nan, jnp.concatenate(crossings))
    ends = (end(-1), end(1))
    before, after = (_crossing(planes, lowest, *ends, sign) for sign in (-1, 1))
    return _Found([ends[0], before, after, ends[1]], lowest, touching)


def _crossing(
    planes: Float[Array, "6 pair"], lowest: PerPair, begin: _Knot, end: _Knot, sign: int
) -> _Knot:
    """Return the crossing of a face plane that is next to the nearest position.

    Where the section contains no crossing on that side, the result is the end of the section.

    Arguments:
        planes: positions at which the lines cross the face planes, m; NaN for parallel planes.
        lowest: nearest position along each line, m.
        begin, end: ends of the section.
        sign: -1 for the crossing before the nearest position, 1 for the crossing after it.
    """
    beside = planes <= lowest[None] if sign < 0 else planes > lowest[None]
    inside = beside & (planes > begin.place[None]) & (planes < end.place[None])
    far = jnp.where(inside, sign * planes, jnp.inf)
    which, some = jnp.argmin(far, axis=0), jnp.any(inside, axis=0)
    otherwise = begin if sign < 0 else end
    normal = jnp.arange(3)[:, None] == (which % 3)[None]
    return _Knot(
        jnp.where(some, sign * jnp.min(far, axis=0), otherwise.place),
        otherwise.on_radius & ~some,
        jnp.where(some[None], normal.astype(planes.dtype), otherwise.face),
    )


# Each obstacle consists of boxes. Where two boxes share a face, each of them ignores points beyond
# this face, because they belong to the other box. A flat wall of several boxes then acts as one.

# Half of the dimensions of the box that represents a plane, m. The box extends further than any arm
# reaches. Its depth is small enough that single precision resolves a micrometre.
_PLANE = (1000.0, 1000.0, 8.0)


class Part(eqx.Module):
    """A box that is a part of an obstacle.

    Attributes:
        centre: centre of the box in the frame of the obstacle, m.
        half: half of the dimensions of the box, m.
        shared: whether each face is shared with another box of the obstacle: first the lower and
            then the upper faces, which are normal to x, y and z.
    """

    centre: Float[Array, "3"]
    half: Float[Array, "3"]
    shared: tuple[tuple[bool, bool, bool], tuple[bool, bool, bool]] = eqx.field(
        static=True, default=((False,) * 3, (False,) * 3)
    )


def _converted(value: Any) -> Array:
    if not isinstance(value, jax.Array):
        value = on_device(value, jnp.result_type(float))
    return jnp.asarray(value, jnp.result_type(float))


# A field that is an array. Dimensions and poses of obstacles are constants, not fitted parameters.
_numbers = functools.partial(eqx.field, converter=_converted)


_ORIGIN = (0.0, 0.0, 0.0)


class AbstractObstacle(eqx.Module):
    """A rigid and fixed obstacle, whose frame has its origin at the centre of the obstacle."""

    name: eqx.AbstractVar[str]
    centre: eqx.AbstractVar[Float[Array, "3"]]

    @abc.abstractmethod
    def parts(self) -> list[Part]:
        """Return the boxes of which the obstacle consists, in its own frame."""

    @abc.abstractmethod
    def turn(self) -> Float[Array, "4"]:
        """Return the unit quaternion from the frame of the obstacle to the base frame."""


class Box(AbstractObstacle):
    """A solid box.

    Arguments:
        centre: centre of the box in the base frame, m.
        size: dimensions of the box along its x, y and z axes, m.
        rotation: rotation vector of the box relative to the base frame, rad.
        name: name of the obstacle in results.

    Raises:
        InputError: a dimension is not positive.
    """

    centre: Float[Array, "3"] = _numbers(default=_ORIGIN)
    size: Float[Array, "3"] = _numbers(default=(1.0, 1.0, 1.0))
    rotation: Float[Array, "3"] = _numbers(default=_ORIGIN)
    name: str = eqx.field(static=True, default="box")

    def __check_init__(self) -> None:
        if is_concrete(self.size) and not np.all(np.asarray(self.size) > 0):
            raise InputError(
                f"the obstacle '{self.name}' has a size that is not positive: give three positive "
                "sizes"
            )

    def turn(self) -> Float[Array, "4"]:
        """Return the quaternion of the rotation vector."""
        return rotation_vector_to_quaternion(self.rotation)

    def parts(self) -> list[Part]:
        """Return the box itself."""
        return [Part(jnp.zeros_like(self.size), self.size / 2)]


class Plane(AbstractObstacle):
    """A half space, such as the ground or an unbounded wall.

    Arguments:
        centre: a point of the surface in the base frame, m.
        normal: vector normal to the surface, pointing away from the solid side; it need not be a
            unit vector.
        name: name of the obstacle in results.

    Raises:
        InputError: the normal is zero.
    """

    centre: Float[Array, "3"] = _numbers(default=_ORIGIN)
    normal: Float[Array, "3"] = _numbers(default=(0.0, 0.0, 1.0))
    name: str = eqx.field(static=True, default="ground")

    def __check_init__(self) -> None:
        if is_concrete(self.normal) and not np.any(np.asarray(self.normal)):
            raise InputError(
                f"the plane '{self.name}' has a normal of zero: give a vector other than zero"
            )

    def turn(self) -> Float[Array, "4"]:
        """Return the rotation of the z axis into the normal, about a horizontal axis."""
        x, y, z = self.normal / jnp.sqrt(jnp.sum(self.normal**2))
        # The quaternion (1 + z, cross product) is half of the rotation, up to its length. For a
        # normal that points straight down, the rotation is half a turn about x.
        down = z < -1 + 1e-12
        turn = jnp.stack([1 + z, -y, x, jnp.zeros_like(z)])
        turn = jnp.where(down, jnp.asarray([0, 1, 0, 0], turn.dtype), turn)
        return turn / jnp.sqrt(jnp.sum(turn**2))

    def parts(self) -> list[Part]:
        """Return one box on the solid side, centred at the projection of the base on the plane."""
        half = jnp.asarray(_PLANE, self.centre.dtype)
        beside = rotate(self.turn() * jnp.asarray([-1, 1, 1, 1], half.dtype), -self.centre)
        return [Part(beside.at[2].set(-half[2]), half)]


class WallWithOpening(AbstractObstacle):
    """A wall with a rectangular opening.

    In the frame of the wall, x passes through the wall, y runs along it, and z points up.

    Arguments:
        centre: centre of the opening, in the middle of the wall thickness, in the base frame, m.
        opening: width (along y) and height (along z) of the opening, m.
        margins: extent of the wall to the right of the opening (negative y), below it (negative
            z), to the left (positive y) and above it (positive z), m; all must be positive.
        thickness: thickness of the wall, m.
        rotation: rotation vector of the wall relative to the base frame, rad.
        name: name of the obstacle in results.

    Raises:
        InputError: a dimension is not positive.
    """

    centre: Float[Array, "3"] = _numbers(default=_ORIGIN)
    opening: Float[Array, "2"] = _numbers(default=(2.0, 2.0))
    margins: Float[Array, "4"] = _numbers(default=(1.0, 1.0, 1.0, 1.0))
    thickness: Float[Array, ""] = _numbers(default=0.2)
    rotation: Float[Array, "3"] = _numbers(default=_ORIGIN)
    name: str = eqx.field(static=True, default="wall")

    def __check_init__(self) -> None:
        sizes = (self.opening, self.margins, self.thickness)
        if is_concrete(sizes) and not all(np.all(np.asarray(size) > 0) for size in sizes):
            raise InputError(
                f"the wall '{self.name}' has an opening, a margin or a thickness of 0 or less: "
                "give positive sizes"
            )

    def turn(self) -> Float[Array, "4"]:
        """Return the quaternion of the rotation vector."""
        return rotation_vector_to_quaternion(self.rotation)

    def parts(self) -> list[Part]:
        """Return the eight boxes around the opening, which is the middle cell of a 3 x 3 grid."""
        half = self.opening / 2
        right, below, left, above = self.margins
        bands = (
            ((-half[0] - right, -half[0]), (-half[0], half[0]), (half[0], half[0] + left)),
            ((-half[1] - below, -half[1]), (-half[1], half[1]), (half[1], half[1] + above)),
        )

        places = [(column, row) for column in range(3) for row in range(3)]
        places.remove((1, 1))

        def part(column: int, row: int) -> Part:
            (y0, y1), (z0, z1) = bands[0][column], bands[1][row]
            zero = jnp.zeros_like(self.thickness)
            return Part(
                jnp.stack([zero, (y0 + y1) / 2, (z0 + z1) / 2]),
                jnp.stack([self.thickness / 2, (y1 - y0) / 2, (z1 - z0) / 2]),
                (
                    (False, (column - 1, row) in places, (column, row - 1) in places),
                    (False, (column + 1, row) in places, (column, row + 1) in places),
                ),
            )

        return [part(*place) for place in places]


class Solids(NamedTuple):
    """Boxes of several obstacles.

    Attributes:
        centre: centres of the boxes in the base frame, m.
        half: half of the dimensions of the boxes, m.
        frame: unit vectors along the edges of the boxes in the base frame; `frame[:, k, box]` is
            the k-th vector.
        shared: whether each face is shared with another box (the lower faces, then the upper
            faces); a NumPy array, which is not traced.
    """

    centre: Float[Array, "3 box"]
    half: Float[Array, "3 box"]
    frame: Float[Array, "3 3 box"]
    shared: Bool[np.ndarray, "2 3 box"]


def solids(obstacles: Sequence[AbstractObstacle]) -> Solids:
    """Collect the boxes of obstacles. At least one obstacle is required."""
    boxes = []
    for obstacle in obstacles:
        turn = obstacle.turn()
        frame = jnp.stack([rotate(turn, axis) for axis in jnp.eye(3, dtype=turn.dtype)], axis=1)
        for part in obstacle.parts():
            boxes.append((obstacle.centre + frame @ part.centre, part.half, frame, part.shared))
    *placed, shared = zip(*boxes, strict=True)
    centre, half, frame = (jnp.stack(each, axis=-1) for each in placed)
    return Solids(centre, half, frame, np.moveaxis(np.asarray(shared), 0, -1))


def owners(obstacles: Sequence[AbstractObstacle]) -> np.ndarray:
    """Return the index of the obstacle to which each box belongs, shape (box,)."""
    return np.repeat(np.arange(len(obstacles)), [len(each.parts()) for each in obstacles])
