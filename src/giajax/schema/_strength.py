"""Check that the gas withstands the muscles: links must not collapse, and necks not be crushed.

Values are given by path, as in files and models. Does not import JAX.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from ._declaration import Declaration
from ._joint import BRAIDED, EMPIRICAL, GEOMETRY, LOAD


def _value(known: Mapping[str, Any], of: Declaration) -> Any:
    return known.get(of.path, of.default)


def braid_area(diameter: Any, angle: Any) -> Any:
    """Return the force of an ideal braided muscle at zero contraction per unit of pressure, m^2.

    Arguments:
        diameter: diameter at rest, m.
        angle: braid angle from the axis at rest, rad.
    """
    return np.pi / 4 * diameter**2 * (3 / np.tan(angle) ** 2 - 1 / np.sin(angle) ** 2)


def largest_pull(known: Mapping[str, Any], law: str | None = None) -> float:
    """Return the force of one muscle at its pressure limit and zero contraction, N.

    Arguments:
        known: values by path, SI; missing ones have their defaults.
        law: "braided" (the default) or "empirical", for which the muscle is assumed to be long.
    """
    if law == "empirical":
        return float(_value(known, EMPIRICAL.force_limit))
    pressure = _value(known, BRAIDED.pressure_limit) - _value(known, BRAIDED.dead_band)
    area = braid_area(_value(known, BRAIDED.diameter), _value(known, BRAIDED.braid_angle))
    return float(_value(known, BRAIDED.effectiveness) * pressure * area)


def collapse(pressure: npt.ArrayLike, diameter: npt.ArrayLike, pull: float) -> str | None:
    """Describe the links in which p pi r^2 is less than the force of a muscle, or return None.

    Arguments:
        pressure, diameter: of the links, Pa and m: one number for all, or one for each.
        pull: force of one muscle, N.
    """
    pressures, sizes = np.broadcast_arrays(np.ravel(pressure), np.ravel(diameter))
    borne = pressures * np.pi / 4 * sizes**2
    weak, least = np.flatnonzero(borne < pull), int(np.argmin(borne))
    if not weak.size:
        return None
    alone = borne.size == 1
    these = "each link withstands" if alone else f"{weak.size} of {borne.size} links withstand"
    return (
        f"{these} less than the {pull:.1f} N pull of one muscle at its pressure limit, and would "
        f"collapse: p pi r^2 {'' if alone else f'of link {least + 1} '}is {borne[least]:.1f} N, "
        f"at {pressures[least]:.1f} Pa"
    )


def straight_compression(known: Mapping[str, Any]) -> float:
    """Return the least force with which both muscles compress a straight joint, N.

    It follows from the co-contraction torque of each muscle and the height of its anchor.
    """
    return float(2 * _value(known, LOAD.torque) / _value(known, GEOMETRY.anchor_y))


def crushed(compression: float, held: float, *, joint: int | None = None) -> str | None:
    """Describe that the gas in a neck does not withstand the compression, or return None.

    Both forces on the straight joint are in N. For a numbered joint of an arm, the compression is
    the least that its muscles exert.
    """
    if compression < held:
        return None
    which = "the straight joint" if joint is None else f"joint {joint} in its straight pose"
    least = "" if joint is None else "at least "
    return (
        f"the muscles compress {which} with {least}{compression:.3g} N, but the gas in the neck "
        f"withstands only {held:.3g} N"
    )
