"""From what an operator does to what joints are commanded: a state machine without a clock."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from .._typing import Float
from ._mapping import PadMapping

# A button counts as pressed from here on.
_PRESSED = 0.5

NOT_YET = "nobody has moved anything yet"
STOPPED = "stopped by the operator"
SILENT = "no word from the page: the tab or its connection is gone"
NO_PAD = "the pad is gone"
LET_GO = "the dead man's button is not held"


class Operator:
    """Takes what comes from a page, the latest only, and says what joints are commanded.

    A stick sets rates, a slider or a preset a target that is approached no faster than the largest
    rate. Where nothing is heard for a while, or the pad is gone, rates become 0, targets are given
    up, and the command stays where it is, until something is moved again.

    Arguments:
        mapping: what the pad does.
        joints: number of joints.
    """

    def __init__(self, mapping: PadMapping, joints: int) -> None:
        self.mapping = mapping
        self.joints = joints
        self.command: Float[np.ndarray, " joint"] = np.zeros(joints)
        self.stopped: str | None = NOT_YET
        self._target = np.full(joints, np.nan)
        self._wanted = np.zeros(joints)
        self._rates = np.zeros(joints)
        self._heard: float | None = None
        self._pad_here = False
        self._pressed: frozenset[int] = frozenset()

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """One message of the page.

        Arguments:
            message: `{"type": "pad", "axes": [...], "buttons": [...]}` of a pad that is there,
                `{"type": "no_pad"}` once it is gone, `{"type": "joint", "joint": 3, "deg": 10}`,
                `{"type": "preset", "name": ...}`, `{"type": "stop"}`, or `{"type": "alive"}`.
            now: time, s.

        Raises:
            InputError: a message that says nothing of this kind.
        """
        kind = message.get("type")
        if kind == "pad":
            self._pad(_numbers(message, "axes"), _numbers(message, "buttons"))
        elif kind == "no_pad":
            if self._pad_here:
                self._stop(NO_PAD)
            self._pad_here = False
        elif kind == "joint":
            self._slider(message)
        elif kind == "preset":
            self._go(str(message.get("name")))
        elif kind == "stop":
            self._stop(STOPPED)
        elif kind != "alive":
            raise InputError(f"a message of the page is of the kind {kind!r}, which is none")
        self._heard = now

    def advance(self, now: float, elapsed: float) -> Float[np.ndarray, " joint"]:
        """The command an interval later, rad, shape (joint,).

        Arguments:
            now: time at its end, s.
            elapsed: its length, s.
        """
        if self._heard is not None and now - self._heard > self.mapping.timeout:
            self._stop(SILENT)
        largest = self.mapping.largest_rate
        # What follows with a lag; where everything stops it stops at once.
        share = 1.0
        if self.mapping.smoothing > 0:
            share = -np.expm1(-elapsed / self.mapping.smoothing)
        self._rates = self._rates + share * (self._wanted - self._rates)
        if self.stopped is not None:
            self._rates[:] = 0
        change = self._rates * elapsed
        aimed = np.isfinite(self._target)
        change[aimed] += (self._target - self.command)[aimed]
        change = np.clip(change, -largest * elapsed, largest * elapsed)
        limit = self.mapping.largest_angle
        # A joint that is beyond the limit already may come back.
        low, high = np.minimum(self.command, -limit), np.maximum(self.command, limit)
        self.command = np.clip(self.command + change, low, high)
        self._target[aimed & (self._target == self.command)] = np.nan
        return self.command

    def _pad(self, axes: Sequence[float], buttons: Sequence[float]) -> None:
        """What the pad is like now; a pad that has just come is not moved yet."""
        if not axes:
            raise InputError("the pad has no axes, and turns nothing: connect one with sticks")
        held = frozenset(i for i, value in enumerate(buttons) if value > _PRESSED)
        fresh, self._pressed = held - self._pressed, held
        self._pad_here = True
        dead_men = self.mapping.dead_men
        if dead_men and not held & dead_men:
            if np.any(self._wanted) or np.any(np.isfinite(self._target)):
                self._stop(LET_GO)
            return
        if fresh & self.mapping.stops:
            self._stop(STOPPED)
            return
        self._wanted = self.mapping.rates(dict(enumerate(axes)), self.joints)
        moved = self._wanted != 0
        if np.any(moved):
            # A stick takes over from a slider or a preset.
            self._target[moved] = np.nan
            self.stopped = None
        for button in sorted(fresh):
            if button in self.mapping.buttons:
                self._go(self.mapping.buttons[button])

    def _slider(self, message: Mapping[str, Any]) -> None:
        joint, angle = message.get("joint"), message.get("deg")
        if not (isinstance(joint, int) and 1 <= joint <= self.joints):
            raise InputError(f"a slider is of joint {joint!r}, and the arm has {self.joints}")
        if not (isinstance(angle, int | float) and np.isfinite(angle)):
            raise InputError(f"a slider is at {angle!r} deg, which is no angle")
        self._aim(joint - 1, np.deg2rad(angle))

    def _go(self, name: str) -> None:
        if name not in self.mapping.presets:
            raise InputError(f"there is no preset '{name}'")
        for place, angle in enumerate(self.mapping.presets[name]):
            if np.isfinite(angle):
                self._aim(place, angle)

    def _aim(self, place: int, angle: float) -> None:
        limit = self.mapping.largest_angle
        self._target[place] = np.clip(angle, -limit, limit)
        self.stopped = None

    def _stop(self, why: str) -> None:
        self._wanted = np.zeros(self.joints)
        self._target[:] = np.nan
        # The first reason is the cause.
        if self.stopped is None:
            self.stopped = why


def _numbers(message: Mapping[str, Any], name: str) -> list[float]:
    values = message.get(name)
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        raise InputError(f"a message of the pad has no list of numbers '{name}'")
    return [float(value) for value in values]
