"""The values of a plan: lists and ranges of a grid, and draws of a sample. Imports no JAX."""

import itertools
import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from .._errors import InputError
from .._sobol import sobol_points
from .._text import one_of, shown
from ._columns import DRAWS, RANGE, Case, check_count, columns_of

_METHODS = ("sobol", "random")


def grid_cases(section: Mapping[str, Any], where: str) -> list[Case]:
    """Every combination of the values of a grid; those of the last key differ first."""
    columns = columns_of(section, where)
    several = [_listed(value, f"{where}: {name}") for name, value in columns.items()]
    check_count(math.prod(map(len, several)), where)
    return [dict(zip(columns, values, strict=True)) for values in itertools.product(*several)]


def _listed(value: Any, where: str) -> list[Any]:
    """The values that a list has, or a range."""
    if isinstance(value, list) and value:
        return value
    if not isinstance(value, Mapping) or not {"from", "to", "count"} <= set(value) <= set(RANGE):
        raise InputError(
            f"{where} = {shown(value)} must be a list of values, or a range such as "
            "{ from = 0.5, to = 1.5, count = 5 }: correct it"
        )
    low, high, count = value["from"], value["to"], value["count"]
    if type(count) is int:
        check_count(count, where)
    if not (_is_number(low) and _is_number(high) and type(count) is int and count > 0):
        raise InputError(f"{where} must go from a number to a number in a count: correct it")
    logarithmic = value.get("log", False)
    if logarithmic and not min(low, high) > 0:
        raise InputError(f"{where} is logarithmic, and must go from and to what is positive")
    # Whole numbers stay whole where every one is: some keys take no other.
    steps = max(count - 1, 1)
    if type(low) is type(high) is int and not logarithmic and (high - low) % steps == 0:
        return [low + (high - low) // steps * step for step in range(count)]
    with np.errstate(all="ignore"):
        spaced = (np.geomspace if logarithmic else np.linspace)(float(low), float(high), count)
    if not np.all(np.isfinite(spaced)):
        raise InputError(f"{where} goes too far to be divided: give nearer ends")
    return [float(number) for number in spaced]


def sample_cases(section: Mapping[str, Any], where: str) -> list[Case]:
    """Draws of start values and held values, by a Sobol sequence or at random."""
    rest = {name: item for name, item in section.items() if name in ("start", "fix")}
    count, seed = section.get("count"), section.get("seed", 0)
    method = section.get("method", "sobol")
    unknown = set(section) - {"start", "fix", "count", "seed", "method"}
    if unknown:
        raise InputError(
            f"{where}: unknown key {shown(min(unknown))}: correct or remove it (known here: count, "
            "seed, method, start, fix)"
        )
    if type(count) is not int or count < 1:
        raise InputError(f"{where}: count must be how many there are to draw: give 64, say")
    check_count(count, where)
    if type(seed) is not int or seed < 0:
        raise InputError(f"{where}: seed must be zero or a positive whole number: correct it")
    if method not in _METHODS:
        raise InputError(f"{where}: method must be {one_of(map(repr, _METHODS))}: correct it")
    columns = columns_of(rest, where)
    if not columns:
        raise InputError(f"{where} draws nothing: add fix or start with a distribution")
    points = _points(method, len(columns), count, seed)
    drawn = [
        _drawn(value, points[:, at], f"{where}: {name}")
        for at, (name, value) in enumerate(columns.items())
    ]
    return [dict(zip(columns, row, strict=True)) for row in zip(*drawn, strict=True)]


def _points(method: str, dimensions: int, count: int, seed: int) -> np.ndarray:
    """Points of the unit cube, shape (count, dimensions), none of them on its faces."""
    if method == "sobol":
        return sobol_points(count, dimensions, seed)
    points = np.random.default_rng(seed).random((count, dimensions))
    return np.maximum(points, np.finfo(float).eps)


def _drawn(value: Any, points: np.ndarray, where: str) -> Iterator[float]:
    """Values of a distribution at points of the unit interval."""
    kind = next(iter(value), None) if isinstance(value, Mapping) and len(value) == 1 else None
    ends = value[kind] if kind in DRAWS else None
    if not (isinstance(ends, list) and len(ends) == 2 and all(map(_is_number, ends))):
        forms = one_of(f"{name} = {form}" for name, form in DRAWS.items())
        raise InputError(f"{where} = {shown(value)} must be a table of {forms}: correct it")
    low, high = map(float, ends)
    if kind == "normal":
        if not high > 0:
            raise InputError(f"{where} must have a positive deviation: correct it")
        from scipy.special import ndtri

        return iter((low + high * ndtri(points)).tolist())
    if not low < high or (kind == "log_uniform" and low <= 0):
        raise InputError(f"{where} must go from a lower to a higher end, {DRAWS[kind or '']}")
    if kind == "log_uniform":
        return iter(np.exp(math.log(low) + points * math.log(high / low)).tolist())
    return iter((low + points * (high - low)).tolist())


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
