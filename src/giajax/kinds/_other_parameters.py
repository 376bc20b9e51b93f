"""Checks of `[arm.parameters]`, which states by their paths what has no key of its own."""

from collections.abc import Mapping

from .._text import shown
from ..quantities import (
    AIR,
    ALPHA,
    BASE,
    BETA,
    BRAIDED,
    BUOYANCY,
    DRIVE,
    EMPIRICAL,
    GEOMETRY,
    JOINT_MEMORY,
    JOINT_STOPS,
    JOINTS,
    LINKS,
    LOAD,
    PISTON,
    POINT_MASSES,
)
from ._section import Section

_OF_ARMS = (LINKS, JOINTS, JOINT_MEMORY, JOINT_STOPS, BASE, AIR, BUOYANCY, POINT_MASSES)
_OF_MUSCLES = (GEOMETRY, LOAD, ALPHA, BETA, BRAIDED, EMPIRICAL, PISTON, DRIVE)
_DECLARED = {
    declaration.path: declaration for group in (*_OF_ARMS, *_OF_MUSCLES) for declaration in group
}


def check_bounds(table: Mapping[str, float | list[float]]) -> None:
    """Refuse a value that its parameter may not have.

    Which parameters an arm has is known where it is built; what they may be is known here.

    Raises:
        ValueError: naming the path, the value and its bounds.
    """
    for path, value in table.items():
        declaration = _DECLARED.get(path.partition("[")[0])
        if declaration is None:
            continue
        lower, upper = declaration.lower, declaration.upper
        for number in value if isinstance(value, list) else [value]:
            if not lower <= number <= upper:
                unit = f" {declaration.unit}" if declaration.unit else ""
                raise ValueError(
                    f"has {shown(path)} = {number:g}{unit}, but it must be from {lower:g} to "
                    f"{upper:g}{unit}: correct or remove it"
                )


def check_stated_once(section: Section, table: Mapping[str, float | list[float]]) -> None:
    """Refuse a parameter of the table that a key of the section states as well.

    An element, `links.mass[2]`, is another statement than that of the whole, and goes on top of it.

    Raises:
        ValueError: naming the path and the key.
    """
    for name in section.contents():
        for declaration in section.quantities.get(name, ()):
            if declaration.path in table:
                raise ValueError(
                    f"states {declaration.path} twice, by the key {name} and in [arm.parameters]: "
                    "remove one"
                )
