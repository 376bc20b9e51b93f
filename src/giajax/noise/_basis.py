"""Other columns of the derivatives that span the same, and depend on each other no more."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from .._typing import Float
from ._cells import Cells
from ._model import ChannelNoise

# Column-normalised singular value below which a combination of parameters is not determined.
_COLLINEAR = 1e-6


def conditioned(
    cells: Sequence[Cells],
    noise: Mapping[str, ChannelNoise],
    prior: Float[np.ndarray, "column column"],
) -> tuple[tuple[Cells, ...], np.ndarray]:
    """The cells with other columns that span the same: orthonormal with the given noise and prior.

    Directions that neither cells nor prior respond to are left out; so are own columns that do not
    respond.

    Returns:
        The cells, and the prior by their columns.
    """
    runs = sorted({each.run for each in cells})
    changed = dict(enumerate(cells))
    triangles = []
    for run in runs:
        at = [i for i, each in enumerate(cells) if each.run == run]
        gram = np.sum([cells[i].gram(_marginal(noise[cells[i].key]))[0] for i in at], axis=0)
        width = cells[at[0]].own.shape[1]
        own = orthonormal(gram[:width, :width])
        across = own.T @ gram[:width, width:-1]
        triangles.append(gram[width:-1, width:-1] - across.T @ across)
        for i in at:
            basis = cells[i].own @ own
            changed[i] = dataclasses.replace(
                cells[i], own=basis, shared=cells[i].shared - basis @ across
            )
    shared = orthonormal(np.sum(triangles, axis=0) + prior[:-1, :-1])
    across = shared.T @ prior[:-1, -1:]
    known = np.block([[shared.T @ prior[:-1, :-1] @ shared, across], [across.T, prior[-1:, -1:]]])
    those = (dataclasses.replace(each, shared=each.shared @ shared) for each in changed.values())
    return tuple(those), known


def _marginal(noise: ChannelNoise) -> ChannelNoise:
    return ChannelNoise(noise.deviation)


def orthonormal(gram: np.ndarray) -> np.ndarray:
    """B with B^T gram B = 1, of the directions that count.

    Arguments:
        gram: X^T X of columns of any size, shape (column, column).

    Returns:
        Of shape (column, rank).
    """
    if not len(gram):
        return gram
    norms = np.sqrt(np.maximum(np.diag(gram), 0))
    norms = np.where(norms > 0, norms, np.inf)
    values, vectors = np.linalg.eigh(gram / np.outer(norms, norms))
    kept = values > max(_COLLINEAR**2, 1e-12) * max(values[-1], 1e-300)
    return vectors[:, kept] / np.sqrt(values[kept]) / norms[:, None]
