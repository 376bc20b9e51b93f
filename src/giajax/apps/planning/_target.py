"""Targets of a planned motion: a pose, a position of the tip, or the far side of an opening."""

import abc
import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import least_squares, minimize

from ...mechanics.arm import Arm, clearance, tip_position
from ...runtime.arrays import Array, Float
from ...runtime.plugins import optional
from ...runtime.programs import program
from ...runtime.text import InputError
from .._moves import reached, rest_at, resting
from ..mission import opening_of


@dataclasses.dataclass(frozen=True)
class CommandLimits:
    """Limits of a command and of the motion that it causes.

    Attributes:
        angle: largest commanded angle of each joint, rad.
        rate: largest rate of the command of each joint, rad/s. The limits of the drives of the
            paper's arm are not published: 2 degrees per second is an assumption.
        clearance: smallest clearance between all links and all obstacles, m.
        pressure: largest pressure of each muscle, Pa; None for the limits of the drives only.

    Raises:
        InputError: a limit that is not positive, or a negative clearance.
    """

    angle: float = float(np.deg2rad(60.0))
    rate: float = float(np.deg2rad(2.0))
    clearance: float = 0.2
    pressure: float | None = None

    def __post_init__(self) -> None:
        for name in ("angle", "rate", "pressure"):
            value = getattr(self, name)
            if value is not None and not value > 0:
                raise InputError(f"the largest {name} is {value:g}: give a positive number")
        if not self.clearance >= 0:
            raise InputError(f"the clearance is {self.clearance:g} m: give a number of at least 0")


