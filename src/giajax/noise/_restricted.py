"""The restricted likelihood of the noise, given what a fit left over and what it could move.

Parameters that are fitted take with them a part of the noise, most of what is slow: the plain
likelihood takes slow noise for too small. The restricted likelihood (Patterson and Thompson 1971)
is that of all combinations of the cells which no parameter changes. To first order in the
parameters, with V the covariance of the cells, J the Jacobian and e the residuals,

    -2 log L = log|V| + log|J^T V^-1 J| + min_d (e + J d)^T V^-1 (e + J d).

What is known of a parameter before is one more row of residuals, of variance one: what takes part
in both J^T V^-1 J and the minimum. It is then the likelihood of all cells, with the parameter drawn
from its prior: of a parameter that is known well, the plain one.

Runs share some columns of J and have others of their own, which are eliminated run by run.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Self

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from .._typing import Float
from ._cells import Cells
from ._model import ChannelNoise

# Column-normalised singular value below which a combination of parameters is not determined.
_COLLINEAR = 1e-6


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Minus twice the logarithm of the restricted likelihood, as a function of one key's noise.

    Attributes:
        cells: of all channels of all runs, their columns of about the same size and independent.
        noise: of each key.
        grams: of each of `cells`, with that noise.
        prior: X^T X of the rows of priors; X are the shared columns and, last, the residual.
    """

    cells: tuple[Cells, ...]
    noise: Mapping[str, ChannelNoise]
    grams: tuple[tuple[np.ndarray, float], ...]
    prior: Float[np.ndarray, "column column"]

    @classmethod
    def of(
        cls,
        cells: Sequence[Cells],
        noise: Mapping[str, ChannelNoise],
        prior: Float[np.ndarray, "column column"] | None = None,
    ) -> Self:
        """The likelihood of the noise of some cells.

        Arguments:
            cells: of all channels of all runs.
            noise: of each key, to begin with.
            prior: as the attribute, of the columns of `cells`; None where nothing is known.
        """
        if prior is None:
            prior = np.zeros((cells[0].shared.shape[1] + 1,) * 2)
        those, prior = conditioned(cells, noise, prior)
        return cls(those, noise, tuple(each.gram(noise[each.key]) for each in those), prior)

    def with_noise(self, key: str, noise: ChannelNoise) -> Self:
        """The same with another noise of one key."""
        return dataclasses.replace(
            self, noise={**self.noise, key: noise}, grams=self._grams(key, noise)
        )

    def value(self, key: str, noise: ChannelNoise) -> float:
        """-2 log L where the cells of one key have another noise."""
        return self.by_scale(key, noise)(0.0)

    def by_scale(self, key: str, noise: ChannelNoise) -> Callable[[float], float]:
        """-2 log L by the logarithm of a factor of the noise of one key.

        A factor scales a Gram matrix: the samples of the key are passed over once for all of them.
        """
        cells = [each for each in self.cells if each.key == key]
        grams = [each.gram(noise) for each in cells]
        others, known = self._without(key)
        count, own = sum(len(each.residual) for each in cells), sum(log for _, log in grams)
        of_key = _by_run(cells, grams)

        def value(log: float) -> float:
            runs, power = dict(others), float(np.exp(-2 * log))
            for run, (gram, width) in of_key.items():
                before = others.get(run)
                runs[run] = (power * gram if before is None else before[0] + power * gram, width)
            of_runs = [_eliminated(*of_run) for of_run in runs.values()]
            shared = np.sum([rest for rest, _ in of_runs], axis=0) + self.prior
            rest, last = _eliminated(shared, len(shared) - 1)
            determinant = known + own + 2 * log * count + last
            return determinant + sum(each for _, each in of_runs) + float(rest[0, 0])

        return value

    def _without(self, key: str) -> tuple[dict[int, tuple[np.ndarray, int]], float]:
        """Gram matrix of each run and log|V|, of all cells but those of one key."""
        if key not in self._sums:
            pairs = zip(self.cells, self.grams, strict=True)
            others = [pair for pair in pairs if pair[0].key != key]
            runs = _by_run([cells for cells, _ in others], [gram for _, gram in others])
            self._sums[key] = runs, sum(log for _, (_, log) in others)
        return self._sums[key]

    @functools.cached_property
    def _sums(self) -> dict[str, tuple[dict[int, tuple[np.ndarray, int]], float]]:
        return {}

    def _grams(self, key: str, noise: ChannelNoise) -> tuple[tuple[np.ndarray, float], ...]:
        return tuple(
            cells.gram(noise) if cells.key == key else before
            for cells, before in zip(self.cells, self.grams, strict=True)
        )


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


def _by_run(
    cells: Sequence[Cells], grams: Sequence[tuple[np.ndarray, float]]
) -> dict[int, tuple[np.ndarray, int]]:
    """Gram matrix of each run over its channels, and how many of its columns are its own."""
    runs: dict[int, tuple[np.ndarray, int]] = {}
    for each, (gram, _) in zip(cells, grams, strict=True):
        before = runs.get(each.run)
        total = gram if before is None else before[0] + gram
        runs[each.run] = (total, each.own.shape[1])
    return runs


def _eliminated(gram: np.ndarray, width: int) -> tuple[np.ndarray, float]:
    """The Schur complement of the first columns of a Gram matrix, and their log-determinant."""
    if not width:
        return gram, 0.0
    # LAPACK itself: these matrices are so small that the functions around it take longer.
    factor, failed = dpotrf(gram[:width, :width], 1)
    if failed:
        raise np.linalg.LinAlgError("the columns of a run depend on each other")
    across, _ = dtrtrs(factor, gram[:width, width:], 1)
    return gram[width:, width:] - across.T @ across, 2 * float(np.sum(np.log(np.diag(factor))))
