"""The standard deviation of a channel's noise, where nobody stated it."""

import numpy as np

# 1.4826 median(|x|) estimates the standard deviation of a normal variable.
_MAD = 1.4826


def from_differences(values: np.ndarray) -> float:
    """Noise of a recorded channel from its second differences, before any model is known.

    A motion that is smooth over three samples leaves only noise in x[i-1] - 2 x[i] + x[i+1],
    whose standard deviation is sqrt(6) times that of white noise. The median keeps outliers
    out. A channel without visible noise gets a thousandth of its range.

    Arguments:
        values: recorded values, NaN where not measured, shape (sample,).
    """
    measured = values[~np.isnan(values)]
    second = np.diff(values, 2)
    second = second[~np.isnan(second)]
    if len(second) < 8:
        second = np.diff(measured, 2)
    estimate = _MAD * float(np.median(np.abs(second))) / np.sqrt(6) if len(second) else 0.0
    span = float(np.ptp(np.quantile(measured, [0.05, 0.95])))  # an outlier is no range
    return max(estimate, 1e-3 * span) or 1.0


def from_residuals(residuals: np.ndarray, parameters: float, *, robust: bool) -> float:
    """Noise of a channel from the residuals of a fit.

    Arguments:
        residuals: recorded minus predicted where measured, shape (n,).
        parameters: degrees of freedom that the fit took from this channel.
        robust: use the median, for a loss that lets outliers stand.
    """
    residuals = np.asarray(residuals, dtype=float)
    if robust:
        estimate = _MAD * float(np.median(np.abs(residuals)))
    else:
        count = max(len(residuals) - parameters, 1.0)
        estimate = float(np.sqrt(np.sum(residuals**2) / count))
    # Never zero: data without noise would weigh infinitely.
    return max(estimate, 1e-12 * float(np.max(np.abs(residuals), initial=0.0)), 1e-300)
