"""Which markers to film: the choice of a few out of many that tells most."""

import itertools
import math
from collections.abc import Callable

import numpy as np

from .._errors import InputError
from .._typing import Float

Informations = Float[np.ndarray, "body draw parameter parameter"]

# Up to so many choices all are looked at.
_ALL = 3000


def check_count(count: int, bodies: int) -> None:
    """Refuse a number of markers that cannot be chosen.

    Raises:
        InputError: fewer than 1, or more than there are.
    """
    if not 1 <= count <= bodies:
        raise InputError(
            f"{count} markers are to be filmed out of {bodies}: give a number from 1 to {bodies}"
        )


def chosen_markers(
    error: Callable[[np.ndarray], float], informations: Informations, count: int
) -> tuple[int, ...]:
    """Positions of the bodies to record.

    All choices are compared where they are few; else one is added after the other, each the one
    that helps most, and then exchanged as long as that helps (Fedorov).

    Arguments:
        error: to expect of an information, shape (draw, parameter, parameter).
        informations: of each body, shape (body, draw, parameter, parameter).
        count: how many may be recorded.

    Returns:
        Increasing positions, of shape (count,).

    Raises:
        InputError: fewer than 1, or more than there are.
    """
    bodies = len(informations)
    check_count(count, bodies)

    def of(some: tuple[int, ...]) -> float:
        return error(informations[list(some)].sum(axis=0))

    if math.comb(bodies, count) <= _ALL:
        return min(itertools.combinations(range(bodies), count), key=of)
    some: tuple[int, ...] = ()
    while len(some) < count:
        some = min(((*some, new) for new in range(bodies) if new not in some), key=of)
    while True:
        others = [body for body in range(bodies) if body not in some]
        exchanged = [
            (*some[:place], new, *some[place + 1 :]) for place in range(count) for new in others
        ]
        best = min(exchanged, key=of)
        if of(best) >= of(some):
            return tuple(sorted(some))
        some = best
