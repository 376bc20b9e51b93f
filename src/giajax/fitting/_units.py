"""Units of parameters of a model whose columns have any: "output/input" is no unit to read."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from ..models import AbstractModel
from ..parameters import declared, left_out
from ..quantities import QUANTITIES
from ..runs import Channel, parse_column
from ._records import Estimate

# What a declaration calls the units of the columns that a model was fitted to.
_WORDS = ("input", "output")


class _Unit(NamedTuple):
    """What a value in SI is multiplied by, and its unit then."""

    factor: float
    name: str


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
    units = _recorded(_columns(model))
    return {path: _converted(estimate, units) for path, estimate in estimates.items()}


def column_factors(model: AbstractModel) -> dict[str, float]:
    """What `in_column_units` multiplies the values of each parameter by, by its path."""
    units = _recorded(_columns(model))
    return {path: _unit(unit, units).factor for path, unit in _declared_units(model).items()}


def units_in_si(model: AbstractModel) -> dict[str, str]:
    """The SI unit of each parameter, by its path; of those that are left out, too.

    Where a unit is made of "input" and "output", and the model knows its columns, it is made of
    the SI units of these.
    """
    units = {word: _Unit(1.0, channel.si_unit) for word, channel in _columns(model).items()}
    return {path: _unit(unit, units).name for path, unit in _declared_units(model).items()}


def units_note(estimates: Mapping[str, Estimate], model: AbstractModel) -> str:
    """A sentence on the units, where `in_column_units` changes numbers; else empty.

    Arguments:
        estimates: by path, in SI.
        model: the fitted one.

    Returns:
        The sentence, or nothing.
    """
    columns = _columns(model)
    units = _recorded(columns)
    factors = {_unit(estimate.unit, units).factor for estimate in estimates.values()}
    if factors <= {1.0}:
        return ""
    names = " and ".join(channel.column for channel in columns.values())
    return f"those of {names}; result.json, --start and --fix are in SI"


def _columns(model: AbstractModel) -> dict[str, Channel]:
    facts = model.definition()
    named = {word: facts.get(f"{word}_column") for word in _WORDS}
    return {word: parse_column(column) for word, column in named.items() if column}


def _declared_units(model: AbstractModel) -> dict[str, str]:
    known = {**declared(model), **left_out(model)}
    return {path: parameter.declaration.unit for path, parameter in known.items()}


def _recorded(columns: Mapping[str, Channel]) -> dict[str, _Unit]:
    """The units that columns are recorded in."""
    return {
        word: _Unit(
            float(channel.from_si(1.0)), QUANTITIES[channel.quantity].suffixes[channel.unit]
        )
        for word, channel in columns.items()
    }


def _converted(estimate: Estimate, units: Mapping[str, _Unit]) -> Estimate:
    factor, unit = _unit(estimate.unit, units)
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


def _unit(unit: str, units: Mapping[str, _Unit]) -> _Unit:
    """A unit in terms of "input" and "output", made of the units that these have."""
    above, _, below = unit.partition("/")
    words = {above, below} & set(_WORDS)
    if not words or not words <= set(units):
        return _Unit(1.0, unit)
    up = units.get(above, _Unit(1.0, "" if above == "1" else above))
    down = units.get(below, _Unit(1.0, below))
    factor = up.factor / down.factor
    if up.name == down.name:
        return _Unit(factor, "")
    if not down.name:
        return _Unit(factor, up.name)
    return _Unit(factor, f"{_bracketed(up.name) or 1}/{_bracketed(down.name)}")


def _bracketed(unit: str) -> str:
    return f"({unit})" if "/" in unit or " " in unit else unit
