"""The state of an arm at the first sample of a run."""

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._typing import Float
from ..kinds import InitialSection
from ..quantities import INITIAL
from ..runs import Run

Row = Float[np.ndarray, " joint"]

# Rows that a rate is estimated from where none is recorded; enough to average noise, few enough
# for the motion to be straight.
_ROWS = 8


def initial_state(run: Run, times: np.ndarray, joints: int) -> tuple[Row, Row]:
    """Joint angles (rad) and rates (rad/s) that `[initial]` states; zero where it says nothing.

    Raises:
        InputError: a list of another length, or `first_row` without what it needs.
    """
    section = run.definition.section(InitialSection)
    if not section.first_row:
        values = section.values()
        return (
            _each(run, values.get(INITIAL.angle.path, INITIAL.angle.default), joints),
            _each(run, values.get(INITIAL.rate.path, INITIAL.rate.default), joints),
        )
    rates = [run.values.get(f"joint{joint:02d}_rate") for joint in range(1, joints + 1)]
    recorded = all(rate is not None and np.isfinite(rate[0]) for rate in rates)
    angles, slopes = np.zeros(joints), np.zeros(joints)
    for joint in range(1, joints + 1):
        column = run.values.get(f"joint{joint:02d}_angle")
        if column is None or not np.isfinite(column[0]):
            raise InputError(
                f"[initial] of '{run.name}' says first_row = true, but joint{joint:02d}_angle has "
                "no value there: record the angle of every joint, or state angle_deg"
            )
        angles[joint - 1] = column[0]
        slopes[joint - 1] = _slope(times[:_ROWS], column[:_ROWS])
    if recorded:
        return angles, np.asarray([float(rate[0]) for rate in rates if rate is not None])
    if not section.free:
        raise InputError(
            f"[initial] of '{run.name}' says first_row = true, but the rate of a joint has no "
            "value there: record the rates, or let the fit find them with free = true"
        )
    return angles, slopes


def _slope(times: np.ndarray, values: np.ndarray) -> float:
    measured = np.isfinite(values)
    if np.sum(measured) < 2:
        return 0.0
    return float(np.polyfit(times[measured] - times[0], values[measured], 1)[0])


def _each(run: Run, values: npt.ArrayLike, joints: int) -> Row:
    values = np.asarray(values, dtype=float)
    if values.shape not in ((), (joints,)):
        raise InputError(
            f"[initial] of '{run.name}' has {values.size} values for {joints} joints: "
            "give one number or one per joint"
        )
    return np.broadcast_to(values, (joints,))
