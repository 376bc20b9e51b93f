"""Commands and wind of a synthetic run, as rows from which the same motion can be computed."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...recordings import Run
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...simulation import logged

Times = Float[np.ndarray, " row"]

# Times that differ by less than this (s) are equal: far above rounding, far below a sample.
_SAME_TIME = 1e-9

_MOST_ROWS = 1_000_000


class Move(NamedTuple):
    """Movement of one joint to an angle (rad), within a duration (s); a duration of 0 is a step.

    Joints are numbered from 1, the base joint. `start` is the time at which the movement begins, s.
    """

    joint: int
    angle: float
    start: float
    duration: float


@dataclasses.dataclass(frozen=True)
class Drive:
    """Logged rows of the inputs of an arm.

    Attributes:
        times: times of the rows, increasing, s, shape (row,).
        values: values by channel (`joint01_command`, `wind_x`), SI, each of shape (row,).
        interpolation: interpolation between rows, "linear" or "zoh" (held).
    """

    times: Times
    values: Mapping[str, Times]
    interpolation: str

    def at(self, times: Times) -> dict[str, np.ndarray]:
        """Return the values at other times; the first and last values are held outside."""
        if self.interpolation == "linear":
            return {name: np.interp(times, self.times, row) for name, row in self.values.items()}
        # A sample that rounding places just before a step belongs after it.
        held = np.searchsorted(self.times - _SAME_TIME, times, side="right") - 1
        return {name: row[np.maximum(held, 0)] for name, row in self.values.items()}

    def corners(self) -> Times:
        """Return the times at which a value jumps or its slope changes, s."""
        table = np.stack(list(self.values.values()), axis=1)
        return np.asarray(logged(self.times, table, self.interpolation).times)


def joint_moves(moves: Sequence[Move], *, joints: int, end: float) -> Drive:
    """Return commands that take a straight arm at 0 s through some movements.

    Each movement starts from the final angle of the previous movement of its joint. A joint without
    movements has no column.

    Arguments:
        moves: movements, at least one; either all steps or all ramps.
        end: end of the run, s.

    Raises:
        InputError: a joint that the arm does not have, a movement outside the run, two movements
            that overlap, or steps together with ramps.
    """
    steps = [move for move in moves if move.duration == 0]
    if steps and len(steps) < len(moves):
        raise InputError(
            "steps and ramps are mixed, but all commands of a run must use the same "
            "interpolation: give only steps, or only ramps (a short ramp is almost a step)"
        )
    by_joint: dict[int, list[Move]] = {}
    for move in sorted(moves):
        joint, angle, start, duration = move
        if not 1 <= joint <= joints:
            raise InputError(
                f"joint {joint} is commanded, but the arm has joints 1 to {joints}: "
                "correct the number, or simulate a longer arm"
            )
        if not (np.isfinite(angle) and np.isfinite(duration) and duration >= 0):
            raise InputError(
                f"the movement of joint {joint} at {start:g} s must have a finite angle and a "
                "positive duration: correct the movement"
            )
        if not 0 <= start < end:
            raise InputError(
                f"a movement of joint {joint} starts at {start:g} s, outside the run from 0 to "
                f"{end:g} s: start it earlier or make the run longer"
            )
        by_joint.setdefault(joint, []).append(move)
    knots = {joint: _knots(sorted(of, key=lambda m: m.start)) for joint, of in by_joint.items()}
    times = np.unique(np.concatenate([[0.0], *(times for times, _ in knots.values())]))
    interpolation = "zoh" if steps else "linear"
    values = {}
    for joint, (own, angles) in knots.items():
        name = f"joint{joint:02d}_command"
        values[name] = Drive(own, {name: angles}, interpolation).at(times)[name]
    return Drive(times, values, interpolation)


def _knots(moves: Sequence[Move]) -> tuple[Times, Times]:
    times, angles = [0.0], [0.0]
    free_from = -np.inf
    for move in moves:
        if move.start < free_from + (_SAME_TIME if move.duration == 0 else -_SAME_TIME):
            raise InputError(
                f"two movements of joint {move.joint} overlap at {move.start:g} s: start the "
                "second after the end of the first"
            )
        free_from = move.start + move.duration
        added = [(move.start, angles[-1]), (free_from, move.angle)]
        for time, angle in added[move.duration == 0 :]:
            # A movement that begins at the end of the previous one, or at 0 s, replaces that knot.
            if time - times[-1] <= _SAME_TIME:
                angles[-1] = angle
            else:
                times.append(time)
                angles.append(angle)
    return np.asarray(times), np.asarray(angles)


def sampled(
    drives: Sequence[Drive], *, start: float, duration: float, rate: float
) -> tuple[Times, dict[str, np.ndarray]]:
    """Return the rows of a run: its samples, and a row at each corner between two samples.

    The rows are times (s) and the values of all drives at these times, SI. Because every corner has
    a row, the signal that is read back from the rows is the same.

    Arguments:
        start: first time, s.
        duration: duration, s; a whole number of sampling intervals.
        rate: number of samples per second.

    Raises:
        InputError: a duration that is not a whole number of intervals, or too many samples.
    """
    if not (0 < duration < np.inf and 0 < rate < np.inf):
        raise InputError(
            f"a run of {duration:g} s at {rate:g} samples per second contains no samples: "
            "give two positive numbers"
        )
    count = round(min(duration * rate, 2.0 * _MOST_ROWS))
    if count > _MOST_ROWS:
        raise InputError(
            f"a run of {duration:g} s at {rate:g} samples per second has more than {_MOST_ROWS} "
            "samples: shorten it, or reduce the sampling rate"
        )
    if count < 1 or abs(duration * rate - count) > 1e-6 * count:
        fitting = max(count, 1) / rate
        raise InputError(
            f"{duration:g} s at {rate:g} samples per second do not give a whole number of samples: "
            f"use {fitting:.9g} s, or change the rate"
        )
    samples = np.linspace(start, start + duration, count + 1)
    corners = np.concatenate([np.empty(0), *(drive.corners() for drive in drives)])
    corners = np.unique(corners[(corners > samples[0]) & (corners < samples[-1])])
    after = np.searchsorted(samples, corners)
    nearest = np.minimum(corners - samples[after - 1], samples[after] - corners)
    missed = corners[nearest > _SAME_TIME]
    times = np.sort(np.concatenate([samples, missed]))
    values: dict[str, np.ndarray] = {}
    for drive in drives:
        values.update(drive.at(times))
    return times, values


def planned(
    times: Any,
    inputs: dict[str, Any],
    *,
    links: int = 20,
    channels: Sequence[str] | None = None,
    definition: dict[str, Any] | None = None,
    name: str = "planned",
) -> Run:
    """Return a run of an arm that is still to be recorded: its commands and sample times.

    Arguments:
        times: sample times, s, shape (sample,).
        inputs: inputs of the arm by channel (`joint01_command`), SI, each of shape (sample,).
        links: number of links of the arm, unless the definition contains it.
        channels: channels to be recorded; their values are 0. The default is the positions of all
            links.
        definition: contents of the sidecar.
        name: name of the run.
    """
    definition = dict(definition or {})
    arm = {"links": links, **definition.get("arm", {})}
    every = [f"link{i:02d}_{axis}" for i in range(1, arm["links"] + 1) for axis in "xyz"]
    blank = {channel: np.zeros(len(np.asarray(times))) for channel in channels or every}
    return Run.from_arrays(
        times, {**inputs, **blank}, name=name, definition={**definition, "arm": arm}
    )
