"""Inputs over time: commands of the joints, the velocity of the wind, pressures in muscles.

Both are piecewise linear, with jumps allowed at the knots, so one class serves steps, ramps and
logged rows. The step-size controller must not step over those knots that are corners.
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

_PARTS = 4  # parts of a piece whose ends are compared with the cubic
_ROUGH = 0.1  # beyond this, as a fraction of the largest value, no tolerance has use for a stretch


def corner_rows(times: np.ndarray, values: np.ndarray, allowed: float) -> np.ndarray:
    """Rows that remain when those on a straight line between their neighbours are merged.

    From each kept row the band of slopes that pass within `allowed` (in the unit of the values) of
    every row seen so far narrows until it is empty; the row before that is the next corner.
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
    """How far a signal is from a cubic around each knot, as a fraction of its largest value.

    Stretches of 2, 4, 8, ... pieces are compared with the cubic that fits each best. A knot inside
    of one is as rough as the smallest stretch that has it in the middle, or any stretch within
    that. What two knots that are rougher than a tolerance enclose is therefore a cubic to within
    the tolerance, and hides nothing from a step, however long. Where no stretch has the knot in its
    middle, as at both ends, it is infinite.
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
    """Largest distances of stretches of some pieces from their cubics, shape (count,)."""
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


# To compare with every knot takes a few vector instructions; of more than this, some are compared
# first. By a binary search, derivatives of a simulation take a fifth longer.
_COMPARE_ALL = 512

# In relative tolerances, how rough a knot may be that steps cross: an arm follows it so little
# that with 20 the motion of the paper's is as exact as with 3, in up to a third fewer steps (and as
# with 10, in up to a seventh fewer).
_CROSSED = 20.0


class Signal(eqx.Module):
    """Piecewise linear function of time with values of a fixed width.

    From knot i on, until the next knot, the value is `values[i] + slopes[i] * (t - times[i])`;
    before the first knot it is `values[0]`.

    Derivatives of a simulation by `times` are right where the signal does not jump. By when a jump
    comes they are incomplete, and no error: those of `steps` and of `zoh` rows are 0.

    Arguments:
        times: of the knots, increasing, s, shape (knot,).
        values: just after each knot, shape (knot, width).
        slopes: after each knot, per second, shape (knot, width).
        roughness: how far the signal is from a cubic around each knot, as a fraction of its
            largest value, shape (knot,); infinite where it jumps.
    """

    times: Float[Array, " knot"]
    values: Float[Array, "knot width"]
    slopes: Float[Array, "knot width"]
    roughness: Float[Array, " knot"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Value at a time (s)."""
        knot = last_before(self.times, time)
        elapsed = larger(time - self.times[knot], 0)
        return self.values[knot] + self.slopes[knot] * elapsed

    def rate(self, time: Scalar) -> Float[Array, " width"]:
        """Rate of change at a time (s), jumps apart; 0 before the first knot."""
        return jnp.where(time >= self.times[0], self.slopes[last_before(self.times, time)], 0)

    def corners(self, tolerance: Scalar) -> tuple[Float[Array, " knot"], Float[Array, " knot"]]:
        """Times (s) of the knots that no step of a relative tolerance may cross, and of the others.

        Each is infinite where a knot is one of the other.
        """
        corner = self.roughness > _CROSSED * tolerance
        return jnp.where(corner, self.times, jnp.inf), jnp.where(corner, jnp.inf, self.times)

    @property
    def jumps(self) -> Bool[Array, ""]:
        """Whether the signal jumps at one of its knots, by more than rounding."""
        before = self.values[:-1] + self.slopes[:-1] * jnp.diff(self.times)[:, None]
        size = jnp.max(jnp.abs(self.values), initial=0.0)
        return jnp.any(jnp.abs(self.values[1:] - before) > 1e-6 * size)

    @property
    def width(self) -> int:
        """Number of values at one time."""
        return self.values.shape[1]


# A lag below this (s) is none: no motion shows it, and quotients by it stay finite.
_NO_LAG = 1e-12


