"""What stands around an arm: boxes, planes and walls with an opening, and what is nearest."""

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
    """Lines, each in the frame of a box: first points, unit vectors, lengths and radii, m; half of
    the sizes of the box, m; and 1 for faces that are shared with another box, else 0: lower, upper
    ones.
    """

    start: Vectors
    direction: Vectors
    length: PerPair
    radius: PerPair
    half: Vectors
    shared: Float[Array, "2 3 pair"]

    def at(self, place: Array) -> Array:
        """Points of the lines."""
        return self.start + self.direction * place[None]

    def out(self, place: Array) -> Array:
        """From the nearest point of the box to points of the lines, m."""
        x = self.at(place)
        return jnp.sign(x) * larger(jnp.abs(x) - self.half, 0)


def within_faces(lines: Lines) -> tuple[PerPair, PerPair, tuple[Vectors, Vectors]]:
    """From where to where lines are not beyond shared faces, and the faces where that ends."""
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
    """The surface of boxes as seen from points: the distance, m, negative inside, and the unit
    vector from the nearest point of the surface, in the frame of the box.
    """

    distance: Float[Array, "*shape"]
    normal: Float[Array, "3 *shape"]


def nearest(
    x: Float[Array, "3 *shape"],
    half: Float[Array, "3 *#shape"],
    shared: Float[Array, "2 3 *#shape"],
) -> Nearest:
    """The nearest of the surface of boxes.

    Inside, it is that of the faces that are not shared. Where several are equally near, it is the
    first of them, and the distance has a kink. Along a line the distance is convex.

    Arguments:
        x: points in the frames of the boxes, m.
        half, shared: as of `Lines`.
    """
    outside = larger(jnp.abs(x) - half, 0)
    length = safe_norm(outside)
    out = length > 0
    # A shared face is far away from everything inside. Upper faces first, then lower ones.
    depth = jnp.concatenate([x - half - 1e6 * shared[1], -x - half - 1e6 * shared[0]])
    face = jnp.argmax(depth, axis=0)
    inside = jnp.max(depth, axis=0)
    faces = np.arange(3).reshape(3, *(1,) * (x.ndim - 1))
    axis = (face[None] == faces).astype(x.dtype) - (face[None] == faces + 3).astype(x.dtype)
    pointing = jnp.sign(x) * outside / jnp.where(out, length, 1)[None]
    return Nearest(jnp.where(out, length, inside), jnp.where(out[None], pointing, axis))


class Patches(NamedTuple):
    """Stretches of lines that are within their radius of a box.

    Attributes:
        knots: along the line, m: where the stretch begins, the crossings of planes of faces that
            are next to its nearest place, between which the distance is smooth, and its end.
        nearest: the place along the line that is nearest to the box, m.
        touching: whether there is any.
    """

    knots: Float[Array, "4 pair"]
    nearest: PerPair
    touching: Bool[Array, " pair"]


class _Knot(NamedTuple):
    """A place on each line, and what it is: where it is as far away as its radius, or crosses the
    plane of a face (whose normal `face` is), or neither, which is an end of the line.
    """

    place: PerPair
    on_radius: Bool[Array, " pair"]
    face: Vectors


class _Found(NamedTuple):
    knots: list[_Knot]
    nearest: PerPair
    touching: Bool[Array, " pair"]


def patches(lines: Lines) -> Patches:
    """Where lines are within their radius of boxes, exactly."""
    found = _search(jax.lax.stop_gradient(lines))
    return Patches(_places(lines, found), found.nearest, found.touching)


@eqx.filter_custom_jvp
def _places(lines: Lines, found: _Found) -> Float[Array, "4 pair"]:
    return jnp.stack([knot.place for knot in found.knots])


@_places.def_jvp
def _places_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """A knot moves so that what made it one still holds: the search itself is not differentiated.

    The nearest place may stay: to first order the distance there does not depend on it.
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
    """The stretches, without iteration.

    The square of the distance to a box is convex along a line, and between the places where the
    line crosses the planes of faces it is a parabola: one of those pieces has the minimum, and one
    each of the ends.
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
        """Square of the distance, and half of its slope."""
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
        """That before (-1) or after (1) the nearest place."""
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
        # The root next to `outer` of the parabola through it.
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
    """The crossing of a face's plane next to the nearest place, before (-1) or after (1) it; where
    there is none in the stretch, its end.
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


# Each obstacle is made of boxes. Where two of them share a face, neither counts beyond it: what is
# there is the other's, so that a flat wall of several boxes is one flat wall.

# Half the sizes of the box of a plane, m: along it beyond all that an arm reaches, and so little
# deep that single precision resolves a micrometre.
_PLANE = (1000.0, 1000.0, 8.0)


class Part(eqx.Module):
    """A box of an obstacle, in whose frame its centre is; `half` of its sizes, m; and whether its
    face is shared with another box of the obstacle: of the lower and the upper faces across x, y
    and z.
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


