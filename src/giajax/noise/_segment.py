"""The covariance of consecutive samples of a channel, whose inverse costs a pass over them.

The precision of an Ornstein-Uhlenbeck process at any instants is tridiagonal (Rue and Held,
"Gaussian Markov Random Fields", 2005, section 1.2.1). With T that of unit variance, the covariance
of white noise of deviations w and a correlated part of variance c is V = diag(w^2) + c T^-1, and

    V^-1 = (c + w^2 T)^-1 T,    log|V| = log|c + w^2 T| - log|T|.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from .._typing import Float
from ._model import ChannelNoise

# Neighbours that are closer than this part of the correlation time are told apart no more.
_CLOSEST = 1e-9


class Solved(NamedTuple):
    """V^-1 times the columns that were given, and log|V|."""

    columns: Float[np.ndarray, "sample column"]
    log_determinant: float


def solve(
    noise: ChannelNoise,
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, " sample"],
    columns: Float[np.ndarray, "sample column"],
) -> Solved:
    """V^-1 X and log|V| of the noise at some instants.

    Arguments:
        noise: of the channel.
        times: of the measured cells, s, increasing; None where the samples have no time, and so
            no memory.
        weights: of the cells, 0 to 1: the white variance of each is divided by it.
        columns: X.

    Returns:
        Both, in the order of the cells.
    """
    variance = noise.white**2 / weights
    # A single cell has no neighbour; LAPACK takes no matrix without an off-diagonal.
    if times is None or noise.is_white or len(times) < 2:
        total = variance + noise.correlated**2
        return Solved(columns / total[:, None], float(np.sum(np.log(total))))
    diagonal, off, log_t = precision(times, noise.time_s)
    # With the weights' square roots on both sides the matrix is symmetric, and LAPACK's factors of
    # a tridiagonal one do: for a few hundred samples SciPy's functions take longer than they.
    root = np.sqrt(weights)
    diagonal, off = diagonal / weights, off / (root[:-1] * root[1:])
    # A row for each column of X: what is next to each other in time is so in memory.
    rows = np.ascontiguousarray(columns.T) * root
    along = diagonal * rows
    along[:, 1:] += off * rows[:, :-1]
    along[:, :-1] += off * rows[:, 1:]
    pivots, factors, _ = dpttrf(
        noise.correlated**2 + noise.white**2 * diagonal, noise.white**2 * off, 1, 1
    )
    solved, _ = dpttrs(pivots, factors, along.T, 1)
    return Solved(solved * root[:, None], float(np.sum(np.log(pivots))) - log_t)


def precision(
    times: Float[np.ndarray, " sample"], time_s: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """T, the precision of an Ornstein-Uhlenbeck process of unit variance, and log|T|.

    Arguments:
        times: increasing, s.
        time_s: correlation time, s.

    Returns:
        Its diagonal, its first off-diagonal, and the logarithm of its determinant.
    """
    apart = np.maximum(np.diff(times) / time_s, _CLOSEST)
    decay = np.exp(-apart)
    fresh = -np.expm1(-2 * apart)
    diagonal = np.ones(len(times))
    diagonal[:-1] += decay**2 / fresh
    diagonal[1:] += decay**2 / fresh
    return diagonal, -decay / fresh, -float(np.sum(np.log(fresh)))


def gains(
    noise: ChannelNoise,
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, " sample"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a pass forward over the samples needs to make the noise white (a Kalman filter).

    With m the part of a cell's noise that the cells before it foretell, the cell less m has the
    deviation that is returned, independent of all before, and m goes on by

        m <- keep m + gain (cell - m).

    The deviations are those of the innovations: the product of their squares is |V|.

    Arguments:
        noise: of the channel.
        times: of all samples, s, increasing; None where they have no time.
        weights: of the cells; 0 where a cell is not measured.

    Returns:
        keep, gain and deviation, each of shape (sample,).
    """
    count = len(weights)
    measured = weights > 0
    white = noise.white**2 / np.where(measured, weights, 1.0)
    if times is None or noise.is_white:
        zeros = np.zeros(count)
        return zeros, zeros.copy(), np.sqrt(white + noise.correlated**2)
    power = noise.correlated**2
    decay = np.append(np.exp(-np.diff(times) / noise.time_s), 0.0)
    share, innovation = np.zeros(count), np.empty(count)
    variance = power
    for i in range(count):
        total = variance + white[i]
        innovation[i] = total
        if measured[i]:
            share[i] = variance / total
            variance *= white[i] / total
        variance = decay[i] ** 2 * variance + (1 - decay[i] ** 2) * power
    return decay, decay * share, np.sqrt(innovation)


def whitened(
    noise: ChannelNoise,
    times: Float[np.ndarray, " cell"] | None,
    columns: Float[np.ndarray, "cell column"],
    weights: Float[np.ndarray, " cell"] | None = None,
) -> Float[np.ndarray, "cell column"]:
    """Columns over the cells of a channel, made independent and of unit variance.

    Arguments:
        noise: of the channel.
        times: of the cells, s; None for a run without time.
        columns: in the unit of the channel.
        weights: of the cells, all 1 by default.
    """
    weights = np.ones(len(columns)) if weights is None else weights
    keep, gain, deviation = gains(noise, times, weights)
    if not np.any(gain):
        return columns / deviation[:, None]
    result = np.empty_like(columns)
    memory = np.zeros(columns.shape[1])
    for i, row in enumerate(columns):
        fresh = row - memory
        result[i] = fresh / deviation[i]
        memory = keep[i] * memory + gain[i] * fresh
    return result
