"""A run in two parts: one to fit to, and one to judge by."""

import dataclasses

import numpy as np

from .._errors import InputError
from ..runs import Run

# With fewer measured values than this a part of a run is no loop.
_LEAST = 8


def parted(run: Run, fraction: float) -> tuple[Run, Run]:
    """The run without its last measurements, and with only those.

    Both have the whole input, which a memory follows.

    Arguments:
        run: with one measured channel.
        fraction: of the measured values that the second part has, between 0 and 1.

    Returns:
        The part to fit to, and the part to judge by.

    Raises:
        InputError: another fraction, or one that leaves too few values to a part.
    """
    if not 0 < fraction < 1:
        raise InputError(f"the held-out fraction is {fraction:g}: give one between 0 and 1")
    name, values = next(iter(run.observations.items()))
    measured = np.flatnonzero(~np.isnan(values))
    first = round(len(measured) * (1 - fraction))
    if first < _LEAST or len(measured) - first < _LEAST:
        raise InputError(
            f"'{run.name}' has {len(measured)} measured values, too few to hold out "
            f"{fraction:.0%} of them: give a longer run, or another run to judge by"
        )
    parts = []
    for kept in (measured[:first], measured[first:]):
        part = np.full(len(values), np.nan)
        part[kept] = values[kept]
        parts.append(dataclasses.replace(run, values={**run.values, name: part}))
    return parts[0], parts[1]
