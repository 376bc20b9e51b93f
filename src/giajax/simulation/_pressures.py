"""Pressures in the muscles of an arm over time: supplied by a run, or by the controller."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..arm import Arm
from ..joint import LARGEST_ANGLE, check_geometry
from ..parameters import is_concrete
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
        if set(self.joints) >= set(arm.pneumatics.joints):
            return supplied
        given = np.isin(np.arange(arm.count) + 1, self.joints)
        return jnp.where(given, supplied, arm.pneumatics.commanded(command))


def check_muscles(arm: Arm, command: Signal, pressure: Pressures | None) -> None:
    """Refuse what muscles cannot do.

    Arguments:
        arm: the arm.
        command: commanded angles over time, rad.
        pressure: supplied pressures over time, Pa. While a program is traced no number is checked.

    Raises:
        InputError: pressures for joints without muscles, pressures below 0, a command beyond 60
            deg, or an impossible geometry.
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
    if pressure is not None and is_concrete(pressure):
        lowest = float(np.min(_reached(pressure.signal)))
        if lowest < 0:
            raise InputError(
                f"a pressure of a muscle is {lowest:g} Pa: give pressures above the surroundings, "
                "0 or more"
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


def _reached(signal: Signal) -> np.ndarray:
    """Values at both ends of each piece of a signal, shape (end, width)."""
    times, values, slopes = (np.asarray(x) for x in (signal.times, signal.values, signal.slopes))
    return np.concatenate([values, values[:-1] + slopes[:-1] * np.diff(times)[:, None]])
