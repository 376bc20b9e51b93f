"""State machine that turns the inputs of an operator into joint commands; it has no clock."""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Self

import numpy as np
from pydantic import ValidationError

from ...recordings import complaint
from ...runtime.arrays import Float
from ...runtime.files import parse_toml, read_text
from ...runtime.limits import TEXT_BYTES
from ...runtime.text import InputError
from ...schema import PadFile, PadSection

# Indices of a standard pad: the axes of the sticks, and the lower and the right button.
_LEFT_X, _LEFT_Y, _RIGHT_X, _RIGHT_Y = range(4)
_SOUTH, _EAST = 0, 1

# Rate of a joint at full deflection, rad/s. Three joints together turn the arm at 9 deg/s.
_RATE = float(np.deg2rad(3.0))

# Total angles of presets, rad, divided equally among the joints of a third of the arm.
_RAISED, _LOWERED, _ASIDE = (float(np.deg2rad(angle)) for angle in (30.0, 15.0, 30.0))


@dataclasses.dataclass(frozen=True)
class PadMapping:
    """Mapping from the axes and buttons of a game pad to the joints of an arm.

    Attributes:
        axes: index of each used axis -> rates of all joints at full deflection, rad/s,
            shape (joint,).
        presets: name of each preset -> angles, rad, shape (joint,); NaN for joints that keep their
            angle.
        buttons, stops: index of each button that selects a preset -> its name; indices of the
            buttons that stop all motion.
        dead_men: buttons of which one must be held for any motion; if empty, none is required.
        dead_zone, exponent: deflection below which a stick has no effect; exponent of the rate as a
            function of the deflection beyond it.
        largest_rate, largest_angle: largest rate and angle of the command of a joint, rad/s, rad.
        timeout: time without a message after which all motion stops, s.
        smoothing: time constant with which rates follow a stick, s.
    """

    axes: Mapping[int, Float[np.ndarray, " joint"]]
    presets: Mapping[str, Float[np.ndarray, " joint"]]
    buttons: Mapping[int, str]
    stops: frozenset[int] = frozenset()
    dead_men: frozenset[int] = frozenset()
    dead_zone: float = 0.12
    exponent: float = 2.0
    largest_rate: float = float(np.deg2rad(5.0))
    largest_angle: float = float(np.deg2rad(60.0))
    timeout: float = 0.5
    smoothing: float = 0.1

    @classmethod
    def usual(cls, joints: int) -> Self:
        """Return the default mapping of a standard pad.

        Odd joints of the arm pitch and even joints yaw. The left stick bends the third of the arm
        at its base, and the right stick the third at its tip. Each preset bends one of these
        thirds, and straightens all other joints. Of equal presets of a short arm, only the first
        is included.
        """
        third = max(joints // 3, 2)

        def turned(first: int, last: int, rate: float) -> Float[np.ndarray, " joint"]:
            row = np.zeros(joints)
            row[first:last:2] = rate
            return row

        start = joints - third + (joints - third) % 2
        axes = {
            _LEFT_Y: turned(0, third, -_RATE),
            _LEFT_X: turned(1, third, -_RATE),
            _RIGHT_Y: turned(start, joints, -_RATE),
            _RIGHT_X: turned(start + 1, joints, -_RATE),
        }
        presets = {
            "straight": np.zeros(joints),
            "raised": turned(0, third, _RAISED / len(range(0, third, 2))),
            "lowered": turned(0, third, -_LOWERED / len(range(0, third, 2))),
            "to the left": turned(1, third, _ASIDE / len(range(1, third, 2))),
            "to the right": turned(1, third, -_ASIDE / len(range(1, third, 2))),
            "tip up": turned(start, joints, _RAISED / max(len(range(start, joints, 2)), 1)),
        }
        # A short arm has no joint that yaws, or no third of its own at the tip.
        different = {angles.tobytes(): name for name, angles in reversed(presets.items())}
        presets = {name: row for name, row in presets.items() if name in different.values()}
        return cls(axes, presets, {_SOUTH: "straight"}, frozenset({_EAST}))

    @classmethod
    def load(cls, path: str | Path, joints: int) -> Self:
        """Load the mapping of a pad from a TOML file, for an arm with a number of joints.

        Raises:
            InputError: the file does not exist, or its content is not valid for the arm.
        """
        path = Path(path)
        try:
            text = read_text(path, TEXT_BYTES, "TOML", "a TOML file with a [pad] table")
            section = PadFile(**parse_toml(text, path)).pad
        except ValidationError as error:
            raise complaint(PadFile, error, str(path)) from None
        return cls.from_section(section, joints, str(path))

    @classmethod
    def from_section(cls, section: PadSection, joints: int, source: str) -> Self:
        """Return the mapping of a `[pad]` table; errors name the source."""
        axes: dict[int, np.ndarray] = {}
        for entry in section.axes or []:
            row = axes.setdefault(entry.axis, np.zeros(joints))
            places = _places(entry.joints, joints, f"axis {entry.axis}", source)
            row[places] += np.deg2rad(entry.rate_deg_per_s)
        if not axes:
            raise InputError(f"{source}: no axis of the pad moves a joint: add [[pad.axes]]")
        presets: dict[str, np.ndarray] = {}
        for preset in section.presets or []:
            if preset.name in presets:
                raise InputError(
                    f"{source}: two presets have the name '{preset.name}': rename one of them"
                )
            if len(preset.angles_deg) != len(preset.joints):
                raise InputError(
                    f"{source}: the preset '{preset.name}' has {len(preset.angles_deg)} angles for "
                    f"{len(preset.joints)} joints: give one angle for each joint"
                )
            others = np.nan if preset.others_deg is None else preset.others_deg
            row = np.full(joints, np.deg2rad(others))
            places = _places(preset.joints, joints, f"the preset '{preset.name}'", source)
            row[places] = np.deg2rad(preset.angles_deg)
            presets[preset.name] = row
        stated = section.buttons or []
        goes = [(each.button, each.preset) for each in stated if each.preset is not None]
        for button, name in goes:
            if name not in presets:
                raise InputError(
                    f"{source}: button {button} selects '{name}', which is not a preset: add it to "
                    "[[pad.presets]]"
                )
        return cls(
            axes,
            presets,
            dict(goes),
            frozenset(each.button for each in stated if each.stop),
            frozenset(each.button for each in stated if each.dead_man),
            section.dead_zone,
            section.exponent,
            float(np.deg2rad(section.largest_rate_deg_per_s)),
            float(np.deg2rad(section.largest_angle_deg)),
            section.timeout_s,
            section.smoothing_s,
        )

    def rates(self, deflections: Mapping[int, float], joints: int) -> Float[np.ndarray, " joint"]:
        """Return the rates of the joints, rad/s, for deflections of the axes, from -1 to 1."""
        rates = np.zeros(joints)
        for axis, row in self.axes.items():
            rates += row * shaped(deflections.get(axis, 0.0), self.dead_zone, self.exponent)
        return np.clip(rates, -self.largest_rate, self.largest_rate)


def shaped(deflection: float, dead_zone: float, exponent: float) -> float:
    """Return the effect of a deflection: 0 in the dead zone, continuous at its edge, 1 at most."""
    if not np.isfinite(deflection):
        return 0.0
    size = (min(abs(deflection), 1.0) - dead_zone) / (1 - dead_zone)
    return float(np.sign(deflection) * max(size, 0.0) ** exponent)


def _places(numbers: list[int], joints: int, who: str, source: str) -> list[int]:
    for number in numbers:
        if number > joints:
            raise InputError(
                f"{source}: {who} refers to joint {number}, but the arm has only {joints} joints: "
                "correct the number"
            )
    return [number - 1 for number in numbers]


_PRESSED = 0.5  # value above which a button counts as pressed
NOT_YET = "no command has been given yet"
STOPPED = "stopped by the operator"
SILENT = "no message from the page: its tab was closed, or the connection is lost"
NO_PAD = "the pad is disconnected"
LET_GO = "the dead man's switch is not pressed"


class Operator:
    """Operator input, from which the joint commands follow; only the latest input counts.

    A stick sets rates. A slider or a preset sets a target, which is approached at most at the
    largest rate. If no message arrives before the timeout, or the pad is disconnected, the rates
    become 0, the targets are discarded, and the command stays constant until the next input.
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

    def restarted(self) -> "Operator":
        """Return an operator at the start of another drive; held buttons are not pressed again."""
        new = Operator(self.mapping, self.joints)
        new._pressed, new._pad_here, new._heard = self._pressed, self._pad_here, self._heard
        return new

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """Handle one message from the page.

        Arguments:
            message: `{"type": "pad", "axes": [...], "buttons": [...]}` while a pad is connected,
                `{"type": "no_pad"}` after it is disconnected,
                `{"type": "joint", "joint": 3, "deg": 10}`, `{"type": "preset", "name": ...}`,
                `{"type": "stop"}`, or `{"type": "alive"}`.
            now: time of arrival, s.

        Raises:
            InputError: the message has another type or invalid values; the drive can continue.
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
            raise InputError(f"a message from the page has the unknown type {kind!r}")
        self._heard = now

    def advance(self, now: float, elapsed: float) -> Float[np.ndarray, " joint"]:
        """Return the command at time `now`, s, after a step of `elapsed`, s; in rad."""
        # Before the first command nothing moves, and a page may take long to load.
        silent = self._heard is not None and now - self._heard > self.mapping.timeout
        if silent and self.stopped is None:
            self._stop(SILENT)
        most, smoothing = self.mapping.largest_rate * elapsed, self.mapping.smoothing
        # Rates follow the sticks with a lag, but stop immediately.
        share = -np.expm1(-elapsed / smoothing) if smoothing > 0 else 1.0
        self._rates = self._rates + share * (self._wanted - self._rates)
        if self.stopped is not None:
            self._rates[:] = 0
        change = self._rates * elapsed
        aimed = np.isfinite(self._target)
        change[aimed] += (self._target - self.command)[aimed]
        limit = self.mapping.largest_angle
        # A joint that is already beyond the limit can only move back.
        low, high = np.minimum(self.command, -limit), np.maximum(self.command, limit)
        self.command = np.clip(self.command + np.clip(change, -most, most), low, high)
        self._target[aimed & (self._target == self.command)] = np.nan
        return self.command

    def _pad(self, axes: Sequence[float], buttons: Sequence[float]) -> None:
        """Handle the current state of the pad."""
        if not axes:
            raise InputError("the pad has no axes: connect a pad with sticks")
        held = frozenset(i for i, value in enumerate(buttons) if value > _PRESSED)
        fresh, self._pressed = held - self._pressed, held
        self._pad_here = True
        if self.mapping.dead_men and not held & self.mapping.dead_men:
            moving = np.any(self._wanted) or np.any(np.isfinite(self._target))
            tried = self.mapping.rates(dict(enumerate(axes)), self.joints)
            if moving or (self.stopped == NOT_YET and np.any(tried)):
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
            raise InputError(
                f"a slider refers to joint {joint!r}, but the arm has only {self.joints} joints"
            )
        if not (isinstance(angle, int | float) and np.isfinite(angle)):
            raise InputError(f"a slider is set to {angle!r} deg, which is not a valid angle")
        self._aim(joint - 1, np.deg2rad(angle))

    def _go(self, name: str) -> None:
        if name not in self.mapping.presets:
            raise InputError(f"the preset '{name}' does not exist")
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
        # Keep the first reason, because it is the cause.
        if self.stopped in (None, NOT_YET):
            self.stopped = why


def _numbers(message: Mapping[str, Any], name: str) -> list[float]:
    values = message.get(name)
    if not isinstance(values, list) or not all(isinstance(v, int | float) for v in values):
        raise InputError(f"a message from the pad has no list of numbers '{name}'")
    return [float(value) for value in values]