# Field of an array of numbers; where obstacles stand is no parameter that a fit finds.
_numbers = functools.partial(eqx.field, converter=_converted)


_ORIGIN = (0.0, 0.0, 0.0)


class AbstractObstacle(eqx.Module):
    """Something rigid that does not move, with its frame about its centre."""

    name: eqx.AbstractVar[str]
    centre: eqx.AbstractVar[Float[Array, "3"]]

    @abc.abstractmethod
    def parts(self) -> list[Part]:
        """The boxes that it is made of, in its own frame."""

    @abc.abstractmethod
    def turn(self) -> Float[Array, "4"]:
        """Unit quaternion from its own frame to the base frame."""


class Box(AbstractObstacle):
    """A solid box.

    Arguments:
        centre: in the base frame, m.
        size: along its x, y and z, m.
        rotation: rotation vector against the base frame, rad.
        name: what results call it.

    Raises:
        InputError: a size that is not positive.
    """

    centre: Float[Array, "3"] = _numbers(default=_ORIGIN)
    size: Float[Array, "3"] = _numbers(default=(1.0, 1.0, 1.0))
    rotation: Float[Array, "3"] = _numbers(default=_ORIGIN)
    name: str = eqx.field(static=True, default="box")

    def __check_init__(self) -> None:
        if is_concrete(self.size) and not np.all(np.asarray(self.size) > 0):
            raise InputError(
                f"the obstacle '{self.name}' has a size that is not positive: give three positive "
                f"sizes"
            )

    def turn(self) -> Float[Array, "4"]:
        """By its rotation vector."""
        return rotation_vector_to_quaternion(self.rotation)

    def parts(self) -> list[Part]:
        """One box."""
        return [Part(jnp.zeros_like(self.size), self.size / 2)]


class Plane(AbstractObstacle):
    """A half space: the ground, or a wall without an end.

    Arguments:
        centre: a point of its surface in the base frame, m.
        normal: away from the solid side; it need not be a unit vector.
        name: what results call it.

    Raises:
        InputError: a normal without a direction.
    """

    centre: Float[Array, "3"] = _numbers(default=_ORIGIN)
    normal: Float[Array, "3"] = _numbers(default=(0.0, 0.0, 1.0))
    name: str = eqx.field(static=True, default="ground")

    def __check_init__(self) -> None:
        if is_concrete(self.normal) and not np.any(np.asarray(self.normal)):
            raise InputError(
                f"the plane '{self.name}' has a normal of zero: give a vector that is not zero"
            )

    def turn(self) -> Float[Array, "4"]:
        """The turn of z into the normal, about a level axis."""
        x, y, z = self.normal / jnp.sqrt(jnp.sum(self.normal**2))
        # Half way between both: 1 + z and the cross product, made a unit; upside down, about x.
        down = z < -1 + 1e-12
        turn = jnp.stack([1 + z, -y, x, jnp.zeros_like(z)])
        turn = jnp.where(down, jnp.asarray([0, 1, 0, 0], turn.dtype), turn)
        return turn / jnp.sqrt(jnp.sum(turn**2))

    def parts(self) -> list[Part]:
        """One box that ends at the plane, beside the base, wherever the plane's centre is."""
        half = jnp.asarray(_PLANE, self.centre.dtype)
        beside = rotate(self.turn() * jnp.asarray([-1, 1, 1, 1], half.dtype), -self.centre)
        return [Part(beside.at[2].set(-half[2]), half)]


class WallWithOpening(AbstractObstacle):
    """A wall with a rectangular opening, its x through the wall, y along it and z up.

    Arguments:
        centre: of the opening, in the middle of the wall, in the base frame, m.
        opening: width (along y) and height (along z) of the opening, m.
        margins: how far the wall goes on to the right (-y), below (-z), to the left (+y) and
            above (+z) the opening, m; none may be 0.
        thickness: of the wall, m.
        rotation: rotation vector of the wall against the base frame, rad.
        name: what results call it.

    Raises:
        InputError: a size that is not positive.
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
        """By its rotation vector."""
        return rotation_vector_to_quaternion(self.rotation)

    def parts(self) -> list[Part]:
        """Eight boxes about the opening, in a square of nine."""
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
    """The boxes of several obstacles: centres in the base frame and half of the sizes, m; unit
    vectors along the sizes in the base frame, `frame[:, k, box]` being the k-th; and whether a face
    is shared with another box, of the lower and the upper ones: numbers, and no part of what is
    traced.
    """

    centre: Float[Array, "3 box"]
    half: Float[Array, "3 box"]
    frame: Float[Array, "3 3 box"]
    shared: Bool[np.ndarray, "2 3 box"]


def solids(obstacles: Sequence[AbstractObstacle]) -> Solids:
    """The boxes of obstacles, of which there is at least one."""
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
    """The index of the obstacle that each box belongs to, shape (box,)."""
    return np.repeat(np.arange(len(obstacles)), [len(each.parts()) for each in obstacles])
