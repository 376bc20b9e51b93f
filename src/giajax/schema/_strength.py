"""What muscles press together, against what gas holds: links that collapse, necks that are crushed.

Numbers by path, as files state them and as models have them. Imports no JAX.
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
    """Force of an ideal braided muscle that is not contracted, over its pressure, m^2.

    Arguments:
        diameter: at rest, m.
        angle: of the braid from the axis at rest, rad.
    """
    return np.pi / 4 * diameter**2 * (3 / np.tan(angle) ** 2 - 1 / np.sin(angle) ** 2)


def largest_pull(known: Mapping[str, Any], law: str | None = None) -> float:
    """Force of one muscle at its pressure limit that is not contracted, N.

    Arguments:
        known: values by path, SI; what is not among them is as by default.
        law: "braided" (by default) or "empirical", of which it is that of a long muscle.
    """
    if law == "empirical":
        return float(_value(known, EMPIRICAL.force_limit))
    pressure = _value(known, BRAIDED.pressure_limit) - _value(known, BRAIDED.dead_band)
    area = braid_area(_value(known, BRAIDED.diameter), _value(known, BRAIDED.braid_angle))
    return float(_value(known, BRAIDED.effectiveness) * pressure * area)


def collapse(pressure: npt.ArrayLike, diameter: npt.ArrayLike, pull: float) -> str | None:
    """Which links have less than the force of a muscle in p pi r^2; None: none have.

    Arguments:
        pressure, diameter: of the links, Pa and m: one number for all, or one each.
        pull: of one muscle, N.
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
        f"collapse:"
        f" p pi r^2 {'' if alone else f'of link {least + 1} '}is "
        f"{borne[least]:.1f} N, at {pressures[least]:.1f} Pa"
    )


def straight_compression(known: Mapping[str, Any]) -> float:
    """Force with which both muscles press a straight joint together at least, N.

    That of the co-contraction torque of each, at the height of its anchor.
    """
    return float(2 * _value(known, LOAD.torque) / _value(known, GEOMETRY.anchor_y))


def crushed(compression: float, held: float, *, joint: int | None = None) -> str | None:
    """That the gas in a neck does not hold the compression of the straight joint, both in N.

    Of a numbered joint of an arm, the compression is the least that muscles have.
    """
    if compression < held:
        return None
    which = "the straight joint" if joint is None else f"joint {joint} in its straight pose"
    least = "" if joint is None else "at least "
    return (
        f"the muscles compress {which} with {least}{compression:.3g} N, but the gas in the neck "
        f"withstands only {held:.3g} N"
    )
