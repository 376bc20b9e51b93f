"""Histories of target angles: the paper's, and another one with minor loops."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Degrees = npt.NDArray[np.float64]

# Within this angle a command is held for longer.
_SLOW = 30.0
_SLOW_SECONDS, _SECONDS = 20.0, 5.0

_OTHER = (0, 45, -35, 30, -20, 50, 10, 40, -10, 20, -50, -5, -30, 15, 0)
PAPER = (0, 60, -60, 0)
"""Turns of the paper's history, deg; of the preparatory movement, too."""


@dataclass(frozen=True)
class History:
    """Target angles one degree apart.

    Attributes:
        name: what to call it.
        times: when the joint has come to rest and is measured, s, shape (sample,).
        target: deg, shape (sample,).
        measured: which samples are measured, after the preparatory movement; shape (sample,).
    """

    name: str
    times: npt.NDArray[np.float64]
    target: Degrees
    measured: npt.NDArray[np.bool_]


def history(name: str, turns: Sequence[float]) -> History:
    """The paper's preparatory movement, then from turn to turn by 1 deg.

    A step takes 5 s, and 20 s where the command is within 30 deg of 0.

    Arguments:
        name: what to call it.
        turns: angles that it goes to, one after the other, deg.

    Returns:
        The history, with the preparation in it.
    """
    before = _steps(PAPER)
    target = np.concatenate([before, _steps(turns)[1:]])
    held = np.where(np.abs(target) <= _SLOW, _SLOW_SECONDS, _SECONDS)
    return History(name, np.cumsum(held), target, np.arange(len(target)) >= len(before) - 1)


def _steps(turns: Sequence[float]) -> Degrees:
    pieces = [np.linspace(a, b, round(abs(b - a)) + 1)[1:] for a, b in itertools.pairwise(turns)]
    return np.concatenate([[turns[0]], *pieces]).astype(float)


def paper_history() -> History:
    """0, 60, -60, 0 deg, after the same as a preparation."""
    return history("paper", PAPER)


def other_history() -> History:
    """Other amplitudes and minor loops, which nothing is identified on."""
    return history("other", _OTHER)