Looked = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class KeptLast:
    """Cache the last values and derivatives of a function; optimisers request each separately."""

    def __init__(self, look: Looked) -> None:
        self._look = look
        self._last: bytes | None = None

    def __call__(self, unknown: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if (raw := np.asarray(unknown, dtype=float).tobytes()) != self._last:
            self._known, self._last = self._look(np.frombuffer(raw)), raw
        return self._known


def headroom(arm: Arm, command: Array, most: Array) -> Array:
    """Return the pressure that each muscle has left under a command (rad), over the limit (Pa)."""
    assert arm.pneumatics is not None
    pressures = arm.pneumatics.commanded(reached(arm, command))
    return 1 - pressures.ravel() / most


class AbstractTarget(abc.ABC):
    """Target in which an arm is to be at rest after the command."""

    @abc.abstractmethod
    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Return the commanded angles of the poses to pass, rad; the last ones hold the target.

        Arguments:
            begin: commanded angles of the initial rest pose, rad.

        Raises:
            InputError: the target cannot be reached.
        """

    @optional  # noqa: B027
    def check(self, arm: Arm, tips: Float[np.ndarray, "sample 3"]) -> None:
        """Raise an error if the path of the tip (m) is not as required; by default it always is."""


@dataclasses.dataclass(frozen=True)
class Pose(AbstractTarget):
    """The rest pose that belongs to commanded angles (rad)."""

    angles: Float[np.ndarray, " joint"]

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Return the angles of the pose; see `AbstractTarget`."""
        angles = np.asarray(self.angles, dtype=float)
        if angles.shape != begin.shape:
            raise InputError(
                f"the pose has {angles.size} angles, but the arm has {arm.count} joints: "
                "give one angle for each joint"
            )
        return angles[None]


@dataclasses.dataclass(frozen=True)
class Tip(AbstractTarget):
    """A position of the tip in the base frame, m."""

    place: tuple[float, float, float]

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Return the angles that differ least from the initial ones; see `AbstractTarget`."""
        return commands_reaching(arm, np.asarray(self.place, dtype=float), begin, limits)[None]


@dataclasses.dataclass(frozen=True)
class Through(AbstractTarget):
    """Through the opening of a wall, from the side that its x axis points to, to rest behind it.

    Attributes:
        wall: name of the wall; None if there is only one.
        beyond: final distance of the tip behind the outer face, m.
        before: distance in front of the face at which the tip is first aligned with the axis of the
            opening, m.
        approach: commanded angles near which the opening is approached, rad; None for the initial
            angles.
    """

    wall: str | None = None
    beyond: float = 0.75
    before: float = 1.5
    approach: Float[np.ndarray, " joint"] | None = None

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Return the poses in front of the opening, in it, and behind it; see `AbstractTarget`."""
        opening = opening_of(arm, self.wall)
        centre, outwards = np.asarray(opening.centre), np.asarray(opening.frame[:, 0])
        ways, near = [], begin if self.approach is None else np.asarray(self.approach)
        for outside in (self.before, 0.0, -self.beyond):
            near = commands_reaching(arm, centre + outside * outwards, near, limits)
            ways.append(near)
        return np.stack(ways)

    def check(self, arm: Arm, tips: Float[np.ndarray, "sample 3"]) -> None:
        """Raise an error if the path does not cross the face of the wall within the opening."""
        opening = opening_of(arm, self.wall)
        local = (np.asarray(tips) - np.asarray(opening.centre)) @ np.asarray(opening.frame)
        inwards = np.flatnonzero((local[:-1, 0] > 0) & (local[1:, 0] <= 0))
        for one, other in zip(local[inwards], local[inwards + 1], strict=True):
            place = one + (other - one) * one[0] / (one[0] - other[0])
            if np.all(np.abs(place[1:]) < np.asarray(opening.half)):
                return
        raise InputError(
            "the planned path does not pass through the opening: start before the wall, or "
            "choose initial and target poses that are closer to it"
        )


ROOM = 0.03  # Margin of the clearance between the times at which a motion is evaluated, m.
_OFF = 0.01  # Tolerated position error of the tip, m.
# Initial bend, because the tip of a straight arm has no gradient towards its base.
_BEND = np.deg2rad(2.0)
_FAR = 0.5  # Distance beyond which a target is out of reach regardless of obstacles, m.
_LIGHT = 0.03  # Weight of the change of angles relative to the distance, m/rad.


def commands_reaching(
    arm: Arm,
    place: Float[np.ndarray, "3"],
    near: Float[np.ndarray, " joint"],
    limits: CommandLimits,
) -> Float[np.ndarray, " joint"]:
    """Return commanded angles that hold the tip at a position (m), as close as possible to others.

    Raises:
        InputError: no such angles are found within the limits.
    """
    goal, kept = (jnp.asarray(each, jnp.result_type(float)) for each in (place, near))
    most = jnp.asarray(limits.pressure or np.inf, kept.dtype)

    @KeptLast
    def looked(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values, slopes = _at_rest(arm, jnp.asarray(angles, kept.dtype), goal, most)
        return np.nan_to_num(np.asarray(values)), np.nan_to_num(np.asarray(slopes))

    free = limits.clearance + 2 * ROOM if arm.contact is not None else 0.0
    margin = np.concatenate([np.full(3, 0.0), *_margins(arm, limits, free)])

    def part(which: slice) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
        return {
            "fun": lambda u: (looked(u)[0] - margin)[which],
            "jac": lambda u: looked(u)[1][which],
        }

    constraints: list[Any] = [{"type": "eq", **part(slice(3))}]
    if len(margin) > 3:
        constraints.append({"type": "ineq", **part(slice(3, None))})
    limit = limits.angle
    start = np.clip(near, -limit, limit) + (_BEND if np.ptp(near) < _BEND else 0.0)
    towards = least_squares(
        lambda u: np.concatenate([looked(u)[0][:3], _LIGHT * (u - near)]),
        np.clip(start, -0.99 * limit, 0.99 * limit),
        lambda u: np.concatenate([looked(u)[1][:3], _LIGHT * np.eye(arm.count)]),
        bounds=(-limit, limit),
    )
    nearest = float(np.linalg.norm(looked(towards.x)[0][:3]))
    if nearest > _FAR:
        raise InputError(
            f"the tip cannot be at {_text(place)} m with joint angles within {np.rad2deg(limit):g} "
            f"deg (the tip of the closest pose found is {nearest:.2g} m away): choose a target "
            "within reach"
        )
    found = minimize(
        lambda u: (float(np.sum((u - near) ** 2)), 2 * (u - near)),
        towards.x,
        jac=True,
        method="SLSQP",
        bounds=[(-limit, limit)] * arm.count,
        constraints=constraints,
        options={"maxiter": 100, "ftol": 1e-8},
    )
    values = looked(found.x)[0] - margin
    off = float(np.linalg.norm(values[:3]))
    known_rest = rest_at(without_contact(arm), jnp.asarray(found.x, kept.dtype))
    if off > _OFF or np.min(values[3:], initial=0.0) < -_OFF or not known_rest.known:
        kept_to = "" if len(margin) == 3 else " and with the required clearance"
        raise InputError(
            f"no pose was found in which the tip is at {_text(place)} m, with joint angles within "
            f"{np.rad2deg(limits.angle):g} deg{kept_to} (the closest tip is {off:.2g} m away): "
            "choose a target within reach, or reduce the clearance"
        )
    return np.asarray(found.x)


def _margins(arm: Arm, limits: CommandLimits, clear: float) -> list[np.ndarray]:
    """Return the required margin of each constraint of `_at_rest` that follows the position."""
    rows = [] if arm.contact is None else [np.full(arm.count, clear)]
    if arm.pneumatics is not None:
        rows.append(np.zeros(2 * arm.count))
    return rows


def _text(place: np.ndarray) -> str:
    return "({})".format(", ".join(f"{each:.4g}" for each in place))


@program
def _at_rest(arm: Arm, command: Array, goal: Array, most: Array) -> tuple[Array, Array]:
    """Return the rest values of the constraints and their derivatives by the command.

    They are the offset of the tip from a position (m), the clearance of each link (m), and the
    headroom of the muscles.
    """
    free = without_contact(arm)

    def at(command: Array) -> tuple[Array, Array]:
        angles = resting(free, reached(free, command))[0]
        rows = [tip_position(free, angles) - goal]
        if arm.contact is not None:
            rows.append(jnp.min(clearance(arm, angles), axis=1))
        if arm.pneumatics is not None:
            rows.append(headroom(arm, command, most))
        values = jnp.concatenate(rows)
        return values, values

    slopes, values = jax.jacfwd(at, has_aux=True)(command)
    return values, slopes


def without_contact(arm: Arm) -> Arm:
    """Return the arm without obstacles: it moves like an arm that keeps clear of them."""
    return dataclasses.replace(arm, contact=None)
