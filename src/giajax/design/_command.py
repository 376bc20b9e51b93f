"""A command series as few numbers: angles at knots, between which each joint moves steadily.

The numbers are angles over the largest angle. Angle and rate of such a series are largest at its
knots and between two of them, so that its limits are linear in the numbers: a convex set, in which
an optimiser for linear constraints stays. `within` is the projection that makes rounding harmless.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
from scipy.optimize import LinearConstraint

from .._errors import InputError
from .._typing import Array, Float
from ..simulation import Signal
from ..synthetic import Drive
from ._limits import Limits

# What a decimal number in a file may add to an angle or a rate.
_ROUNDING = 1e-9

_LEAD = 0.5
"""When the paper's base step begins, s."""

Numbers = Float[np.ndarray, " number"]


@dataclasses.dataclass(frozen=True)
class CommandSeries:
    """The command series that some limits allow, with knots at rows of the experiment.

    Attributes:
        limits: what a series may do.
        times: of the knots, the first of which is at 0 s, shape (knot,).
    """

    limits: Limits
    times: Float[np.ndarray, " knot"]

    @classmethod
    def of(cls, limits: Limits, knots: int) -> "CommandSeries":
        """Series of so many knots after the first one, as evenly spaced as rows allow.

        Raises:
            InputError: fewer than 2, or more than rows.
        """
        if not 2 <= knots <= limits.rows:
            raise InputError(
                f"the command has {knots} knots, and the experiment {limits.rows} intervals: give "
                f"a number from 2 to {limits.rows}"
            )
        rows = np.round(np.arange(knots + 1) * limits.rows / knots)
        return cls(limits, rows / limits.sampling)

    @property
    def size(self) -> int:
        """How many numbers a series is."""
        return (len(self.times) - 1) * len(self.limits.joints)

    def within(self, numbers: Numbers) -> Numbers:
        """The numbers of a series within the limits: each angle in turn as near as it may be."""
        reach = self._reach()
        wanted = np.asarray(numbers, dtype=float).reshape(len(reach), -1)
        angles = np.zeros_like(wanted)
        before = np.zeros(wanted.shape[1])
        for knot, most in enumerate(reach):
            angles[knot] = np.clip(wanted[knot], before - most, before + most)
            angles[knot] = before = np.clip(angles[knot], _ROUNDING - 1, 1 - _ROUNDING)
        return angles.ravel()

    def constraint(self) -> LinearConstraint:
        """How far angles of successive knots may be apart; the angles themselves are in [-1, 1]."""
        joints = len(self.limits.joints)
        difference = np.eye(self.size) - np.eye(self.size, k=-joints)
        most = np.repeat(self._reach(), joints)
        return LinearConstraint(difference, -most, most)

    def base_step(self) -> Numbers:
        """The paper's base step, as nearly as the knots allow."""
        wanted = base_step(self.limits, len(self.times))
        angles = [np.interp(self.times[1:], wanted.times, row) for row in wanted.table().T]
        return self.within(np.stack(angles, axis=1).ravel() / self.limits.angle)

    def at(self, numbers: Numbers) -> "Command":
        """The series of some numbers."""
        return Command(self.limits, self.times, np.asarray(numbers, dtype=float))

    def _reach(self) -> Float[np.ndarray, " knot"]:
        """How far a joint comes from each knot to the next, over the largest angle."""
        limits = self.limits
        return (1 - _ROUNDING) * np.diff(self.times) * limits.rate / limits.angle


def knotted(
    times: Float[Array, " knot"],
    angles: Float[Array, "turn moved"],
    moving: tuple[int, ...],
    count: int,
) -> Signal:
    """The command of an arm through angles at knots, which may be differentiated by the angles.

    Arguments:
        times: of the knots, s, shape (knot,).
        angles: at all knots but the first, where they are 0, rad, shape (knot - 1, moving joint).
        moving: numbers of the joints that move.
        count: joints of the arm.
    """
    places = np.asarray(moving) - 1
    values = jnp.zeros((len(times), count), angles.dtype).at[1:, places].set(angles)
    slopes = jnp.diff(values, axis=0) / jnp.diff(times)[:, None]
    slopes = jnp.concatenate([slopes, jnp.zeros_like(slopes[:1])])
    return Signal(times, values, slopes, jnp.full_like(times, jnp.inf))


def base_step(limits: Limits, knots: int) -> "Command":
    """The paper's experiment: one joint to the largest angle at the largest rate.

    That is joint 1 if it may move, else the first that may. Knots beyond the three of its corners
    come after the end.

    Arguments:
        limits: what it may do.
        knots: how many there are to be, so that one program does for all commands.
    """
    begin = min(_LEAD, 0.5 * limits.duration)
    corners = [0.0, begin, begin + limits.angle / limits.rate]
    end = max(corners[-1], limits.duration)
    times = np.asarray([*corners, *(end + 1.0 + np.arange(knots - 3))])
    numbers = np.zeros((knots - 1, len(limits.joints)))
    numbers[1:, limits.joints.index(1) if 1 in limits.joints else 0] = 1.0
    return Command(limits, times, numbers.ravel())


@dataclasses.dataclass(frozen=True)
class Command:
    """One command series.

    Attributes:
        limits: what it may do, and which joints it moves.
        times: of its knots, s, shape (knot,).
        numbers: angles at all knots but the first over the largest, shape (number,).
    """

    limits: Limits
    times: Float[np.ndarray, " knot"]
    numbers: Numbers

    def table(self) -> Float[np.ndarray, "knot moved"]:
        """Angles of the joints that move, rad."""
        table = np.asarray(self.numbers, dtype=float).reshape(len(self.times) - 1, -1)
        return np.concatenate([np.zeros((1, table.shape[1])), table]) * self.limits.angle

    def drive(self) -> Drive:
        """The same as rows, by the channel of each joint that does move."""
        columns = zip(self.limits.joints, self.table().T, strict=True)
        named = {f"joint{joint:02d}_command": row for joint, row in columns}
        moving = {name: row for name, row in named.items() if np.any(row)} or named
        kept = np.flatnonzero(self.times <= max(self.limits.duration, self.times[1]))
        last = min(kept[-1] + 2, len(self.times))
        rows = {name: row[:last] for name, row in moving.items()}
        return Drive(self.times[:last], rows, "linear")
