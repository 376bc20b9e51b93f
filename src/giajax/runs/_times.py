"""Checks of time stamps."""

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._limits import DURATION_S, GAP_S, STEP_S, TIME_S
from ._wording import Wording

Times = npt.NDArray[np.float64]

# How far two steps may differ by more than their unit: an uneven clock, and rounded stamps.
_EVEN = 2.0


def check_times(times: Times, wording: Wording, *, integrated: bool) -> None:
    """Raise `InputError` unless times are finite, strictly increasing, and of one unit.

    Arguments:
        times: shape (T,), s.
        wording: how an error names the samples.
        integrated: whether a model goes through all of the time between them.
    """
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        state = "infinite" if np.isinf(times[bad[0]]) else "empty"
        raise InputError(
            f"{wording.source}: time in {wording.at(bad[0])} is {state}, but every sample must "
            "have its time: complete or remove it"
        )
    bad = np.flatnonzero(np.abs(times) > TIME_S)
    if bad.size:
        raise InputError(
            f"{wording.source}: time in {wording.at(bad[0])} is {times[bad[0]]:.9g} s, but must be "
            f"at most {TIME_S:g} s: correct the stamp, or its unit"
        )
    steps = np.diff(times)
    bad = np.flatnonzero(steps <= 0)
    if bad.size:
        at = bad[0] + 1
        raise InputError(
            f"{wording.source}: time goes from {times[at - 1]:.9g} s to {times[at]:.9g} s in "
            f"{wording.at(at)}, but must strictly increase: sort the samples and remove repeated "
            "ones"
        )
    _check_unit(times, steps, wording)
    bad = np.flatnonzero(steps < STEP_S)
    if bad.size:
        at = bad[0] + 1
        raise InputError(
            f"{wording.source}: {wording.at(at)} is {steps[at - 1]:.3g} s after the one before, "
            f"but must be at least {STEP_S:g} s after it: correct the stamp"
        )
    bad = np.flatnonzero(steps > GAP_S)
    if bad.size and integrated:
        at = bad[0] + 1
        raise InputError(
            f"{wording.source}: {wording.at(at)} is {steps[at - 1]:.6g} s after the one before, "
            f"but may be {GAP_S:g} s after it at most: correct the stamp, or cut the run in two"
        )
    if integrated and times[-1] - times[0] > DURATION_S:
        raise InputError(
            f"{wording.source} lasts {times[-1] - times[0]:.6g} s, but may last {DURATION_S:g} s "
            "at most: cut it into several runs"
        )


def _check_unit(times: Times, steps: Times, wording: Wording) -> None:
    """Refuse stamps that go on in milliseconds: divided by 1000 they follow those before."""
    if len(steps) < 3:
        return
    before, leap, after = steps[:-2], times[2:-1] / 1000 - times[1:-2], steps[2:] / 1000
    ends = before / _EVEN, before * _EVEN
    follow = (leap > ends[0]) & (leap < ends[1]) & (after > ends[0]) & (after < ends[1])
    if follow.any():
        at = int(np.flatnonzero(follow)[0]) + 2
        raise InputError(
            f"{wording.source}: time goes from {times[at - 1]:.9g} s to {times[at]:.9g} s in "
            f"{wording.at(at)}, and from there on as if in milliseconds, but must have one unit: "
            "convert the stamps"
        )
