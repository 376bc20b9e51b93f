"""Which stretch of a line is within a radius of a box: where a round link touches it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from .._maths import dot
from .._typing import Array, Bool, Float
from ._lines import Lines, PerPair, Vectors, within_faces


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
    plane of a face (whose normal `face` is), or neither, which is an end of the line."""

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
    last = jnp.maximum(last, first)
    flat = lines.direction == 0
    slope = jnp.where(flat, 1, lines.direction)
    crossings = [(sign * lines.half - lines.start) / slope for sign in (-1, 1)]
    every = jnp.concatenate([first[None], last[None], *crossings])
    places = jnp.clip(every, first[None], last[None])

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
    lowest = low + (high - low) * jnp.clip(part, 0, 1)
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
        root = tilt + jnp.sqrt(jnp.maximum(tilt * tilt - bend * excess, 0))
        back = excess / jnp.where(root > 0, root, 1)
        place = jnp.where(reached, outer - sign * jnp.clip(back, 0, width), outer)
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
    there is none in the stretch, its end."""
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
