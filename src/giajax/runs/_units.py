"""Quantities, their unit suffixes, and conversion to and from SI."""

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._text import one_of


@dataclass(frozen=True)
class Quantity:
    """A physical quantity of the column table.

    `suffixes` maps what a column name ends in to the unit as pint reads it; the first one is
    what giajax writes by default. A quantity without suffixes is a pure number or text.
    """

    name: str
    si_unit: str
    suffixes: dict[str, str]


QUANTITIES: dict[str, Quantity] = {
    quantity.name: quantity
    for quantity in (
        Quantity("time", "s", {"s": "s", "ms": "ms"}),
        Quantity("angle", "rad", {"deg": "deg", "rad": "rad"}),
        Quantity("angular_velocity", "rad/s", {"deg_per_s": "deg/s", "rad_per_s": "rad/s"}),
        Quantity("length", "m", {"m": "m", "cm": "cm", "mm": "mm"}),
        Quantity("velocity", "m/s", {"m_per_s": "m/s"}),
        Quantity("force", "N", {"N": "N", "mN": "mN"}),
        Quantity("torque", "N m", {"N_m": "N m"}),
        Quantity("pressure", "Pa", {"kPa": "kPa", "MPa": "MPa", "bar": "bar"}),
        Quantity("ratio", "", {"": ""}),
        Quantity("text", "", {"": ""}),
    )
}

# `input` and `output` of a hysteresis run take any of these; each suffix belongs to one quantity.
QUANTITY_OF_SUFFIX: dict[str, str] = {
    suffix: quantity.name
    for quantity in QUANTITIES.values()
    if quantity.name not in ("time", "text")
    for suffix in quantity.suffixes
}


@lru_cache(maxsize=1)
def _registry() -> Any:
    # Importing pint and building its registry takes 0.4 s: only for whoever converts a unit.
    import pint

    return pint.UnitRegistry()


@lru_cache(maxsize=64)
def si_factor(quantity: str, suffix: str) -> float:
    """How many SI units one unit of `suffix` is: 0.01 for `cm`, pi/180 for `deg`.

    Raises `InputError` if the quantity has no such suffix.
    """
    known = QUANTITIES[quantity]
    if suffix not in known.suffixes:
        raise InputError(
            f"unit {suffix!r} is not a unit of {quantity.replace('_', ' ')}: "
            f"use {one_of(known.suffixes)}"
        )
    unit = known.suffixes[suffix]
    if unit == known.si_unit:
        return 1.0
    return float(_registry().Quantity(1.0, unit).m_as(known.si_unit))


def to_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`values` in the unit of `suffix`, any shape, as float64 in SI."""
    return np.asarray(np.asarray(values, dtype=np.float64) * si_factor(quantity, suffix))


def from_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """`values` in SI, any shape, as float64 in the unit of `suffix`."""
    return np.asarray(np.asarray(values, dtype=np.float64) / si_factor(quantity, suffix))
