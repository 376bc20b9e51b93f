"""Whether chains have mixed: R-hat and effective sample sizes.

Rank-normalised and split, after Vehtari, Gelman, Simpson, Carpenter and Buerkner,
"Rank-normalization, folding, and localization", Bayesian Analysis 16 (2021), doi 10.1214/20-BA1221.
"""

from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from .._typing import Float

Draws = Float[np.ndarray, "chain draw"]

# Fewer draws of a half of a chain than this say nothing.
_LEAST = 4

_TAILS = (0.05, 0.95)


class Mixing(NamedTuple):
    """How well chains have mixed; NaN where all draws are equal or there are too few.

    Attributes:
        r_hat: 1 where chains agree with each other, and their halves too; above where not.
        ess_bulk: how many independent draws the mean is worth.
        ess_tail: how many the ends of an interval are worth: the less of both.
    """

    r_hat: float
    ess_bulk: float
    ess_tail: float


def mixing(draws: Draws) -> Mixing:
    """How well the chains of one parameter have mixed.

    Arguments:
        draws: shape (chain, draw).
    """
    halves = _halves(draws)
    if halves.shape[1] < _LEAST or np.all(halves == halves[0, 0]):
        return Mixing(np.nan, np.nan, np.nan)
    folded = np.abs(halves - np.median(halves))
    ends = np.quantile(draws, _TAILS)
    tails = [effective_size((halves <= end).astype(float)) for end in ends]
    return Mixing(
        r_hat=max(_r_hat(_normal_scores(halves)), _r_hat(_normal_scores(folded))),
        ess_bulk=effective_size(_normal_scores(halves)),
        ess_tail=min(tails),
    )


def _halves(draws: Draws) -> Draws:
    half = draws.shape[1] // 2
    return np.concatenate([draws[:, :half], draws[:, draws.shape[1] - half :]])


def _normal_scores(draws: Draws) -> Draws:
    # Slow to import, and asked for by posteriors alone.
    from scipy.stats import rankdata

    ranks = rankdata(draws, method="average").reshape(draws.shape)
    return np.asarray(ndtri((ranks - 3 / 8) / (draws.size + 1 / 4)))


def _r_hat(draws: Draws) -> float:
    count = draws.shape[1]
    within = np.mean(np.var(draws, axis=1, ddof=1))
    if within == 0:
        return float("nan")
    between = count * np.var(np.mean(draws, axis=1), ddof=1)
    return float(np.sqrt((between / within + count - 1) / count))


def effective_size(draws: Draws) -> float:
    """How many independent draws the mean of correlated ones is worth (equations 10 to 13).

    Autocorrelations are added up in pairs as long as these are positive, and none counts more than
    the one before it (Geyer's initial monotone sequence).

    Arguments:
        draws: shape (chain, draw).
    """
    chains, count = draws.shape
    covariance = _autocovariance(draws)
    within = np.mean(covariance[:, 0]) * count / (count - 1)
    pooled = within * (count - 1) / count
    if chains > 1:
        pooled += np.var(np.mean(draws, axis=1), ddof=1)
    if pooled == 0:
        return float("nan")
    correlation = 1 - (within - np.mean(covariance, axis=0) * count / (count - 1)) / pooled
    correlation[0] = 1.0
    even = count - count % 2
    pairs = correlation[:even:2] + correlation[1:even:2]
    positive = int(np.argmax(pairs < 0)) if np.any(pairs < 0) else len(pairs)
    kept = np.minimum.accumulate(pairs[:positive])
    time = -1 + 2 * np.sum(kept)
    if positive < len(pairs):
        # Of the first pair that is left out, its even part, where that is positive.
        time += max(correlation[2 * positive], 0.0)
    size = chains * count
    # Draws that are worth more than independent ones: at most by the logarithm of their number.
    return float(size / max(time, 1 / np.log10(size)))


def _autocovariance(draws: Draws) -> Draws:
    """Of each chain at each lag, over the number of draws."""
    count = draws.shape[1]
    centred = draws - np.mean(draws, axis=1, keepdims=True)
    power = np.abs(np.fft.rfft(centred, 2 * count, axis=1)) ** 2
    return np.fft.irfft(power, axis=1)[:, :count] / count
