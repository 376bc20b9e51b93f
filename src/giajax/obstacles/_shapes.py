"""The obstacles: boxes, planes, and walls with an opening.

Each is made of boxes. Where two of them share a face, neither counts beyond it: what is there is
the other's, so that a flat wall of several boxes is one flat wall.
"""

import abc
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._maths import on_device, rotate, rotation_vector_to_quaternion
from .._typing import Array, Float
from ..parameters import is_concrete

# Half the sizes of the box of a plane, m: along it beyond all that an arm reaches, and so little
# deep that single precision resolves a micrometre.
_PLANE = (1000.0, 1000.0, 8.0)


class Part(eqx.Module):
    """A box of an obstacle.

    Attributes:
        centre: in the frame of the obstacle, m.
        half: half of its sizes, m.
        shared: whether its face is shared with another box of the obstacle: of the lower and the
            upper faces across x, y and z.
    """

    centre: Float[Array, "3"]
    half: Float[Array, "3"]
    shared: tuple[tuple[bool, bool, bool], tuple[bool, bool, bool]] = eqx.field(
        static=True, default=((False,) * 3, (False,) * 3)
    )


def _numbers(*default: float) -> Any:
    """Field of an array of numbers; where obstacles stand is no parameter that a fit finds."""

    def convert(value: Any) -> Array:
        if not isinstance(value, jax.Array):
            value = on_device(value, jnp.result_type(float))
        return jnp.asarray(value, jnp.result_type(float))

    return eqx.field(converter=convert, default=default if len(default) > 1 else default[0])


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

    centre: Float[Array, "3"] = _numbers(*_ORIGIN)
    size: Float[Array, "3"] = _numbers(1.0, 1.0, 1.0)
    rotation: Float[Array, "3"] = _numbers(*_ORIGIN)
    name: str = eqx.field(static=True, default="box")

    def __check_init__(self) -> None:
        if is_concrete(self.size) and not np.all(np.asarray(self.size) > 0):
            raise InputError(f"the obstacle '{self.name}' has no extent: give three positive sizes")

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

    centre: Float[Array, "3"] = _numbers(*_ORIGIN)
    normal: Float[Array, "3"] = _numbers(0.0, 0.0, 1.0)
    name: str = eqx.field(static=True, default="ground")

    def __check_init__(self) -> None:
        if is_concrete(self.normal) and not np.any(np.asarray(self.normal)):
            raise InputError(f"the plane '{self.name}' has no normal: give it a direction")

    def turn(self) -> Float[Array, "4"]:
        """The turn of z into the normal, about a level axis."""
        x, y, z = self.normal / jnp.sqrt(jnp.sum(self.normal**2))
        # Half way between both: 1 + z and the cross product, made a unit; upside down, about x.
        down = z < -1 + 1e-12
        zero, one = jnp.zeros_like(z), jnp.ones_like(z)
        turn = jnp.stack([1 + z, -y, x, zero])
        turn = jnp.where(down, jnp.stack([zero, one, zero, zero]), turn)
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

    centre: Float[Array, "3"] = _numbers(*_ORIGIN)
    opening: Float[Array, "2"] = _numbers(2.0, 2.0)
    margins: Float[Array, "4"] = _numbers(1.0, 1.0, 1.0, 1.0)
    thickness: Float[Array, ""] = _numbers(0.2)
    rotation: Float[Array, "3"] = _numbers(*_ORIGIN)
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

        def part(column: int, row: int) -> Part:
            (y0, y1), (z0, z1) = bands[0][column], bands[1][row]
            zero = jnp.zeros_like(self.thickness)

            def solid(column: int, row: int) -> bool:
                return column in (0, 1, 2) and row in (0, 1, 2) and (column, row) != (1, 1)

            return Part(
                jnp.stack([zero, (y0 + y1) / 2, (z0 + z1) / 2]),
                jnp.stack([self.thickness / 2, (y1 - y0) / 2, (z1 - z0) / 2]),
                (
                    (False, solid(column - 1, row), solid(column, row - 1)),
                    (False, solid(column + 1, row), solid(column, row + 1)),
                ),
            )

        places = [(column, row) for column in range(3) for row in range(3)]
        return [part(*place) for place in places if place != (1, 1)]
