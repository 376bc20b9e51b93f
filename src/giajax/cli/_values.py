"""The grammar of values on the command line: PATH=VALUE and KEY=VALUE, in every command alike.

A value is a number, or a number for each element, separated by commas: camera.origin=0.1,0,0.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from .._errors import InputError

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"

Values = dict[str, list[float]]


def number(text: str) -> float | None:
    """The finite number that a text says; None where it says no such number."""
    text = text.strip()
    if not re.fullmatch(NUMBER, text):
        return None
    return float(text) if math.isfinite(float(text)) else None


def settings(pairs: Sequence[str] | None, option: str = "--set") -> Values:
    """Values by path, from PATH=VALUE.

    Arguments:
        pairs: as they were typed.
        option: what they were typed after.

    Returns:
        One number, or one for each element, by path and in the order of typing.

    Raises:
        InputError: a pair that is no PATH=VALUE, or a path twice.
    """
    values: Values = {}
    for pair in pairs or []:
        path, _, text = pair.rpartition("=")
        path, numbers = path.strip(), [number(part) for part in text.split(",")]
        known = [value for value in numbers if value is not None]
        if not path or len(known) < len(numbers):
            raise InputError(
                f"{option} {pair!r} must be PATH=VALUE with a number, or with one for each "
                "element: write it like air.drag_coefficient=1.0 or camera.origin=0.1,0,0"
            )
        if path in values:
            raise InputError(f"{option} gives {path} twice: remove one")
        values[path] = known
    return values


def plain_settings(pairs: Sequence[str] | None, option: str) -> dict[str, float | list[float]]:
    """Values by path, from PATH=VALUE, as a file has them: one number by itself, several as a list.

    Raises:
        InputError: as `settings`.
    """
    values = settings(pairs, option)
    return {path: each[0] if len(each) == 1 else each for path, each in values.items()}


def with_settings(model: Any, values: Mapping[str, Sequence[float]]) -> Any:
    """The model with these parameters, switched on where they are left out.

    Raises:
        InputError: an unknown path, another number of values than elements, or a value beyond
            its bounds.
    """
    from ..parameters import (
        check_count,
        check_within_bounds,
        elements,
        find,
        replace,
        switched_on,
    )

    for path, numbers in values.items():
        model = switched_on(model, [path])
        check_count(model, path, numbers)
        if find(model, path).any_number:
            model = replace(model, {path: [float(value) for value in numbers]})
        parts = elements(model, path)
        each = [float(value) for value in numbers] * (len(parts) // len(numbers))
        for part, value in zip(parts, each, strict=True):
            check_within_bounds(part, value, free=False)
            model = replace(model, {part.path: value})
    return model


def noise_section(pairs: Sequence[str] | None, option: str) -> dict[str, float]:
    """Keys of `[noise]` with their standard deviations, from KEY=VALUE; in the unit of the key.

    Raises:
        InputError: a pair that is no KEY=VALUE, a key twice, or a negative number.
    """
    section: dict[str, float] = {}
    for pair in pairs or []:
        key, _, text = pair.partition("=")
        key, value = key.strip(), number(text)
        if not key or value is None:
            raise InputError(
                f"{option} {pair!r} must be KEY=VALUE with a number: write it like position_m=0.01"
            )
        if value < 0:
            raise InputError(f"{option} {pair!r} is negative: give 0 or a positive number")
        if key in section:
            raise InputError(f"{option} gives {key} twice: remove one")
        section[key] = value
    return section


def deviations(
    section: Mapping[str, float], option: str, channels: Sequence[str]
) -> dict[str, float]:
    """Standard deviations (SI) that keys of `[noise]` state, by channel.

    Raises:
        InputError: an unknown key, or one that is about none of the channels.
    """
    from ..runs import Channel, Definition, deviation_of

    def by_channel(part: Mapping[str, float]) -> dict[str, float]:
        noise = Definition.parse({"noise": dict(part)}, option).noise
        values = {name: deviation_of(noise, Channel.named(name)) for name in channels}
        return {name: value for name, value in values.items() if value is not None}

    for key in section:
        if not by_channel({key: 1.0}):
            raise InputError(
                f"{option} {key} is about none of the recorded channels: correct the key, or "
                "leave it out"
            )
    # A deviation of 0 is none, which [noise] does not state.
    return by_channel({key: value for key, value in section.items() if value > 0})


def velocity(text: str, option: str) -> list[float]:
    """Three numbers in m/s.

    Raises:
        InputError: it is written otherwise.
    """
    parts = [number(part) for part in text.split(",")]
    found = [part for part in parts if part is not None]
    if len(parts) != 3 or len(found) != 3:
        raise InputError(f"{option} is {text!r}: give three numbers in m/s, such as 0,0.2,0")
    return found
