"""Lines in the frames of boxes, and how far they belong to them."""

from typing import NamedTuple

import jax.numpy as jnp

from .._typing import Array, Float

PerPair = Float[Array, " pair"]
Vectors = Float[Array, "3 pair"]


class Lines(NamedTuple):
    """Lines, each in the frame of a box.

    Attributes:
        start: first points, m.
        direction: unit vectors.
        length: m.
        radius: m.
        half: half of the sizes of the box, m.
        shared: 1 for faces that are shared with another box, else 0: lower ones, upper ones.
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
        return jnp.sign(x) * jnp.maximum(jnp.abs(x) - self.half, 0)


def within_faces(lines: Lines) -> tuple[PerPair, PerPair, tuple[Vectors, Vectors]]:
    """From where to where lines are not beyond shared faces, and the faces where that ends."""
    start, direction, half = lines.start, lines.direction, lines.half
    first = jnp.zeros_like(start[0])
    last = lines.length
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
