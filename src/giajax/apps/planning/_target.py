"""Where an arm is to go: a pose, a place of its tip, or through an opening."""

import abc
import dataclasses
import functools
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
    """What a command and its motion must keep to.

    Attributes:
        angle: of the command of each joint at most, rad.
        rate: of the command of each joint at most, rad/s. What the drives of the paper's arm can do
            is not published: 2 degrees a second are an assumption.
        clearance: of all links from whatever stands around at least, m.
        pressure: in each muscle at most, Pa; None for what the drives give.

    Raises:
        InputError: a limit that leaves nothing.
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


def kept_last(look: Looked) -> Looked:
    """A function of unknowns that keeps its last values and slopes: optimisers request each."""

    @functools.lru_cache(maxsize=1)
    def known(raw: bytes) -> tuple[np.ndarray, np.ndarray]:
        return look(np.frombuffer(raw))

    return lambda unknown: known(np.asarray(unknown, dtype=float).tobytes())


def headroom(arm: Arm, command: Array, most: Array) -> Array:
    """What muscles are below a pressure (Pa) under a command (rad), as a share, of each."""
    assert arm.pneumatics is not None
    pressures = arm.pneumatics.commanded(reached(arm, command))
    return 1 - pressures.ravel() / most


class AbstractTarget(abc.ABC):
    """Where an arm is to be at rest in the end."""

    @abc.abstractmethod
    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Commanded angles at whose poses it comes by, from the first on, rad; the last ones hold
        it there.

        Arguments:
            begin: commanded angles at which it rests in the beginning, rad.

        Raises:
            InputError: it cannot be reached.
        """

    @optional  # noqa: B027
    def check(self, arm: Arm, tips: Float[np.ndarray, "sample 3"]) -> None:
        """Refuse a way of the tip (m) that is not the one that was asked for: none by default."""


@dataclasses.dataclass(frozen=True)
class Pose(AbstractTarget):
    """The pose in which an arm rests by commanded angles (rad)."""

    angles: Float[np.ndarray, " joint"]

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Those angles; as of `AbstractTarget`."""
        angles = np.asarray(self.angles, dtype=float)
        if angles.shape != begin.shape:
            raise InputError(
                f"the pose has {angles.size} angles, but the arm has {arm.count} joints"
            )
        return angles[None]


@dataclasses.dataclass(frozen=True)
class Tip(AbstractTarget):
    """A place of the tip in the base frame, m."""

    place: tuple[float, float, float]

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Those that change least from the beginning; as of `AbstractTarget`."""
        return commands_reaching(arm, np.asarray(self.place, dtype=float), begin, limits)[None]


@dataclasses.dataclass(frozen=True)
class Through(AbstractTarget):
    """Through the opening of a wall, from the side that its x points to, and at rest behind it.

    Attributes:
        wall: its name; None where there is one alone.
        beyond: how far behind the outer face the tip is in the end, m.
        before: how far before the face the tip is on the opening's axis before it goes in, m.
        approach: commanded angles near which the opening is approached, rad; None: the beginning.
    """

    wall: str | None = None
    beyond: float = 0.75
    before: float = 1.5
    approach: Float[np.ndarray, " joint"] | None = None

    def commands(
        self, arm: Arm, begin: Float[np.ndarray, " joint"], limits: CommandLimits
    ) -> Float[np.ndarray, "way joint"]:
        """Before the opening, in it, and behind it; as of `AbstractTarget`."""
        opening = opening_of(arm, self.wall)
        centre, outwards = np.asarray(opening.centre), np.asarray(opening.frame[:, 0])
        ways, near = [], begin if self.approach is None else np.asarray(self.approach)
        for outside in (self.before, 0.0, -self.beyond):
            near = commands_reaching(arm, centre + outside * outwards, near, limits)
            ways.append(near)
        return np.stack(ways)

    def check(self, arm: Arm, tips: Float[np.ndarray, "sample 3"]) -> None:
        """Refuse a way that does not cross the face of the wall within the opening."""
        opening = opening_of(arm, self.wall)
        local = (np.asarray(tips) - np.asarray(opening.centre)) @ np.asarray(opening.frame)
        inwards = np.flatnonzero((local[:-1, 0] > 0) & (local[1:, 0] <= 0))
        for one, other in zip(local[inwards], local[inwards + 1], strict=True):
            place = one + (other - one) * one[0] / (one[0] - other[0])
            if np.all(np.abs(place[1:]) < np.asarray(opening.half)):
                return
        raise InputError(
            "the path that was found does not pass through the opening: start before the wall, or "
            "choose initial and target poses that are closer to it"
        )


ROOM = 0.03  # m, of clearance between the times at which a motion is looked at
_OFF = 0.01  # of a tip that is where it is to be, m
_BEND = np.deg2rad(2.0)  # a straight arm has no slope towards its base
_FAR = 0.5  # m, beyond which a target is out of reach whatever stands around
_LIGHT = 0.03  # m/rad, of changes beside the distance


def commands_reaching(
    arm: Arm,
    place: Float[np.ndarray, "3"],
    near: Float[np.ndarray, " joint"],
    limits: CommandLimits,
) -> Float[np.ndarray, " joint"]:
    """Commanded angles that hold the tip at a place (m) at rest, and change least from others.

    Raises:
        InputError: none are found within the limits.
    """
    goal, kept = (jnp.asarray(each, jnp.result_type(float)) for each in (place, near))
    most = jnp.asarray(limits.pressure or np.inf, kept.dtype)

    @kept_last
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
            f"deg: the tip of the closest pose found is {nearest:.2g} m away from it; choose a "
            "target within reach"
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
    """What is to be left of each constraint of `_at_rest` behind the place."""
    rows = [] if arm.contact is None else [np.full(arm.count, clear)]
    if arm.pneumatics is not None:
        rows.append(np.zeros(2 * arm.count))
    return rows


def _text(place: np.ndarray) -> str:
    return "({})".format(", ".join(f"{each:.4g}" for each in place))


@program
def _at_rest(arm: Arm, command: Array, goal: Array, most: Array) -> tuple[Array, Array]:
    """How far the tip is from a place at rest (m), how clear links are (m), and the headroom of
    muscles; and slopes of these by the command.
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
    """The arm with nothing around it: what keeps clear of everything moves as if it were alone."""
    return dataclasses.replace(arm, contact=None)
