"""Noise of known memory, drawn."""

import numpy as np


def correlated_noise(times: np.ndarray, time_s: float, rng: np.random.Generator) -> np.ndarray:
    """Noise of unit variance whose correlation between two instants is exp(-|dt| / time_s).

    Arguments:
        times: increasing, s, shape (sample,).
        time_s: correlation time, s; 0 for white noise.
        rng: draws it.
    """
    values = rng.normal(size=len(times))
    if time_s:
        decay = np.exp(-np.diff(times) / time_s)
        fresh = np.sqrt(1 - decay**2)
        for i in range(1, len(values)):
            values[i] = decay[i - 1] * values[i - 1] + fresh[i - 1] * values[i]
    return values


def correlation_time(rho: float, step_s: float) -> float:
    """The correlation time of noise by its correlation between two samples a step apart, s."""
    return 0.0 if rho == 0 else float(-step_s / np.log(rho))
