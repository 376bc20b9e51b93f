"""Noise with a given correlation time."""

import numpy as np


def correlated_noise(times: np.ndarray, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return noise of unit variance with the autocorrelation exp(-|dt| / time_s).

    Arguments:
        times: increasing times, s, shape (sample,).
        time_s: correlation time, s; 0 for white noise.
        rng: random number generator.
    """
    values = rng.normal(size=len(times))
    if time_s:
        decay = np.exp(-np.diff(times) / time_s)
        fresh = np.sqrt(1 - decay**2)
        for i in range(1, len(values)):
            values[i] = decay[i - 1] * values[i - 1] + fresh[i - 1] * values[i]
    return values


def correlation_time(rho: float, step_s: float) -> float:
    """Return the correlation time, s, for a correlation rho of samples `step_s` (s) apart."""
    return 0.0 if rho == 0 else float(-step_s / np.log(rho))
