"""What every controller of a mission is given: an opening, a picture, and the arm as drawn."""

import abc
from typing import Any, NamedTuple, Self

import equinox as eqx
import jax.numpy as jnp

from ...mechanics.arm import Arm
from ...mechanics.obstacles import WallWithOpening
from ...models import Pinhole
from ...runtime.arrays import Array, Bool, Float, Scalar, rotate, safe_norm
from ...runtime.plugins import optional
from ...runtime.text import InputError


def number(default: float) -> Any:
    """A field that a program takes as an argument, so that another value is the same program."""
    return eqx.field(converter=lambda x: jnp.asarray(x, jnp.result_type(float)), default=default)


METRES = 2.0
"""Weight of a rotation of the camera: one radian counts as this displacement of the tip, m."""

_AHEAD = 3.0  # m behind an opening: a place that does not pass by while the tip goes in


class Opening(NamedTuple):
    """An opening as it is seen from the side that its wall's x points to.

    Attributes:
        centre: of its outer face in the base frame, m.
        frame: unit vectors outwards, to the left and up, as columns.
        half: half of its width and height, m.
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

    @property
    def ahead(self) -> Float[Array, "3"]:
        """Where a camera looks that goes in: a place behind the opening, m."""
        return self.centre - _AHEAD * self.frame[:, 0]

    def outside(
        self, local: Float[Array, "3"], *, near: Scalar, stand_off: Scalar, deep: Scalar
    ) -> Scalar:
        """How far outwards a tip shall go, m: the nearer to the axis the less.

        Arguments:
            local: where it is, as of `local`, m.
            near: distance from the axis within which it goes in, m.
            stand_off: where it goes to the axis, m.
            deep: how far in it goes, m.
        """
        return jnp.clip(2 * (safe_norm(local[1:]) - near), -deep, stand_off)

    def local(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Points of the base frame as distances outwards, to the left and up, m."""
        rows = points.reshape(-1, 3) - self.centre[None]
        return (rows @ self.frame).reshape(points.shape)

    def holds(self, local: Float[Array, "3"]) -> Bool[Array, ""]:
        """Whether a point is in the frame, or behind it."""
        return (local[0] < 0) & (self.beside(local) == 0)

    def beside(self, local: Float[Array, "3"]) -> Scalar:
        """How far a point is outside the frame, seen along the way through it, m; 0 within."""
        out = jnp.maximum(jnp.abs(local[1:]) - self.half, 0)
        return jnp.sqrt(jnp.sum(out**2))


def opening_of(arm: Arm, name: str | None = None) -> Opening:
    """The opening of a wall around an arm, by its name where there are several."""
    obstacles = () if arm.contact is None else arm.contact.obstacles
    walls = {each.name: each for each in obstacles if isinstance(each, WallWithOpening)}
    if not walls:
        raise InputError(
            'the arm has no opening to enter: add a wall, as [[arm.obstacles]] with shape = "wall"'
        )
    if name is None and len(walls) > 1:
        raise InputError(f"several walls have an opening ({', '.join(walls)}): name one of them")
    if name is not None and name not in walls:
        raise InputError(f"'{name}' is not a wall with an opening: use one of: {', '.join(walls)}")
    wall = next(iter(walls.values())) if name is None else walls[name]
    turn = wall.turn()
    frame = jnp.stack([rotate(turn, axis) for axis in jnp.eye(3, dtype=turn.dtype)], axis=1)
    centre = wall.centre + frame[:, 0] * wall.thickness / 2
    return Opening(centre, frame, wall.opening / 2, wall.thickness)


class Scene(NamedTuple):
    """What a controller knows before it begins.

    Attributes:
        arm: as it is drawn, which is not quite the arm that moves.
        camera: at its tip.
        interval: between two decisions, s.
    """

    arm: Arm
    camera: Pinhole
    opening: Opening
    interval: Scalar


class Picture(NamedTuple):
    """The corners of an opening in a picture, which of them are in it, and what was commanded then.

    Attributes:
        pixels: of the corners, px.
        seen: which of them are in the picture.
        room: whether it shows what is behind the opening.
        commanded: angles of the joints at the time of the picture, rad.
    """

    pixels: Float[Array, "4 2"]
    seen: Bool[Array, "4"]
    room: Bool[Array, ""]
    commanded: Float[Array, " joint"]

    def blind(self, before: Scalar, interval: Scalar) -> Scalar:
        """For how long fewer than two corners have been seen, an interval later, s."""
        return jnp.where(jnp.sum(self.seen) >= 2, 0, before + interval)


class AbstractController(eqx.Module):
    """Who drives the arm: an opening, late pictures and its own commands are all that it has.

    What it remembers from one decision to the next is a pytree of arrays (its memory), so that a
    whole mission is one program.
    """

    @abc.abstractmethod
    def start(self, scene: Scene, late: int) -> Any:
        """The memory at the start, with the straight arm at rest and pictures late by so many."""

    @abc.abstractmethod
    def decide(
        self, scene: Scene, memory: Any, picture: Picture, command: Float[Array, " joint"]
    ) -> tuple[Any, Float[Array, " joint"]]:
        """The memory afterwards, and the commands an interval later, rad.

        Arguments:
            picture: the late one that is seen now.
            command: the commands so far, rad.
        """

    @abc.abstractmethod
    def believed(self, scene: Scene, memory: Any) -> Float[Array, "3"]:
        """Where it believes the camera to be, in the base frame, m."""

    @optional
    def keeping_station(self) -> Self:
        """The controller that stays before the opening, in place of going in.

        Raises:
            InputError: it cannot.
        """
        raise InputError(
            f"{type(self).__name__} cannot hold a position: add a method "
            "keeping_station to this class, or use the controller operator or mpc"
        )


def within_limits(
    command: Array, rates: Array, interval: Scalar, largest_rate: Scalar, largest_angle: Scalar
) -> Float[Array, " joint"]:
    """Commands an interval (s) later by rates (rad/s), within the limits of the joints.

    All are as slow as the fastest needs it, so that the tip goes where it shall.
    """
    rates = rates / jnp.maximum(1, jnp.max(jnp.abs(rates)) / largest_rate)
    return jnp.clip(command + interval * rates, -largest_angle, largest_angle)
