"""Standard errors that do not trust the noise model."""

from collections.abc import Mapping, Sequence

import numpy as np

from .._typing import Float
from ._model import ChannelNoise
from ._restricted import Cells
from ._segment import gains


def score_covariance(
    cells: Sequence[Cells],
    noise: Mapping[str, ChannelNoise],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """Covariance of estimates from the scores that the whitened residuals have.

    The sandwich of Newey and West (1987): scores of neighbouring cells of a channel may go
    together, over about 4 (n / 100)^(2/9) cells. Where it differs much from `covariance`, the
    noise is not what the model of it says.

    Arguments:
        cells: all parameters as `shared` columns.
        noise: of each key.
        covariance: by the noise model, shape (parameter, parameter).

    Returns:
        Of the shape of `covariance`.
    """
    meat = np.zeros_like(covariance)
    count = 0
    for each in cells:
        columns = np.concatenate([each.shared, each.residual[:, None]], axis=1)
        white = whitened(noise[each.key], each.times, columns, each.weights)
        scores = white[:, :-1] * white[:, -1:]
        count += len(scores)
        lags = min(int(4 * (len(scores) / 100) ** (2 / 9)), len(scores) - 1)
        meat += scores.T @ scores
        for lag in range(1, (lags if each.times is not None else 0) + 1):
            across = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (lags + 1)) * (across + across.T)
    size = len(covariance)
    return covariance @ meat @ covariance * count / max(count - size, 1)


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
