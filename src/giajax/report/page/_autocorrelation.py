"""The autocorrelation of residuals, with gaps."""

import numpy as np

from ..._typing import Float

_MOST_LAGS = 60


def autocorrelation(
    residuals: Float[np.ndarray, " sample"],
) -> tuple[Float[np.ndarray, " lag"], float]:
    """Autocorrelation of residuals at lags of 1, 2, ... samples, and the 95 % band of white noise.

    Arguments:
        residuals: recorded minus fitted; NaN where not measured, which pairs with nothing.

    Returns:
        The autocorrelations, none where there are too few values, and half the width of the band.
    """
    known = ~np.isnan(residuals)
    count = int(known.sum())
    lags = min(len(residuals) // 4, _MOST_LAGS)
    values = np.where(known, residuals - (residuals[known].mean() if count else 0.0), 0.0)
    power = float(np.mean(values[known] ** 2)) if count else 0.0
    if count < 8 or power == 0:
        return np.empty(0), 0.0
    found = []
    for lag in range(1, lags + 1):
        pairs = int(np.sum(known[lag:] & known[:-lag]))
        found.append(np.sum(values[lag:] * values[:-lag]) / (max(pairs, 1) * power))
    return np.array(found), 1.96 / np.sqrt(count)
