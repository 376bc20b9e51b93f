"""Fewer points than were recorded, without losing the ones that stick out."""

import itertools
from collections.abc import Sequence

import numpy as np

from ..._typing import Float, Int


def thinned(columns: Sequence[Float[np.ndarray, " sample"]], most: int) -> Int[np.ndarray, " kept"]:
    """Which samples to draw, so that no extreme of any column is lost.

    The samples are cut into equal spans. Of each the first one stays, and where each column is
    least and greatest: a single outlier among a million values is drawn.

    Arguments:
        columns: of equal length; NaN where not measured.
        most: about how many samples to keep.

    Returns:
        Their numbers, ascending; all of them where there are no more than `most`.
    """
    count = len(columns[0])
    if count <= most:
        return np.arange(count)
    spans = max(most // (2 * len(columns) + 1), 1)
    edges = np.linspace(0, count, spans + 1).astype(int)
    kept = set(edges[:-1].tolist()) | {count - 1}
    for column in columns:
        low = np.where(np.isnan(column), np.inf, column)
        high = np.where(np.isnan(column), -np.inf, column)
        for start, end in itertools.pairwise(edges.tolist()):
            kept.add(start + int(np.argmin(low[start:end])))
            kept.add(start + int(np.argmax(high[start:end])))
    return np.array(sorted(kept))
