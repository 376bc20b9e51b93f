"""The opening that a mission goes through, and where one is in it."""

from typing import NamedTuple

import jax.numpy as jnp

from .._errors import InputError
from .._maths import rotate
from .._typing import Array, Float, Scalar
from ..arm import Arm
from ..obstacles import WallWithOpening


class Opening(NamedTuple):
    """An opening as it is seen from the side that its wall's x points to.

    Attributes:
        centre: of its outer face in the base frame, m.
        frame: unit vectors outwards, to the left and up, as columns.
        half: half of its width and height, m.
        thickness: of the wall, m.
    """

    centre: Float[Array, "3"]
    frame: Float[Array, "3 3"]
    half: Float[Array, "2"]
    thickness: Scalar

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Of the outer face, in the base frame, m."""
        signs = jnp.asarray([[1, 1], [-1, 1], [-1, -1], [1, -1]], self.half.dtype)
        return self.centre[None] + (signs * self.half[None]) @ self.frame[:, 1:].T

    def local(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points of the base frame as distances outwards, to the left and up, m."""
        rows = points.reshape(-1, 3) - self.centre[None]
        return (rows @ self.frame).reshape(points.shape)

    def beside(self, local: Float[Array, "3"]) -> Scalar:
        """How far a point is outside the frame, seen along the way through it, m; 0 within."""
        out = jnp.maximum(jnp.abs(local[1:]) - self.half, 0)
        return jnp.sqrt(jnp.sum(out**2))


def opening_of(arm: Arm, name: str | None = None) -> Opening:
    """The opening of a wall around an arm.

    Arguments:
        arm: with its obstacles.
        name: of the wall; not needed where there is one.

    Raises:
        InputError: there is no such wall, or several.
    """
    obstacles = () if arm.contact is None else arm.contact.obstacles
    walls = {each.name: each for each in obstacles if isinstance(each, WallWithOpening)}
    if not walls:
        raise InputError(
            'the mission has no opening: add a wall, as [[arm.obstacles]] with shape = "wall"'
        )
    if name is None and len(walls) > 1:
        raise InputError(f"there are openings in {', '.join(walls)}: say which by mission.opening")
    if name is not None and name not in walls:
        raise InputError(
            f"mission.opening = '{name}' is no wall with an opening: there is {', '.join(walls)}"
        )
    wall = next(iter(walls.values())) if name is None else walls[name]
    turn = wall.turn()
    frame = jnp.stack([rotate(turn, axis) for axis in jnp.eye(3, dtype=turn.dtype)], axis=1)
    centre = wall.centre + frame[:, 0] * wall.thickness / 2
    return Opening(centre, frame, wall.opening / 2, wall.thickness)
