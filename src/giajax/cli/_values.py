"""The grammar of values on the command line: PATH=VALUE and KEY=VALUE, in every command alike.

A value is a number, or a number for each element, separated by commas: camera.origin=0.1,0,0.
"""

import math
import re
from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from ..runtime.text import InputError

if TYPE_CHECKING:
    from ..schema import Prior

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
    from ..schema.parameters import (
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
    from ..recordings import Channel, Definition, deviation_of

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


# The grammar of options of `giajax fit` on parameters: priors, bounds, ties, groups of runs.
#
# No character in it means anything to a shell, brackets of indices apart.

_PRIOR = re.compile(rf"\s*({NUMBER})\s*(\+-|x/)\s*({NUMBER})\s*")


def priors(pairs: Sequence[str] | None) -> "dict[str, Prior]":
    """Priors by path, from PATH=VALUE+-DEVIATION or PATH=VALUEx/FACTOR.

    Raises:
        InputError: a pair that is neither, a path twice, or a number that is not legal.
    """
    from ..schema import Prior

    known: dict[str, Prior] = {}
    for pair in pairs or []:
        path, text = _pair(pair, "--prior", "air.drag_coefficient=1.1+-0.2 or links.mass=0.05x/1.5")
        match = _PRIOR.fullmatch(text)
        value, spread = (number(match[1]), number(match[3])) if match else (None, None)
        if match is None or value is None or spread is None:
            raise InputError(
                f"--prior {pair!r} must be PATH=VALUE+-DEVIATION, or PATH=VALUEx/FACTOR: write it "
                "like air.drag_coefficient=1.1+-0.2 or links.mass=0.05x/1.5"
            )
        _check_new(path, known, "--prior")
        kind = "deviation" if match[2] == "+-" else "factor"
        try:
            known[path] = Prior(value, **{kind: spread})
        except InputError as error:
            raise InputError(f"--prior {pair!r} is not right, because {error}") from None
    return known


def bounds(pairs: Sequence[str] | None) -> dict[str, list[float]]:
    """Lower and upper bounds by path, from PATH=LOW,HIGH.

    Raises:
        InputError: a pair that is no PATH=LOW,HIGH, or a path twice.
    """
    known: dict[str, list[float]] = {}
    for pair in pairs or []:
        path, text = _pair(pair, "--bounds", "joints.damping=0.01,1.0")
        limits = [value for part in text.split(",") if (value := number(part)) is not None]
        if len(limits) != 2 or text.count(",") != 1:
            raise InputError(
                f"--bounds {pair!r} must be PATH=LOW,HIGH with two numbers: write it like "
                "joints.damping=0.01,1.0"
            )
        _check_new(path, known, "--bounds")
        known[path] = limits
    return known


def ties(pairs: Sequence[str] | None) -> dict[str, str]:
    """Expressions by the path that follows from them, from PATH=EXPRESSION.

    Raises:
        InputError: a pair that is no PATH=EXPRESSION, or a path twice.
    """
    known: dict[str, str] = {}
    for pair in pairs or []:
        path, text = _pair(pair, "--tie", "'links.mass=links.mass[0]'")
        _check_new(path, known, "--tie")
        known[path] = text
    return known


def groups(pairs: Sequence[str] | None) -> dict[str, list[list[str]]]:
    """Names of runs, group by group, by path, from PATH=RUN,RUN for each group.

    Raises:
        InputError: a pair that is no PATH=RUN,RUN.
    """
    known: dict[str, list[list[str]]] = {}
    for pair in pairs or []:
        path, text = _pair(pair, "--group", "joints.damping=monday,tuesday")
        known.setdefault(path, []).append([name.strip() for name in text.split(",")])
    return known


def _pair(pair: str, option: str, example: str) -> tuple[str, str]:
    path, _, text = (part.strip() for part in pair.partition("="))
    if not path or not text:
        raise InputError(f"{option} {pair!r} must be PATH=..., with both: write it like {example}")
    return path, text


def _check_new(path: str, known: Collection[str], option: str) -> None:
    if path in known:
        raise InputError(f"{option} gives {path} twice: remove one")
