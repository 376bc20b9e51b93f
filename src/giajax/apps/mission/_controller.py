"""Interface of the controllers of a mission: the opening, the picture, and the nominal arm."""

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
    """Return a field that is an array, so that a new value does not cause a new compilation."""
    return eqx.field(converter=lambda x: jnp.asarray(x, jnp.result_type(float)), default=default)


METRES = 2.0
"""Weight of a rotation of the camera: the displacement of the tip equivalent to one radian, m."""

_AHEAD = 3.0  # depth of the aim point of the camera behind an opening, m; the tip does not reach it


class Opening(NamedTuple):
    """Opening in a wall, described from the side that the x axis of the wall points to.

    Attributes:
        centre: centre of its outer face in the base frame, m.
        frame: unit vectors outwards, to the left and up, as columns.
        half: half of its width and height, m.
        thickness: thickness of the wall, m.
    """

    centre: Float[Array, "3"]
    frame: Float[Array, "3 3"]
    half: Float[Array, "2"]
    thickness: Scalar

    @property
    def corners(self) -> Float[Array, "4 3"]:
        """Corners of the outer face in the base frame, m."""
        signs = jnp.asarray([[1, 1], [-1, 1], [-1, -1], [1, -1]], self.half.dtype)
        return self.centre[None] + (signs * self.half[None]) @ self.frame[:, 1:].T

    @property
    def ahead(self) -> Float[Array, "3"]:
        """Aim point of a camera that enters, behind the opening, in the base frame, m."""
        return self.centre - _AHEAD * self.frame[:, 0]

    def outside(
        self, local: Float[Array, "3"], *, near: Scalar, stand_off: Scalar, deep: Scalar
    ) -> Scalar:
        """Return the target distance of a tip outwards, m, which decreases towards the axis.

        Arguments:
            local: position of the tip from the method `local`, m.
            near: distance from the axis within which the tip enters, m.
            stand_off: distance in front of the opening at which the tip moves to the axis, m.
            deep: depth to which the tip enters, m.
        """
        return jnp.clip(2 * (safe_norm(local[1:]) - near), -deep, stand_off)

    def local(self, points: Float[Array, "*point 3"]) -> Float[Array, "*point 3"]:
        """Return points in the base frame as distances outwards, to the left and up, m."""
        rows = points.reshape(-1, 3) - self.centre[None]
        return (rows @ self.frame).reshape(points.shape)

    def holds(self, local: Float[Array, "3"]) -> Bool[Array, ""]:
        """Return whether a point is behind the outer face and within the cross-section."""
        return (local[0] < 0) & (self.beside(local) == 0)

    def beside(self, local: Float[Array, "3"]) -> Scalar:
        """Return the distance of a point from the cross-section, across the axis, m; 0 within."""
        out = jnp.maximum(jnp.abs(local[1:]) - self.half, 0)
        return jnp.sqrt(jnp.sum(out**2))


def opening_of(arm: Arm, name: str | None = None) -> Opening:
    """Return the opening of a wall near an arm; the name is required if there are several."""
    obstacles = () if arm.contact is None else arm.contact.obstacles
    walls = {each.name: each for each in obstacles if isinstance(each, WallWithOpening)}
    if not walls:
        raise InputError(
            'the arm has no opening to enter: add a wall, as [[arm.obstacles]] with shape = "wall"'
        )
    if name is None and len(walls) > 1:
        raise InputError(f"several walls have an opening ({', '.join(walls)}): name one of them")
    if name is not None and name not in walls:
        raise InputError(f"'{name}' is not a wall with an opening: use one of {', '.join(walls)}")
    wall = next(iter(walls.values())) if name is None else walls[name]
    turn = wall.turn()
    frame = jnp.stack([rotate(turn, axis) for axis in jnp.eye(3, dtype=turn.dtype)], axis=1)
    centre = wall.centre + frame[:, 0] * wall.thickness / 2
    return Opening(centre, frame, wall.opening / 2, wall.thickness)


class Scene(NamedTuple):
    """Information that a controller has before the start.

    Attributes:
        arm: nominal arm, from which the simulated arm can differ.
        camera: camera at the tip.
        opening: opening to enter.
        interval: interval between two decisions, s.
    """

    arm: Arm
    camera: Pinhole
    opening: Opening
    interval: Scalar


class Picture(NamedTuple):
    """Corners of an opening in a camera picture, and the commands at the time of the picture.

    Attributes:
        pixels: pixel positions of the corners, px.
        seen: whether each corner is in the picture.
        room: whether the picture shows the room behind the opening.
        commanded: commanded angles of the joints at the time of the picture, rad.
    """

    pixels: Float[Array, "4 2"]
    seen: Bool[Array, "4"]
    room: Bool[Array, ""]
    commanded: Float[Array, " joint"]

    def blind(self, before: Scalar, interval: Scalar) -> Scalar:
        """Return how long fewer than two corners have been visible, s, after one more interval."""
        return jnp.where(jnp.sum(self.seen) >= 2, 0, before + interval)


class AbstractController(eqx.Module):
    """Controller of the arm, which knows the opening, delayed pictures and its own commands.

    Its internal state (memory) is a pytree of arrays, so that a whole mission is one compiled
    program.
    """

    @abc.abstractmethod
    def start(self, scene: Scene, late: int) -> Any:
        """Return the memory at the start, for a straight arm at rest.

        Arguments:
            scene: information from before the start.
            late: delay of the pictures, in intervals.
        """

    @abc.abstractmethod
    def decide(
        self, scene: Scene, memory: Any, picture: Picture, command: Float[Array, " joint"]
    ) -> tuple[Any, Float[Array, " joint"]]:
        """Return the updated memory, and the commands one interval later, rad.

        Arguments:
            scene: information from before the start.
            memory: memory after the previous decision.
            picture: delayed picture that arrives now.
            command: current commands, rad.
        """

    @abc.abstractmethod
    def believed(self, scene: Scene, memory: Any) -> Float[Array, "3"]:
        """Return the estimated position of the camera in the base frame, m."""

    @optional
    def keeping_station(self) -> Self:
        """Return a controller that holds the tip in front of the opening instead of entering.

        Raises:
            InputError: the controller cannot hold a position.
        """
        raise InputError(
            f"{type(self).__name__} cannot hold a position: add a method "
            "keeping_station to this class, or use the controller operator or mpc"
        )


def within_limits(
    command: Array, rates: Array, interval: Scalar, largest_rate: Scalar, largest_angle: Scalar
) -> Float[Array, " joint"]:
    """Return the commands after an interval, s, at given rates, rad/s, within the joint limits.

    All rates are reduced by the same factor, so that the direction of the motion does not change.
    """
    rates = rates / jnp.maximum(1, jnp.max(jnp.abs(rates)) / largest_rate)
    return jnp.clip(command + interval * rates, -largest_angle, largest_angle)