class LaggedSignal(eqx.Module):
    """What follows a signal u with a lag of first order, lag dy/dt = u - y, from rest; exactly.

    After knot k, where u has the slope s, it is u - lag s + c exp(-(t - t_k) / lag). A lag of 0 has
    the derivative from above, -s; as those of `Signal` by when it jumps, it is incomplete by that
    of jumps.

    Arguments:
        signal: u.
        lag: of each value, s, shape (width,).
        transients: the numbers c of each knot, shape (knot, width).
    """

    signal: Signal
    lag: Float[Array, " width"]
    transients: Float[Array, "knot width"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Value at a time (s)."""
        times = self.signal.times
        knot = last_before(times, time)
        left = self.transients[knot] * _left_over(time - times[knot], self.lag)
        behind = self.lag * self.signal.slopes[knot] - left
        return self.signal(time) - jnp.where(time >= times[0], behind, 0)


class SaturatedSignal(eqx.Module):
    """What drives reach of a signal u that they follow: u / sqrt(1 + saturation u^2).

    Arguments:
        signal: u, rad.
        saturation: one over the square of the angle that is never passed, 1/rad^2, one or one for
            each value.
    """

    signal: Signal | LaggedSignal
    saturation: Float[Array, ""] | Float[Array, " width"]

    def __call__(self, time: Scalar) -> Float[Array, " width"]:
        """Value at a time (s)."""
        angle = self.signal(time)
        return angle / jnp.sqrt(1 + self.saturation * angle**2)


Followed = Signal | LaggedSignal | SaturatedSignal
"""What the springs of an arm pull towards, over time."""


def followed(signal: Signal, joints: Joints) -> Followed:
    """What the drives of joints make of a command: it has their gain, then lags, then saturates."""
    if joints.drive_gain is not None:
        gain = jnp.broadcast_to(joints.drive_gain, (signal.width,))[None]
        signal = dataclasses.replace(
            signal, values=signal.values * gain, slopes=signal.slopes * gain
        )
    reached = lagged(signal, joints.drive_lag)
    saturation = joints.drive_saturation
    return reached if saturation is None else SaturatedSignal(reached, saturation)


def lagged(signal: Signal, lag: Array | None) -> Signal | LaggedSignal:
    """What follows a signal with a lag (s), one or one for each value; without (None) itself."""
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
    """What is left of a transient after a time, s."""
    there = lag > _NO_LAG
    return jnp.where(there, jnp.exp(-larger(elapsed, 0) / jnp.where(there, lag, 1)), 0)


def last_before(times: Float[Array, " knot"], time: Scalar) -> Array:
    """Index of the last of increasing times, shape (knot,), not after a time; 0 if all are."""
    count = times.shape[0]
    if count <= _COMPARE_ALL:
        return jnp.maximum(jnp.sum(times <= time) - 1, 0)
    width = int(np.ceil(np.sqrt(count)))
    start = width * jnp.maximum(jnp.sum(times[::width] <= time) - 1, 0)
    start = jnp.minimum(start, count - width)  # the last slice overlaps the one before
    within = jax.lax.dynamic_slice(times, (start,), (width,))
    return jnp.maximum(start + jnp.sum(within <= time) - 1, 0)


def constant(value: Any) -> Signal:
    """A signal that never changes, of a value of shape (width,); its one knot is at 0 s."""
    value = jnp.atleast_1d(jnp.asarray(value, dtype=jnp.result_type(float)))
    return _signal(np.zeros(1), value[None], np.zeros((1, value.size)))


def steps(times: Any, values: Any) -> Signal:
    """A signal that takes each value at its time and holds it (zero-order hold).

    Rows that repeat the one before are left out.

    Arguments:
        times: strictly increasing, shape (row,), s.
        values: shape (row, width).
    """
    times, values = _rows(times, values)
    changes = np.concatenate([[True], np.any(values[1:] != values[:-1], axis=1)])
    return _signal(times[changes], values[changes], np.zeros_like(values[changes]))


def ramps(times: Any, values: Any, *, tolerance: float = 1e-5) -> Signal:
    """A signal that is linear between its rows and holds the last one.

    Rows that lie on a straight line between their neighbours are merged, so that a log at
    10 Hz of one ramp leaves two corners, not fifty.

    Arguments:
        times: strictly increasing, shape (row,), s.
        values: shape (row, width).
        tolerance: how far a merged row may lie off the line, as a fraction of the largest value;
            the default merges rows that were rounded to six digits.
    """
    times, values = _rows(times, values)
    kept = corner_rows(times, values, tolerance * max(np.abs(values).max(), 1e-300))
    times, values = times[kept], values[kept]
    slopes = np.zeros_like(values)
    slopes[:-1] = np.diff(values, axis=0) / np.diff(times)[:, None]
    return _signal(times, values, slopes, roughness(times, values))


def logged(times: Any, values: Any, interpolation: str = "linear") -> Signal:
    """A signal through logged rows: `zoh` holds each row until the next, `linear` joins them.

    Arguments:
        times: strictly increasing, shape (row,), s.
        values: shape (row, width).
        interpolation: "zoh" or "linear".

    Raises:
        InputError: another interpolation, or times that do not increase.
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
    """A signal of arrays; each knot is a corner unless `rough` says otherwise."""
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


# Pressures in the muscles of an arm over time: supplied by a run, or by the controller.


class Pressures(eqx.Module):
    """Supplied pressures of the muscles of some joints over time.

    Arguments:
        signal: Pa, width = twice the number of joints of the arm: the pressures of all first
            muscles, and then of all second ones. What is of other joints counts for nothing.
        joints: numbers of the joints that are driven so, from 1 on; the controller drives the
            other joints with muscles, by their commands.
    """

    signal: Signal
    joints: tuple[int, ...] = eqx.field(static=True)

    def at(self, arm: Arm, time: Any, command: Float[Array, " joint"]) -> Float[Array, "2 joint"]:
        """Pressures at a time (s), Pa, where the controller is commanded to angles (rad)."""
        supplied = self.signal(time).reshape(2, arm.count)
        given, law = np.isin(np.arange(arm.count) + 1, self.joints), arm.further_laws.driven
        if law is None or set(self.joints) >= set(_with_muscles(arm)):
            return jnp.where(given, supplied, 0)
        return jnp.where(given, supplied, law.commanded(command))


def _with_muscles(arm: Arm) -> Sequence[int]:
    """Numbers of the joints that pressures drive: all of them, where a law of one's own does."""
    if arm.pneumatics is not None:
        return arm.pneumatics.joints
    return () if arm.further_laws.driven is None else range(1, arm.count + 1)


def check_muscles(arm: Arm, command: Signal, pressure: Pressures | None) -> None:
    """Refuse what muscles cannot do with angles (rad) and pressures (Pa) over time.

    While a program is traced no number is checked.

    Raises:
        InputError: pressures for joints without muscles, pressures that are not numbers from 0 to
            the limit of the muscles, a command beyond 60 deg or for which they are too weak, an
            impossible geometry, or one whose lever jumps at 0.
    """
    known = _with_muscles(arm)
    driven = () if pressure is None else pressure.joints
    for joint in sorted(set(driven) - set(known)):
        raise InputError(
            f"joint {joint} is driven by pressures, but it has no muscles: state which joints "
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
                f"a pressure of a muscle is {wrong[0]:g} Pa: give gauge pressures from 0 to"
                f" muscle.pressure_limit = {limit:g} Pa"
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


_ANGLES = 64  # so many angles at most, so that other commands need no other program


def _check_strength(pneumatics: Pneumatics, commanded: np.ndarray) -> None:
    """Refuse commanded angles (rad) for which no pressure is high enough."""
    # Where a muscle would have to push, the controller empties it, as it does in a straight joint
    # that something else bends.
    angles = np.unique(commanded)
    angles = angles[np.linspace(0, angles.size - 1, _ANGLES).round().astype(int)]
    asked = _asked(pneumatics, jnp.asarray(angles))
    for answer in (asked.first_pressure, asked.second_pressure):
        weak = np.flatnonzero(np.isin(np.asarray(answer.code), (NEEDS_PRESSURE, TOO_SHORT)))
        if weak.size:
            raise InputError(
                f"no pressures can hold a joint at the commanded angle of "
                f"{np.rad2deg(angles[weak[0]]):.4g} deg:"
                f" {answer.message(int(weak[0]))}"
            )


@program
def _asked(pneumatics: Pneumatics, angles: Array) -> PairCommand:
    return pneumatics.asked(angles)


@program
def _levers(pneumatics: Pneumatics) -> Array:
    """Of a muscle at 0, as the inner and the outer one, m."""
    angle, inner = jnp.zeros(2), jnp.asarray([True, False])
    return muscle_balance(pneumatics.joint.geometry, angle, jnp.ones(2), inner).lever


def _reached(signal: Signal) -> np.ndarray:
    """Values at both ends of each piece of a signal, shape (end, width)."""
    times, values, slopes = (np.asarray(x) for x in (signal.times, signal.values, signal.slopes))
    return np.concatenate([values, values[:-1] + slopes[:-1] * np.diff(times)[:, None]])
