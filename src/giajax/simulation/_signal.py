"""Inputs over time: commands of the joints, wind velocity, and pressures in muscles.

All are piecewise linear, with jumps allowed at the knots, so one class represents steps, ramps and
logged rows. The step-size controller must not step over knots that are corners.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import Arm, Joints, Pneumatics
from ..mechanics.joint import (
    LARGEST_ANGLE,
    NEEDS_PRESSURE,
    TOO_SHORT,
    PairCommand,
    check_geometry,
    muscle_balance,
)
from ..runtime.arrays import Array, Bool, Float, Scalar, larger
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema.parameters import is_concrete

# Number of parts into which a piece is divided for the comparison with a cubic.
_PARTS = 4
# Roughness above which no tolerance can accept an interval, as a fraction of the largest value.
_ROUGH = 0.1


def corner_rows(times: np.ndarray, values: np.ndarray, allowed: float) -> np.ndarray:
    """Return the rows that remain if rows on a straight line between their neighbours are merged.

    From each kept row, the band of slopes that pass within `allowed` (in the unit of the values) of
    all following rows is narrowed until it is empty. The row before that is the next corner.
    """
    kept = [0]
    lowest, highest = np.full(values.shape[1], -np.inf), np.full(values.shape[1], np.inf)
    for row in range(1, len(times)):
        elapsed = times[row] - times[kept[-1]]
        rise = values[row] - values[kept[-1]]
        slope = rise / elapsed
        if np.any(slope < lowest) or np.any(slope > highest):
            kept.append(row - 1)
            elapsed = times[row] - times[row - 1]
            rise = values[row] - values[row - 1]
            lowest, highest = (rise - allowed) / elapsed, (rise + allowed) / elapsed
            continue
        lowest = np.maximum(lowest, (rise - allowed) / elapsed)
        highest = np.minimum(highest, (rise + allowed) / elapsed)
    if len(times) > 1:
        kept.append(len(times) - 1)
    return np.asarray(kept)


def roughness(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the deviation of a signal from a cubic around each knot, relative to its maximum.

    Intervals of 2, 4, 8, ... pieces are compared with their best cubic. The roughness of a knot is
    the deviation of the smallest interval with the knot in its middle, or of any interval inside it
    if that deviation is larger. Between two knots that are rougher than a tolerance, the signal is
    therefore a cubic to within the tolerance, so a step of any length misses nothing there. The
    roughness is infinite if no interval has the knot in its middle, as at both ends.
    """
    rough = np.full(len(times), np.inf)
    size = np.abs(values).max()
    values = values[:, np.ptp(values, axis=0) > 0]
    if values.size == 0:
        return rough
    pieces, within = 2, np.zeros(len(times) - 1)
    while pieces < len(times):
        count = (len(times) - 1) // pieces
        within = within[: 2 * count].reshape(count, 2).max(axis=1)
        within = np.maximum(within, _off_cubics(times, values / size, pieces, count))
        rough[pieces // 2 :: pieces][:count] = within
        if within.min() > _ROUGH:
            break
        pieces *= 2
    return rough


def _off_cubics(times: np.ndarray, values: np.ndarray, pieces: int, count: int) -> np.ndarray:
    """Return the maximum deviations of intervals of some pieces from cubics, shape (count,)."""
    part = np.arange(_PARTS * pieces + 1)
    piece = np.minimum(part // _PARTS, pieces - 1)
    knot = pieces * np.arange(count)[:, None] + piece
    share = part / _PARTS - piece
    at = times[knot] + share * (times[knot + 1] - times[knot])
    value = values[knot] + share[:, None] * (values[knot + 1] - values[knot])
    x = 2 * (at - at[:, :1]) / (at[:, -1:] - at[:, :1]) - 1
    basis = np.linalg.qr(np.stack([np.ones_like(x), x, x**2, x**3], axis=-1))[0]
    off = value - basis @ (basis.swapaxes(1, 2) @ value)
    return np.asarray(np.abs(off).max(axis=(1, 2)))


# A comparison with every knot takes a few vector instructions. For more knots than this, a subset
# is compared first. With a binary search, derivatives of a simulation would take a fifth longer.
_COMPARE_ALL = 512

# Maximum roughness, in units of the relative tolerance, of a knot that steps may cross. An arm
# responds so weakly that the motion of the paper's arm is as accurate with 20 as with 3, with up to
# a third fewer steps (and up to a seventh fewer than with 10).
_CROSSED = 20.0


class Signal(eqx.Module):
    """Piecewise linear function of time with values of a fixed width.

    From knot i until the next knot, the value is `values[i] + slopes[i] * (t - times[i])`. Before
    the first knot it is `values[0]`.

    Derivatives of a simulation with respect to `times` are correct if the signal does not jump.
    With respect to the time of a jump they are incomplete, without an error message: for `steps`
    and for `zoh` rows they are 0.

    Arguments:
        times: times of the knots, increasing, s, shape (knot,).
        values: values just after each knot, shape (knot, width).
        slopes: slopes after each knot, per second, shape (knot, width).
        roughness: deviation of the signal from a cubic around each knot, relative to its largest
            value, shape (knot,); infinite at a jump.
    """

    times: Float[Array, " knot"]
    values: Float[Array, "knot width"]
    slopes: Float[Array, "knot width"]
    roughness: Float[Array, " knot"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Return the value at a time (s)."""
        knot = last_before(self.times, time)
        elapsed = larger(time - self.times[knot], 0)
        return self.values[knot] + self.slopes[knot] * elapsed

    def rate(self, time: Scalar) -> Float[Array, " width"]:
        """Return the slope at a time (s), without jumps; 0 before the first knot."""
        return jnp.where(time >= self.times[0], self.slopes[last_before(self.times, time)], 0)

    def corners(self, tolerance: Scalar) -> tuple[Float[Array, " knot"], Float[Array, " knot"]]:
        """Return the times (s) of the knots that steps may not cross, and of the other knots.

        `tolerance` is the relative tolerance of a step. Each array contains infinity for the knots
        of the other.
        """
        corner = self.roughness > _CROSSED * tolerance
        return jnp.where(corner, self.times, jnp.inf), jnp.where(corner, jnp.inf, self.times)

    @property
    def jumps(self) -> Bool[Array, ""]:
        """Whether the signal jumps at one of its knots by more than rounding."""
        before = self.values[:-1] + self.slopes[:-1] * jnp.diff(self.times)[:, None]
        size = jnp.max(jnp.abs(self.values), initial=0.0)
        return jnp.any(jnp.abs(self.values[1:] - before) > 1e-6 * size)

    @property
    def width(self) -> int:
        """Number of values at one time."""
        return self.values.shape[1]


# A lag below this (s) is treated as zero, because it does not affect the motion and quotients by it
# must remain finite.
_NO_LAG = 1e-12


class LaggedSignal(eqx.Module):
    """Exact first-order lag of a signal u: lag dy/dt = u - y, starting from rest.

    After knot k, where u has the slope s, the value is u - lag s + c exp(-(t - t_k) / lag). The
    derivative with respect to a lag of 0 is the derivative from above, -s. At jumps it is
    incomplete, like the derivative of a `Signal` with respect to the time of a jump.

    Arguments:
        signal: signal u.
        lag: time constant of each value, s, shape (width,).
        transients: coefficients c of each knot, shape (knot, width).
    """

    signal: Signal
    lag: Float[Array, " width"]
    transients: Float[Array, "knot width"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Return the value at a time (s)."""
        times = self.signal.times
        knot = last_before(times, time)
        left = self.transients[knot] * _left_over(time - times[knot], self.lag)
        behind = self.lag * self.signal.slopes[knot] - left
        return self.signal(time) - jnp.where(time >= times[0], behind, 0)


class SaturatedSignal(eqx.Module):
    """Angle that drives reach when they follow a signal u: u / sqrt(1 + saturation u^2).

    Arguments:
        signal: signal u, rad.
        saturation: inverse square of the limiting angle, 1/rad^2, one value or one for each column.
    """

    signal: Signal | LaggedSignal
    saturation: Float[Array, ""] | Float[Array, " width"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Return the value at a time (s)."""
        angle = self.signal(time)
        return angle / jnp.sqrt(1 + self.saturation * angle**2)


Followed = Signal | LaggedSignal | SaturatedSignal
"""Angles towards which the springs of an arm pull, over time."""


def followed(signal: Signal, joints: Joints) -> Followed:
    """Apply the gain, the lag and the saturation of the drives to a command, in this order."""
    if joints.drive_gain is not None:
        gain = jnp.broadcast_to(joints.drive_gain, (signal.width,))[None]
        signal = dataclasses.replace(
            signal, values=signal.values * gain, slopes=signal.slopes * gain
        )
    reached = lagged(signal, joints.drive_lag)
    saturation = joints.drive_saturation
    return reached if saturation is None else SaturatedSignal(reached, saturation)


def lagged(signal: Signal, lag: Array | None) -> Signal | LaggedSignal:
    """Apply a lag (s), one value or one for each column, to a signal; None leaves it unchanged."""
    if lag is None:
        return signal
    lag = jnp.broadcast_to(lag, (signal.width,))
    elapsed = jnp.diff(signal.times)[:, None]
    jumps = signal.values[1:] - signal.values[:-1] - signal.slopes[:-1] * elapsed
    bends = lag[None] * jnp.diff(signal.slopes, axis=0) - jumps

    def after(transient: Array, piece: tuple[Array, Array]) -> tuple[Array, Array]:
        transient = transient * piece[0] + piece[1]
        return transient, transient

    first = lag * signal.slopes[0]
    _, others = jax.lax.scan(after, first, (_left_over(elapsed, lag[None]), bends))
    return LaggedSignal(signal, lag, jnp.concatenate([first[None], others]))


def _left_over(elapsed: Array, lag: Array) -> Array:
    """Return the fraction of a transient that remains after a time, s."""
    there = lag > _NO_LAG
    return jnp.where(there, jnp.exp(-larger(elapsed, 0) / jnp.where(there, lag, 1)), 0)


def last_before(times: Float[Array, " knot"], time: Scalar) -> Array:
    """Return the index of the last of increasing times, shape (knot,), not after a time, or 0."""
    count = times.shape[0]
    if count <= _COMPARE_ALL:
        return jnp.maximum(jnp.sum(times <= time) - 1, 0)
    width = int(np.ceil(np.sqrt(count)))
    start = width * jnp.maximum(jnp.sum(times[::width] <= time) - 1, 0)
    start = jnp.minimum(start, count - width)  # the last slice overlaps the previous one
    within = jax.lax.dynamic_slice(times, (start,), (width,))
    return jnp.maximum(start + jnp.sum(within <= time) - 1, 0)


def constant(value: Any) -> Signal:
    """Return a constant signal of a value of shape (width,); its only knot is at 0 s."""
    value = jnp.atleast_1d(jnp.asarray(value, dtype=jnp.result_type(float)))
    return _signal(np.zeros(1), value[None], np.zeros((1, value.size)))


def steps(times: Any, values: Any) -> Signal:
    """Return a signal that takes each value at its time and holds it (zero-order hold).

    Rows that repeat the previous row are omitted.

    Arguments:
        times: times of the rows, strictly increasing, shape (row,), s.
        values: values of the rows, shape (row, width).
    """
    times, values = _rows(times, values)
    changes = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    return _signal(times[changes], values[changes], np.zeros_like(values[changes]))


def ramps(times: Any, values: Any, *, tolerance: float = 1e-5) -> Signal:
    """Return a signal that is linear between its rows and holds the last one.

    Rows on a straight line between their neighbours are merged, so a 10 Hz log of a single ramp has
    two corners rather than fifty.

    Arguments:
        times: times of the rows, strictly increasing, shape (row,), s.
        values: values of the rows, shape (row, width).
        tolerance: maximum deviation of a merged row from the line, as a fraction of the largest
            value; the default merges rows that were rounded to six digits.
    """
    times, values = _rows(times, values)
    kept = corner_rows(times, values, tolerance * max(np.abs(values).max(), 1e-300))
    times, values = times[kept], values[kept]
    slopes = np.zeros_like(values)
    slopes[:-1] = np.diff(values, axis=0) / np.diff(times)[:, None]
    return _signal(times, values, slopes, roughness(times, values))


def logged(times: Any, values: Any, interpolation: str = "linear") -> Signal:
    """Return a signal of logged rows: `zoh` holds each row until the next, `linear` connects them.

    Arguments:
        times: times of the rows, strictly increasing, shape (row,), s.
        values: values of the rows, shape (row, width).
        interpolation: "zoh" or "linear".

    Raises:
        InputError: the interpolation is unknown, or the times do not increase.
    """
    if interpolation == "zoh":
        return steps(times, values)
    if interpolation == "linear":
        return ramps(times, values)
    raise InputError(f"the interpolation {interpolation!r} is unknown: use 'zoh' or 'linear'")


def _signal(
    times: np.ndarray,
    values: np.ndarray | Array,
    slopes: np.ndarray,
    rough: np.ndarray | None = None,
) -> Signal:
    """Return a signal from arrays; each knot is a corner unless `rough` specifies otherwise."""
    rough = np.full(len(times), np.inf) if rough is None else rough
    parts = (times, values, slopes, rough)
    return Signal(*(jnp.asarray(x, dtype=jnp.result_type(float)) for x in parts))


def _rows(times: Any, values: Any) -> tuple[np.ndarray, np.ndarray]:
    times, values = np.asarray(times, dtype=float), np.asarray(values, dtype=float)
    if times.ndim != 1 or values.ndim != 2 or len(times) != len(values) or len(times) == 0:
        raise InputError(
            f"the times and values of a signal have shapes {times.shape} and {values.shape}: give "
            "them the shapes (row,) and (row, width)"
        )
    if not (np.all(np.isfinite(times)) and np.all(np.isfinite(values))):
        raise InputError(
            "the times or values of a signal are not finite: fill or drop the missing rows"
        )
    if np.any(np.diff(times) <= 0):
        raise InputError(
            "the times of a signal do not increase strictly: sort them and remove duplicates"
        )
    return times, values


# Pressures in the muscles of an arm over time, supplied by a run or by the controller.


class Pressures(eqx.Module):
    """Pressures supplied to the muscles of some joints over time.

    Arguments:
        signal: pressures, Pa, width = twice the number of joints of the arm: first all first
            muscles, then all second muscles. Values for other joints are ignored.
        joints: numbers of the joints with supplied pressures, from 1; the controller drives the
            other joints with muscles by their commands.
    """

    signal: Signal
    joints: tuple[int, ...] = eqx.field(static=True)

    def at(self, arm: Arm, time: Any, command: Float[Array, " joint"]) -> Float[Array, "2 joint"]:
        """Return the pressures at a time (s), Pa; `command` contains the commanded angles (rad)."""
        supplied = self.signal(time).reshape(2, arm.count)
        given, law = np.isin(np.arange(arm.count) + 1, self.joints), arm.further_laws.driven
        if law is None or set(self.joints) >= set(_with_muscles(arm)):
            return jnp.where(given, supplied, 0)
        return jnp.where(given, supplied, law.commanded(command))


def _with_muscles(arm: Arm) -> Sequence[int]:
    """Return the joints that pressures drive, by number; all joints with a user-defined law."""
    if arm.pneumatics is not None:
        return arm.pneumatics.joints
    return () if arm.further_laws.driven is None else range(1, arm.count + 1)


def check_muscles(arm: Arm, command: Signal, pressure: Pressures | None) -> None:
    """Reject angles (rad) and pressures (Pa) over time that are impossible for the muscles.

    While a program is traced, values are not checked.

    Raises:
        InputError: pressures are given for joints without muscles; a pressure is not a number
            between 0 and the limit of the muscles; a command exceeds 60 deg or the strength of the
            muscles; or the geometry is impossible or has a lever that jumps at 0.
    """
    known = _with_muscles(arm)
    driven = () if pressure is None else pressure.joints
    for joint in sorted(set(driven) - set(known)):
        raise InputError(
            f"joint {joint} is driven by pressures, but it has no muscles: specify which joints "
            'have muscles, for example muscles = "pitch" in [arm]'
        )
    if pressure is not None and pressure.signal.width != 2 * arm.count:
        raise InputError(
            f"the pressures have {pressure.signal.width} columns, but the arm has {arm.count} "
            "joints: give the columns of all first muscles, then those of all second muscles"
        )
    if arm.pneumatics is None:
        return
    if is_concrete(arm):
        check_geometry(arm.pneumatics.joint.geometry)
        inner, outer = (float(lever) for lever in _levers(arm.pneumatics))
        if abs(inner - outer) > 1e-9:
            raise InputError(
                f"the lever of a muscle jumps at 0 deg from {outer:.4g} to {inner:.4g} m: make "
                "geometry.anchor_y larger than geometry.contact_y, and make the wire long enough "
                "to be slack"
            )
    if pressure is not None and is_concrete((pressure, arm.pneumatics.muscle.pressure_limit)):
        columns = np.asarray(driven, dtype=int) - 1
        given = _reached(pressure.signal)[:, np.concatenate([columns, columns + arm.count])]
        limit = float(arm.pneumatics.muscle.pressure_limit)
        wrong = given[~((given >= 0) & (given <= limit * (1 + 1e-9)))]
        if wrong.size:
            raise InputError(
                f"a pressure of a muscle is {wrong[0]:g} Pa: give gauge pressures from 0 to "
                f"muscle.pressure_limit = {limit:g} Pa"
            )
    if is_concrete(command):
        by_angle = np.asarray(sorted(set(known) - set(driven)), dtype=int) - 1
        largest = np.max(np.abs(_reached(command)), axis=0)[by_angle]
        beyond = np.flatnonzero(largest > LARGEST_ANGLE * (1 + 1e-9))
        if beyond.size:
            worst = beyond[0]
            raise InputError(
                f"joint {by_angle[worst] + 1} is commanded to {np.rad2deg(largest[worst]):.4g} "
                "deg, but a pair of muscles bends it by at most 60 deg: command a smaller angle"
            )
        if is_concrete(arm) and by_angle.size:
            _check_strength(arm.pneumatics, _reached(command)[:, by_angle])


# Number of tested angles; it is fixed so that other commands do not require another program.
_ANGLES = 64


def _check_strength(pneumatics: Pneumatics, commanded: np.ndarray) -> None:
    """Reject commanded angles (rad) for which no pressure is high enough."""
    # If a muscle would have to push, the controller empties it, as in a straight joint that another
    # force bends.
    angles = np.unique(commanded)
    angles = angles[np.linspace(0, angles.size - 1, _ANGLES).round().astype(int)]
    asked = _asked(pneumatics, jnp.asarray(angles))
    for answer in (asked.first_pressure, asked.second_pressure):
        weak = np.flatnonzero(np.isin(np.asarray(answer.code), (NEEDS_PRESSURE, TOO_SHORT)))
        if weak.size:
            raise InputError(
                "no pressures can hold a joint at the commanded angle of "
                f"{np.rad2deg(angles[weak[0]]):.4g} deg, because {answer.message(int(weak[0]))}"
            )


@program
def _asked(pneumatics: Pneumatics, angles: Array) -> PairCommand:
    return pneumatics.asked(angles)


@program
def _levers(pneumatics: Pneumatics) -> Array:
    """Return the lever of a muscle at angle 0, as the inner and as the outer muscle, m."""
    angle, inner = jnp.zeros(2), jnp.asarray([True, False])
    return muscle_balance(pneumatics.joint.geometry, angle, jnp.ones(2), inner).lever


def _reached(signal: Signal) -> np.ndarray:
    """Return the values at both ends of each piece of a signal, shape (end, width)."""
    times, values, slopes = (np.asarray(x) for x in (signal.times, signal.values, signal.slopes))
    return np.concatenate([values, values[:-1] + slopes[:-1] * np.diff(times)[:, None]])
