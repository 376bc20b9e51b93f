"""Pressures in the muscles of an arm over time: supplied by a run, or by the controller."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import Arm, Pneumatics
from ..mechanics.joint import (
    LARGEST_ANGLE,
    NEEDS_PRESSURE,
    TOO_SHORT,
    PairCommand,
    check_geometry,
    muscle_balance,
)
from ..runtime.arrays import Array, Float
from ..runtime.programs import program
from ..runtime.text import InputError
from ..schema.parameters import is_concrete
from ._signal import Signal


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
        assert arm.pneumatics is not None
        given = np.isin(np.arange(arm.count) + 1, self.joints)
        if set(self.joints) >= set(arm.pneumatics.joints):
            return jnp.where(given, supplied, 0)
        return jnp.where(given, supplied, arm.pneumatics.commanded(command))


def check_muscles(arm: Arm, command: Signal, pressure: Pressures | None) -> None:
    """Refuse what muscles cannot do with angles (rad) and pressures (Pa) over time.

    While a program is traced no number is checked.

    Raises:
        InputError: pressures for joints without muscles, pressures that are no numbers from 0 to
            the limit of the muscles, a command beyond 60 deg or for which they are too weak, an
            impossible geometry, or one whose lever jumps at 0.
    """
    known = () if arm.pneumatics is None else arm.pneumatics.joints
    driven = () if pressure is None else pressure.joints
    for joint in sorted(set(driven) - set(known)):
        raise InputError(
            f"joint {joint} is driven by pressures, but it has no muscles: say which joints have "
            'some, as with muscles = "pitch" in [arm]'
        )
    if pressure is not None and pressure.signal.width != 2 * arm.count:
        raise InputError(
            f"the pressures have {pressure.signal.width} columns and the arm has {arm.count} "
            "joints: give those of all first muscles, and then of all second ones"
        )
    if arm.pneumatics is None:
        return
    if is_concrete(arm):
        check_geometry(arm.pneumatics.joint.geometry)
        inner, outer = (float(lever) for lever in _levers(arm.pneumatics))
        if abs(inner - outer) > 1e-9:
            raise InputError(
                f"the lever of a muscle jumps at 0 deg from {outer:.4g} to {inner:.4g} m: make "
                "geometry.anchor_y larger than geometry.contact_y, and the wire long enough to be "
                "slack"
            )
    if pressure is not None and is_concrete((pressure, arm.pneumatics.muscle.pressure_limit)):
        columns = np.asarray(driven, dtype=int) - 1
        given = _reached(pressure.signal)[:, np.concatenate([columns, columns + arm.count])]
        limit = float(arm.pneumatics.muscle.pressure_limit)
        wrong = given[~((given >= 0) & (given <= limit * (1 + 1e-9)))]
        if wrong.size:
            raise InputError(
                f"a pressure of a muscle is {wrong[0]:g} Pa: give pressures above the "
                f"surroundings, from 0 to muscle.pressure_limit = {limit:g} Pa"
            )
    if is_concrete(command):
        by_angle = np.asarray(sorted(set(known) - set(driven)), dtype=int) - 1
        largest = np.max(np.abs(_reached(command)), axis=0)[by_angle]
        beyond = np.flatnonzero(largest > LARGEST_ANGLE * (1 + 1e-9))
        if beyond.size:
            worst = beyond[0]
            raise InputError(
                f"joint {by_angle[worst] + 1} is commanded to {np.rad2deg(largest[worst]):.4g} "
                "deg, and a pair of muscles bends it by 60 deg at most: command a smaller angle"
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
                f"no pressures hold a joint at {np.rad2deg(angles[weak[0]]):.4g} deg, as it is "
                f"commanded to: {answer.message(int(weak[0]))}"
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
