"""Noise of a recorded channel before any model is known."""

import numpy as np

from ._robust import MAD

# Fewer second differences know no deviation.
_FEW = 8


def by_second_differences(values: np.ndarray) -> float | None:
    """Deviation of white noise on something smooth, from the median of second differences.

    Arguments:
        values: NaN where not measured, shape (sample,).

    Returns:
        None from too few.
    """
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    return None if len(second) < _FEW else _deviation(second)


def from_differences(values: np.ndarray) -> float:
    """Noise of a recorded channel from its second differences, before any model is known.

    A motion that is smooth over three samples leaves only noise in x[i-1] - 2 x[i] + x[i+1],
    whose standard deviation is sqrt(6) times that of white noise. The median keeps outliers
    out. A channel without visible noise gets a thousandth of its range.

    Arguments:
        values: recorded values, NaN where not measured, shape (sample,).

    Returns:
        Standard deviation, in the unit of the values; never 0.
    """
    measured = values[~np.isnan(values)]
    estimate = by_second_differences(values)
    if estimate is None:
        estimate = _deviation(np.diff(measured, 2))
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # an outlier is no range
    return max(estimate, 1e-3 * span) or 1.0


def _deviation(second: np.ndarray) -> float:
    return MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
