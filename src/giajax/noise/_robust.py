"""Noise among outliers: its size by the median, and the weight that each cell keeps."""

import dataclasses

import numpy as np

from .._typing import Float
from ._cells import Cells
from ._model import ChannelNoise
from ._segment import solve

# 1.4826 median(|x|) estimates the standard deviation of a normal variable.
MAD = 1.4826

_ROUNDS = 20

# The white part that tells an outlier from a jump of the correlated part, at least.
_LEAST_WHITE = 0.1


def robust_deviation(residuals: Float[np.ndarray, " cell"]) -> float:
    """Standard deviation of normal noise with some outliers; never 0.

    Arguments:
        residuals: of a fit, shape (cell,).
    """
    size = np.abs(np.asarray(residuals, dtype=float))
    # Never zero: data without noise would weigh infinitely.
    return max(MAD * float(np.median(size)), 1e-12 * float(np.max(size, initial=0.0)), 1e-300)


def outlier_weights(cells: Cells, noise: ChannelNoise) -> Float[np.ndarray, " cell"]:
    """Huber's weights of the white part of each cell, one for what is within the noise.

    They minimise the sum of Huber's loss of the white part and of the square of the correlated
    one: an outlier is no memory, so it is not foretold by its neighbours and does not foretell
    them (iteratively reweighted least squares; Huber 1981, section 7.8).

    Arguments:
        cells: residuals of one channel of a run.
        noise: of the channel.

    Returns:
        Weights above 0 and up to 1; the white variance of a cell is divided by its weight.
    """
    white = max(noise.white, _LEAST_WHITE * noise.deviation)
    noise = dataclasses.replace(noise, white=white)
    weights = np.ones(len(cells.residual))
    for _ in range(_ROUNDS):
        solved = solve(noise, cells.times, weights, cells.residual[:, None]).columns[:, 0]
        # V^-1 e times the white variance is the white part of e.
        own = np.abs(white**2 / weights * solved) / white
        after = 1 / np.maximum(own, 1.0)
        done = np.max(np.abs(after - weights), initial=0.0) < 1e-3
        weights = after
        if done:
            break
    return weights
