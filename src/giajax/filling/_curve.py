"""Ports and supplies with which filling takes as long as it did."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._limits import FILLING_S
from ..parameters import get, replace
from ..quantities import PORTS
from ._fill import check_filling, fill, tried
from ._filling import Filling
from ._supply import STRENGTHS

Numbers = npt.NDArray[np.float64]

PAPER_DURATION = 23 * 60.0
"""How long filling took, s (IV.B)."""

DIAMETERS = (0.004, 0.005, 0.006, 0.007, 0.008, 0.01, 0.012, 0.015, 0.02)
"""Diameters of the ports of a curve, m."""

_TRIES = 40
# A supply that is a hundred times as strong will not do either.
_FAR = math.log(1e2)
_CLOSE = 1e-6


@dataclasses.dataclass(frozen=True)
class FillingCurve:
    """Pairs of port and supply with which filling takes a given time.

    Attributes:
        duration: that time, s.
        diameters: of all ports, m, shape (pair,).
        strengths: what the supply must have, SI: the parameter `path`; NaN where no supply will do.
        path: of the supply's parameter: flow, pressure of the regulator, nozzle of the bottle.
        flows: of the supply when it begins, as volume at the pressure of the room, m^3/s.
        pressures: the largest of the first bag above that of the room, Pa.
    """

    duration: float
    diameters: Numbers
    strengths: Numbers
    path: str
    flows: Numbers
    pressures: Numbers


def filling_curve(
    filling: Filling | None = None,
    *,
    duration: float = PAPER_DURATION,
    diameters: Sequence[float] = DIAMETERS,
) -> FillingCurve:
    """The supply for each diameter of the ports with which filling takes a given time.

    Arguments:
        filling: arm, gas, ports and supply; all ports are given the same diameter.
        duration: how long filling takes, s; that of the paper by default.
        diameters: of the ports, m.

    Returns:
        Diameter, supply and the pressure that comes of them.

    Raises:
        InputError: a number that is out of its bounds, or an arm without ports.
    """
    made = Filling() if filling is None else filling
    if made.bags < 2:
        raise InputError("all links share one bag, which has no ports: leave the curve out")
    if not 0 < duration <= FILLING_S:
        raise InputError(f"the duration is {duration:g} s: give from 0 to {FILLING_S:g} s")
    if not len(diameters):
        raise InputError("there are no diameters: give at least one")
    path = STRENGTHS[made.supply.kind]
    guess = math.log(float(get(made, path)))
    columns = []
    # From the widest, which needs what ports of no resistance need.
    for diameter in sorted(diameters, reverse=True):
        narrowed = replace(made, {PORTS.diameter.path: float(diameter)})
        check_filling(narrowed)
        strength = _strength(narrowed, path, duration, guess)
        if strength is None:
            columns.append((diameter, np.nan, np.nan, np.nan))
            continue
        guess = math.log(strength)
        found = fill(replace(narrowed, {path: strength}), limit=2 * duration)
        columns.append((diameter, strength, found.flow[0], found.pressure[:, 0].max()))
    pairs = np.asarray(columns[::-1]).T
    return FillingCurve(duration, pairs[0], pairs[1], path, pairs[2], pairs[3])


def _strength(filling: Filling, path: str, duration: float, guess: float) -> float | None:
    """The strength of the supply with which filling takes this long; None where there is none.

    By the secant in logarithms, kept between what is too little and what is too much.
    """
    low, high, start = -math.inf, math.inf, guess
    here, before = guess, None
    for _ in range(_TRIES):
        course = tried(replace(filling, {path: math.exp(here)}), 4 * duration, 1e-7)
        if not bool(course.succeeded):
            return None
        finished = bool(course.finished)
        late = math.log(float(course.times[-1]) / duration)
        if finished and abs(late) < _CLOSE:
            return math.exp(here)
        low, high = (max(low, here), high) if late > 0 else (low, min(high, here))
        # What a meter feeds takes a time that is inverse to it.
        slope = -1.0
        if before is not None and finished and before[0] != here:
            slope = min((late - before[1]) / (here - before[0]), -0.05)
        before = (here, late) if finished else None
        new = here - min(max(late / slope, -1.5), 1.5)
        here = new if low < new < high else (low + high) / 2
        if abs(here - start) > _FAR or high - low < 1e-12:
            return None
    return None
