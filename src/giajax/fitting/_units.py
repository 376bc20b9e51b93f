"""Estimates in the units of the columns: a parameter whose unit is "output/input" has no other."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..models import AbstractModel
from ..runs import Channel, parse_column
from ._records import Estimate

# What a declaration calls the units of the columns that a model was fitted to.
_WORDS = ("input", "output")


def in_column_units(estimates: Mapping[str, Estimate], model: AbstractModel) -> dict[str, Estimate]:
    """The estimates with values, errors and bounds in the units of the fitted columns.

    Where a unit is made of "input" and "output", as those of a hysteresis operator are, and the
    model knows its columns; every other estimate stays as it is, in SI.

    Arguments:
        estimates: by path, in SI.
        model: the fitted one, which may know its columns.

    Returns:
        By the same paths.
    """
    columns = _columns(model)
    return {path: _converted(estimate, columns) for path, estimate in estimates.items()}


def units_note(estimates: Mapping[str, Estimate], model: AbstractModel) -> str:
    """A sentence on the units, where `in_column_units` changes numbers; else empty.

    Arguments:
        estimates: by path, in SI.
        model: the fitted one.

    Returns:
        The sentence, or nothing.
    """
    columns = _columns(model)
    factors = {_unit(estimate.unit, columns).factor for estimate in estimates.values()}
    if factors <= {1.0}:
        return ""
    names = " and ".join(channel.column for channel in columns.values())
    return f"those of {names}; result.json, --start and --fix are in SI"


def _columns(model: AbstractModel) -> dict[str, Channel]:
    facts = model.definition()
    named = {word: facts.get(f"{word}_column") for word in _WORDS}
    return {word: parse_column(column) for word, column in named.items() if column}


def _converted(estimate: Estimate, columns: Mapping[str, Channel]) -> Estimate:
    factor, unit = _unit(estimate.unit, columns)
    if unit == estimate.unit:
        return estimate

    def scaled(value: Any) -> Any:
        return None if value is None else (np.asarray(value, dtype=float) * factor).tolist()

    return dataclasses.replace(
        estimate,
        value=scaled(estimate.value),
        standard_error=scaled(estimate.standard_error),
        lower=scaled(estimate.lower),
        upper=scaled(estimate.upper),
        unit=unit,
    )


class _Unit(NamedTuple):
    """What a value in SI is multiplied by, and its unit then."""

    factor: float
    name: str


def _unit(unit: str, columns: Mapping[str, Channel]) -> _Unit:
    """A unit in terms of "input" and "output", in the units of the columns."""
    above, _, below = unit.partition("/")
    if not {above, below} & set(_WORDS) or not {above, below} & set(_WORDS) <= set(columns):
        return _Unit(1.0, unit)
    (up, numerator), (down, denominator) = _part(above, columns), _part(below, columns)
    if numerator == denominator:
        return _Unit(up / down, "")
    shown = f"{numerator or 1}/{denominator}" if denominator else numerator
    return _Unit(up / down, shown)


def _part(name: str, columns: Mapping[str, Channel]) -> _Unit:
    if name not in columns:
        return _Unit(1.0, "" if name == "1" else name)
    channel = columns[name]
    unit = channel.unit.replace("_per_", "/")
    return _Unit(float(channel.from_si(1.0)), f"({unit})" if "/" in unit else unit)
