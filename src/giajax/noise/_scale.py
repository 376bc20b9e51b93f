"""The size of noise that makes a likelihood largest, by Newton's method."""

import numpy as np

from .._typing import Float
from ._model import ChannelNoise
from ._restricted import ByScale, Restricted

# Of a logarithm: for the derivatives of a likelihood of thousands, by differences, and a change
# that leaves it as it is.
_STEP = 1e-3
_ENOUGH = 3e-4
_LONGEST = 1.0
_ITERATIONS = 20

# Where nothing at all is left, noise may be of any smallness: a logarithm.
_FURTHEST = 8.0


def best_scales(
    by_scale: ByScale, start: Float[np.ndarray, " noise"]
) -> tuple[Float[np.ndarray, " noise"], Float[np.ndarray, " noise"]]:
    """Logarithms of the factors at which noises are most likely, and -2 log L there.

    Arguments:
        by_scale: of the noises.
        start: logarithms to begin with.
    """
    logs = start
    for _ in range(_ITERATIONS):
        behind, here, ahead = by_scale(logs[:, None] + _STEP * np.array([-1.0, 0.0, 1.0])).T
        slope, curvature = (ahead - behind) / (2 * _STEP), (ahead - 2 * here + behind) / _STEP**2
        # Far above the best factor the likelihood is straight, and Newton's step has no meaning.
        straight = np.where(curvature > 0, curvature, np.abs(slope) / _LONGEST + 1e-300)
        step = np.clip(-slope / straight, -_LONGEST, _LONGEST)
        before, logs = logs, np.clip(logs + step, start - _FURTHEST, start + _FURTHEST)
        if np.all(np.abs(logs - before) < _ENOUGH):
            break
    return logs, by_scale(logs[:, None])[:, 0]


def scaled(problem: Restricted, key: str, noise: ChannelNoise) -> ChannelNoise:
    """The noise times the factor that makes the likelihood largest."""
    logs, _ = best_scales(problem.by_scale(key, [noise]), np.zeros(1))
    return noise.times(float(np.exp(logs[0])))
