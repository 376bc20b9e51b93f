"""The grammar of what `giajax fit` is told of parameters: priors, bounds, ties, groups of runs.

No character in it means anything to a shell, brackets of indices apart.
"""

import re
from collections.abc import Collection, Sequence
from typing import TYPE_CHECKING

from .._errors import InputError
from ._values import NUMBER, number

if TYPE_CHECKING:
    from ..quantities import Prior

_PRIOR = re.compile(rf"\s*({NUMBER})\s*(\+-|x/)\s*({NUMBER})\s*")


def priors(pairs: Sequence[str] | None) -> "dict[str, Prior]":
    """Priors by path, from PATH=VALUE+-DEVIATION or PATH=VALUEx/FACTOR.

    Raises:
        InputError: a pair that is neither, a path twice, or a number that is not legal.
    """
    from ..quantities import Prior

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
