"""Noise of a recorded channel before any model is known."""

import numpy as np

from ._robust import MAD


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
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    if len(second) < 8:
        second = np.diff(measured, 2)
    estimate = MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # an outlier is no range
    return max(estimate, 1e-3 * span) or 1.0
