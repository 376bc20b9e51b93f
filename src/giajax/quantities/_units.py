"""Units: what a suffix of a column or of a key stands for, and what it is in SI."""

from dataclasses import dataclass

import numpy as np

from .._errors import InputError
from .._text import one_of


@dataclass(frozen=True)
class Quantity:
    """A physical quantity of the column table.

    `suffixes` maps what a column name ends in to its unit; the first one is what giajax writes
    by default. A quantity without suffixes is a pure number or text.
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
        Quantity("pixel", "px", {"px": "px"}),
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

# The units of the table that are not SI, in the SI unit of their quantity.
_IN_SI = {
    "ms": 1e-3,
    "deg": np.pi / 180,
    "deg/s": np.pi / 180,
    "cm": 1e-2,
    "mm": 1e-3,
    "mN": 1e-3,
    "kPa": 1e3,
    "MPa": 1e6,
    "bar": 1e5,
}

# Units of keys that no column has, by their SI unit.
_OF_KEYS = {"m^3": {"l": 1e-3}, "m^3/s": {"l_per_min": 1e-3 / 60}}


def si_factor(quantity: str, suffix: str) -> float:
    """How many SI units one unit of `suffix` is: 0.01 for `cm`, pi/180 for `deg`.

    Raises:
        InputError: the quantity has no such suffix.
    """
    known = QUANTITIES[quantity]
    if suffix not in known.suffixes:
        raise InputError(
            f"unit {suffix!r} is not a unit of {quantity.replace('_', ' ')}: "
            f"use {one_of(known.suffixes)}"
        )
    unit = known.suffixes[suffix]
    return 1.0 if unit == known.si_unit else _IN_SI[unit]


def key_factor(key: str, si_unit: str) -> float:
    """How many SI units one unit of a key's value is: 1 for `link_mass_kg`.

    Arguments:
        key: of a file; it ends in its unit, `_per_` standing for a stroke.
        si_unit: of its quantity, as in `kg m^2`; "" for a pure number, whose key has no unit.

    Raises:
        ValueError: the key does not end in a unit of the quantity.
    """
    if not si_unit:
        return 1.0
    known = {si_unit.replace("/", "_per_").replace(" ", "_").replace("^", ""): 1.0}
    known |= _OF_KEYS.get(si_unit, {})
    for quantity in QUANTITIES.values():
        if quantity.si_unit == si_unit:
            known |= {name: si_factor(quantity.name, name) for name in quantity.suffixes}
    for suffix, factor in known.items():
        if key.endswith(f"_{suffix}"):
            return factor
    raise ValueError(f"key {key} does not end in a unit of {si_unit}: end it in {one_of(known)}")
