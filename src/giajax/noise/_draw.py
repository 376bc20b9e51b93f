"""Noise drawn from its model, at the instants of a recording."""

from collections.abc import Sequence

import numpy as np

from .._typing import Float
from ._model import ChannelNoise

# Cells that robust statistics left no weight, or hardly any, are this many deviations wide.
_LEAST_WEIGHT = 1e-2


def drawn(
    noises: Sequence[ChannelNoise],
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, "sample channel"],
    random: np.random.Generator,
) -> Float[np.ndarray, "sample channel"]:
    """Noise of some channels of a run: white, and with a memory that goes on through gaps.

    The part with a memory is exact for any spacing of the samples.

    Arguments:
        noises: of the channels.
        times: of all samples, s; None where they have none, and so no memory.
        weights: of the cells, 1 but for outliers, whose white part is wider by their root; a cell
            that is not measured has noise, too.
        random: draws it.

    Returns:
        SI.
    """
    count = len(weights)
    white = np.asarray([noise.white for noise in noises])
    noise = white * random.standard_normal((count, len(noises)))
    noise /= np.sqrt(np.clip(weights, _LEAST_WEIGHT, 1.0))
    correlated = np.asarray([noise.correlated for noise in noises])
    if not np.any(correlated):
        return noise
    kicks = random.standard_normal((count, len(noises)))
    if times is None:
        return noise + correlated * kicks
    lengths = np.asarray([noise.time_s or 1.0 for noise in noises])
    keep = np.exp(-np.diff(times)[:, None] / lengths)
    fresh = np.sqrt(-np.expm1(-2 * np.diff(times)[:, None] / lengths))
    memory = kicks
    for row in range(1, count):
        memory[row] = keep[row - 1] * memory[row - 1] + fresh[row - 1] * kicks[row]
    return noise + correlated * memory
