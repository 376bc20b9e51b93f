"""The starts of an earlier result, to which more are added."""

import itertools
import json
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Setup, Start
from ._ends import end_of
from ._starts import start_values


def has_earlier_starts(
    before: FitResult | None, setup: Setup, starts: int, spread: float, seed: int
) -> bool:
    """Whether starts can be added to a result; an earlier version chose others, for example.

    Arguments:
        before, setup: as of `earlier_starts`; of None there are none.
        starts, spread, seed: as of `multi_start`.
    """
    if before is None:
        return False
    begun = setup.at_start()
    try:
        earlier_starts(before, begun, start_values(begun, spread, seed, starts))
    except InputError:
        return False
    return True


def earlier_starts(
    before: FitResult, setup: Setup, values: Sequence[Mapping[str, float]]
) -> list[Start]:
    """The starts of a result that are the first ones of another fit, and need not be fitted again.

    Arguments:
        before: of the same fit from fewer starts, or from one.
        setup: what is fitted to what.
        values: of all starts.

    Returns:
        Those before the first that did not come to an end, in their order.

    Raises:
        InputError: the result is of another fit, or its starts were others.
    """
    asked = json.loads(json.dumps(setup.config))
    if any(before.config.get(key) != value for key, value in asked.items()):
        raise InputError(
            "the result to add starts to is of another fit: give the same runs and settings"
        )
    known: Sequence[Start] = before.starts
    if not known:
        known = [end_of(values[0], before)]
    ends = ("converged", "failed")
    whole = list(itertools.takewhile(lambda start: start.status in ends, known))
    for start, wanted in zip(whole, values, strict=False):
        if start.start.keys() != wanted.keys() or not np.allclose(
            list(start.start.values()), [wanted[path] for path in start.start], rtol=1e-9, atol=0
        ):
            raise InputError(
                "the result to add starts to began elsewhere: give its seed and spread"
            )
    if len(whole) > len(values):
        raise InputError(
            f"the result to add starts to has {len(whole)} of them already: ask for more"
        )
    return whole
