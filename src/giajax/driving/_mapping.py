"""What a game pad does: sticks turn joints, buttons go to presets."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import ValidationError

from .._errors import InputError
from .._files import read_bytes
from .._limits import TEXT_BYTES
from .._syntax import parse_toml
from .._typing import Float
from ..kinds import PadFile, PadSection
from ..runs import complaint

# Of a standard pad: the sticks, and the two buttons below and to the right.
_LEFT_X, _LEFT_Y, _RIGHT_X, _RIGHT_Y = range(4)
_SOUTH, _EAST = 0, 1

# At full deflection, rad/s: three joints together turn the arm by 9 deg in a second.
_RATE = float(np.deg2rad(3.0))


@dataclasses.dataclass(frozen=True)
class PadMapping:
    """What a game pad does with the joints of an arm.

    Attributes:
        axes: of each stick that does something: the rates of all joints at full deflection,
            rad/s, shape (joint,).
        presets: angles by name, rad, shape (joint,); NaN for joints that stay where they are.
        buttons: the preset that a button goes to.
        stops: buttons that stop everything.
        dead_men: buttons of which one must be held for anything to move; none: nothing must.
        dead_zone: deflection below which a stick is at rest.
        exponent: of the rate over the deflection.
        largest_rate: of any joint's command, rad/s.
        largest_angle: of any joint's command, rad.
        timeout: without a word for so long everything stops, s.
        smoothing: time in which rates follow a stick, s.
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
        """Of an arm whose odd joints pitch and whose even joints yaw, on a standard pad.

        The left stick bends the third of the arm at its base, the right one the third at its tip.
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
        straight = {"straight": np.zeros(joints)}
        return cls(axes, straight, {_SOUTH: "straight"}, frozenset({_EAST}))

    @classmethod
    def load(cls, path: str | Path, joints: int) -> Self:
        """What a TOML file says of a pad, for an arm of so many joints.

        Raises:
            InputError: there is no such file, or it says something that cannot be done.
        """
        path = Path(path)
        try:
            table = parse_toml(read_bytes(path, TEXT_BYTES).decode(), path)
            section = PadFile(**table).pad
        except FileNotFoundError:
            raise InputError(f"{path} does not exist: give a TOML file with a [pad]") from None
        except UnicodeDecodeError:
            raise InputError(f"{path} is not text: give a TOML file with a [pad]") from None
        except ValidationError as error:
            raise complaint(PadFile, error, str(path)) from None
        return cls.from_section(section, joints, str(path))

    @classmethod
    def from_section(cls, section: PadSection, joints: int, source: str) -> Self:
        """What a `[pad]` says.

        Arguments:
            section: the section.
            joints: number of joints of the arm.
            source: what has the section, for errors.

        Raises:
            InputError: a joint that the arm does not have, or something that is said twice.
        """
        axes: dict[int, np.ndarray] = {}
        for entry in section.axes or []:
            row = axes.setdefault(entry.axis, np.zeros(joints))
            places = _places(entry.joints, joints, f"axis {entry.axis}", source)
            row[places] += np.deg2rad(entry.rate_deg_per_s)
        if not axes:
            raise InputError(f"{source}: no axis turns a joint: add [[pad.axes]]")
        presets: dict[str, np.ndarray] = {}
        for preset in section.presets or []:
            if preset.name in presets:
                raise InputError(f"{source}: there are two presets '{preset.name}': rename one")
            if len(preset.angles_deg) != len(preset.joints):
                raise InputError(
                    f"{source}: the preset '{preset.name}' has {len(preset.angles_deg)} angles for "
                    f"{len(preset.joints)} joints: give as many"
                )
            others = np.nan if preset.others_deg is None else preset.others_deg
            row = np.full(joints, np.deg2rad(others))
            places = _places(preset.joints, joints, f"the preset '{preset.name}'", source)
            row[places] = np.deg2rad(preset.angles_deg)
            presets[preset.name] = row
        buttons, stops, dead_men = {}, set(), set()
        for button in section.buttons or []:
            if button.preset is not None:
                if button.preset not in presets:
                    raise InputError(
                        f"{source}: button {button.button} goes to '{button.preset}', which is no "
                        f"preset: add it to [[pad.presets]]"
                    )
                buttons[button.button] = button.preset
            if button.stop:
                stops.add(button.button)
            if button.dead_man:
                dead_men.add(button.button)
        return cls(
            axes,
            presets,
            buttons,
            frozenset(stops),
            frozenset(dead_men),
            section.dead_zone,
            section.exponent,
            float(np.deg2rad(section.largest_rate_deg_per_s)),
            float(np.deg2rad(section.largest_angle_deg)),
            section.timeout_s,
            section.smoothing_s,
        )

    def rates(self, deflections: Mapping[int, float], joints: int) -> Float[np.ndarray, " joint"]:
        """Rates of the joints (rad/s) at deflections of the sticks, each from -1 to 1."""
        rates = np.zeros(joints)
        for axis, row in self.axes.items():
            rates += row * shaped(deflections.get(axis, 0.0), self.dead_zone, self.exponent)
        return np.clip(rates, -self.largest_rate, self.largest_rate)


def shaped(deflection: float, dead_zone: float, exponent: float) -> float:
    """What a stick means: 0 within its dead zone, continuous at its edge, and 1 at its end."""
    if not np.isfinite(deflection):
        return 0.0
    size = (min(abs(deflection), 1.0) - dead_zone) / (1 - dead_zone)
    return float(np.sign(deflection) * max(size, 0.0) ** exponent)


def _places(numbers: list[int], joints: int, who: str, source: str) -> list[int]:
    for number in numbers:
        if number > joints:
            raise InputError(
                f"{source}: {who} is of joint {number}, and the arm has {joints}: correct it"
            )
    return [number - 1 for number in numbers]
