"""Syntax of values on the command line: PATH=VALUE and KEY=VALUE, the same in every command.

A value is a number, or one number per element, separated by commas: camera.origin=0.1,0,0.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from ..runtime.text import InputError

if TYPE_CHECKING:
    from ..schema import Prior

NUMBER = r"[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?"

Values = dict[str, list[float]]
_T = TypeVar("_T")


def number(text: str) -> float | None:
    """Parse a finite number; None if the text is not one."""
    text = text.strip()
    if not re.fullmatch(NUMBER, text):
        return None
    return float(text) if math.isfinite(float(text)) else None


def numbers(text: str, count: int | None = None) -> list[float] | None:
    """Parse comma-separated numbers; None if their count differs or the text is invalid."""
    found = [value for part in text.split(",") if (value := number(part)) is not None]
    return found if len(found) == text.count(",") + 1 == (count or len(found)) else None


def _by_path(
    pairs: Sequence[str] | None,
    option: str,
    form: str,
    example: str,
    read: Callable[[str], _T | None],
) -> dict[str, _T]:
    """Return the parsed text after each PATH=, in the order of typing; each path once."""
    known: dict[str, _T] = {}
    for pair in pairs or []:
        path, _, text = (part.strip() for part in pair.partition("="))
        try:
            value = read(text) if path and text else None
        except InputError as error:
            raise InputError(f"{option} {pair!r} is not valid, because {error}") from None
        if value is None:
            raise InputError(f"{option} {pair!r} must be {form}: write it like {example}")
        if path in known:
            raise InputError(f"{option} gives {path} twice: remove one of the two")
        known[path] = value
    return known


def settings(pairs: Sequence[str] | None, option: str = "--set") -> Values:
    """Return one number, or one number per element, by path, from PATH=VALUE."""
    form = "PATH=VALUE with one number, or with one number for each element"
    example = "air.drag_coefficient=1.0 or camera.origin=0.1,0,0"
    return _by_path(pairs, option, form, example, numbers)


def joint_angles(pairs: Sequence[str] | None, option: str) -> dict[str, float]:
    """Return angles (deg) by the text before them, from JOINT=DEG."""
    return _by_path(pairs, option, "JOINT=DEG with a number", "1=20", number)


def plain(values: Values) -> dict[str, float | list[float]]:
    """Return values by path in the form of a file: a single number, or a list of several."""
    return {path: each[0] if len(each) == 1 else each for path, each in values.items()}


def plain_settings(pairs: Sequence[str] | None, option: str) -> dict[str, float | list[float]]:
    """Return the same as `settings`, in the form of a file."""
    return plain(settings(pairs, option))


def with_settings(model: Any, values: Mapping[str, Sequence[float]]) -> Any:
    """Return the model with these parameters; parameters that are off are switched on."""
    from ..schema.parameters import (
        check_count,
        check_within_bounds,
        elements,
        find,
        replace,
        switched_on,
    )

    for path, typed in values.items():
        model = switched_on(model, [path])
        check_count(model, path, typed)
        given = [float(value) for value in typed]
        if find(model, path).any_number:
            model = replace(model, {path: given})
        parts = elements(model, path)
        for part, value in zip(parts, given * (len(parts) // len(given)), strict=True):
            check_within_bounds(part, value, free=False)
            model = replace(model, {part.path: value})
    return model


def noise_section(
    pairs: Sequence[str] | None, option: str, *, positive: bool = False
) -> dict[str, float]:
    """Return keys of `[noise]` with standard deviations in the unit of the key, from KEY=VALUE."""
    section = _by_path(pairs, option, "KEY=VALUE with a number", "position_m=0.01", number)
    for key, value in section.items():
        if value < 0:
            raise InputError(f"{option} '{key}={value:g}' is negative: give 0 or a positive number")
        if positive and value == 0:
            raise InputError(f"{option} {key} is 0, but must be positive: give a positive number")
    return section


def deviations(
    section: Mapping[str, float], option: str, channels: Sequence[str]
) -> dict[str, float]:
    """Return standard deviations (SI) by channel, from keys of `[noise]`; each key must match."""
    from ..recordings import Channel, Definition, deviation_of

    def by_channel(part: Mapping[str, float]) -> dict[str, float]:
        noise = Definition.parse({"noise": dict(part)}, option).noise
        values = {name: deviation_of(noise, Channel.named(name)) for name in channels}
        return {name: value for name, value in values.items() if value is not None}

    for key in section:
        if not by_channel({key: 1.0}):
            raise InputError(
                f"{option} {key} matches none of the recorded channels: correct the key, or omit it"
            )
    # A deviation of 0 means no noise, for which [noise] has no entry.
    return by_channel({key: value for key, value in section.items() if value > 0})


def velocity(text: str, option: str) -> list[float]:
    """Parse three numbers in m/s."""
    if (found := numbers(text, 3)) is None:
        raise InputError(
            f"{option} is {text!r}: give three numbers in m/s separated by commas, such as 0,0.2,0"
        )
    return found


# Syntax of the options of `giajax fit` for parameters: priors, bounds, ties, groups of runs.
#
# No character of it has a meaning to a shell, except the brackets of indices.

_PRIOR = re.compile(rf"\s*({NUMBER})\s*(\+-|x/)\s*({NUMBER})\s*")


def priors(pairs: Sequence[str] | None) -> "dict[str, Prior]":
    """Return priors by path, from PATH=VALUE+-DEVIATION or PATH=VALUEx/FACTOR."""
    from ..schema import Prior

    def read(text: str) -> Prior | None:
        match = _PRIOR.fullmatch(text)
        value, spread = (number(match[1]), number(match[3])) if match else (None, None)
        if match is None or value is None or spread is None:
            return None
        return Prior(value, **{"deviation" if match[2] == "+-" else "factor": spread})

    form = "PATH=VALUE+-DEVIATION, or PATH=VALUEx/FACTOR"
    example = "air.drag_coefficient=1.1+-0.2 or links.mass=0.05x/1.5"
    return _by_path(pairs, "--prior", form, example, read)


def bounds(pairs: Sequence[str] | None) -> Values:
    """Return lower and upper bounds by path, from PATH=LOW,HIGH."""
    form = "PATH=LOW,HIGH with two numbers"
    return _by_path(pairs, "--bounds", form, "joints.damping=0.01,1.0", lambda t: numbers(t, 2))


def ties(pairs: Sequence[str] | None) -> dict[str, str]:
    """Return expressions by the path that they determine, from PATH=EXPRESSION."""
    return _by_path(pairs, "--tie", "PATH=EXPRESSION", "'links.mass=links.mass[0]'", str)


def groups(pairs: Sequence[str] | None) -> dict[str, list[list[str]]]:
    """Return groups of run names by path, from PATH=RUN,RUN for each group."""
    known: dict[str, list[list[str]]] = {}
    for pair in pairs or []:
        one = _by_path([pair], "--group", "PATH=RUN,RUN", "joints.damping=monday,tuesday", str)
        for path, text in one.items():
            known.setdefault(path, []).append([name.strip() for name in text.split(",")])
    return known
