"""Standard errors that do not trust the noise model."""

from collections.abc import Mapping, Sequence

import numpy as np

from .._typing import Float
from ._cells import Cells
from ._model import ChannelNoise
from ._segment import whitened


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
