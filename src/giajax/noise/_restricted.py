"""The restricted likelihood of the noise, given what a fit left over and what it could move.

Parameters that are fitted take with them a part of the noise, most of what is slow: the plain
likelihood takes slow noise for too small. The restricted likelihood (Patterson and Thompson 1971)
is that of all combinations of the cells which no parameter changes. To first order in the
parameters, with V the covariance of the cells, J the Jacobian and e the residuals,

    -2 log L = log|V| + log|J^T V^-1 J| + min_d (e + J d)^T V^-1 (e + J d).

Runs share some columns of J and have others of their own, which are eliminated run by run.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Self

import numpy as np
from scipy.linalg.lapack import dpotrf, dtrtrs

from .._typing import Bool, Float
from ._model import ChannelNoise
from ._segment import solve

# Column-normalised singular value below which a combination of parameters is not determined.
_COLLINEAR = 1e-6


@dataclasses.dataclass(frozen=True)
class Cells:
    """The measured cells of one channel of one run.

    Attributes:
        key: of their noise: cells of the same key have the same.
        run: number of the run.
        times: s, increasing, shape (cell,); None for a run without time.
        weights: of the cells, 1 but for outliers (`ChannelNoise.white` is divided by their root).
        residual: predicted minus recorded, SI, shape (cell,).
        shared: its derivatives by the parameters that the runs share, shape (cell, shared).
        own: its derivatives by those of the run, shape (cell, own).
    """

    key: str
    run: int
    times: Float[np.ndarray, " cell"] | None
    weights: Float[np.ndarray, " cell"]
    residual: Float[np.ndarray, " cell"]
    shared: Float[np.ndarray, "cell shared"]
    own: Float[np.ndarray, "cell own"]

    def where(self, kept: Bool[np.ndarray, " cell"]) -> Self:
        """Some of the cells."""
        return dataclasses.replace(
            self,
            times=None if self.times is None else self.times[kept],
            weights=self.weights[kept],
            residual=self.residual[kept],
            shared=self.shared[kept],
            own=self.own[kept],
        )

    def gram(self, noise: ChannelNoise) -> tuple[np.ndarray, float]:
        """X^T V^-1 X of own and shared columns and the residual, in that order; and log|V|."""
        solved = solve(noise, self.times, self.weights, self._columns)
        return self._columns.T @ solved.columns, solved.log_determinant

    @functools.cached_property
    def _columns(self) -> np.ndarray:
        """Own, shared and residual, those of a column side by side in memory."""
        return np.asfortranarray(np.column_stack([self.own, self.shared, self.residual]))


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Minus twice the logarithm of the restricted likelihood, as a function of one key's noise.

    Attributes:
        cells: of all channels of all runs, their columns of about the same size and independent.
        noise: of each key.
        grams: of each of `cells`, with that noise.
    """

    cells: tuple[Cells, ...]
    noise: Mapping[str, ChannelNoise]
    grams: tuple[tuple[np.ndarray, float], ...]

    @classmethod
    def of(cls, cells: Sequence[Cells], noise: Mapping[str, ChannelNoise]) -> Self:
        """The likelihood of the noise of some cells.

        Arguments:
            cells: of all channels of all runs.
            noise: of each key, to begin with.
        """
        known = conditioned(cells, noise)
        return cls(known, noise, tuple(each.gram(noise[each.key]) for each in known))

    def with_noise(self, key: str, noise: ChannelNoise) -> Self:
        """The same with another noise of one key."""
        return dataclasses.replace(
            self, noise={**self.noise, key: noise}, grams=self._grams(key, noise)
        )

    def value(self, key: str, noise: ChannelNoise) -> float:
        """-2 log L where the cells of one key have another noise."""
        return self._value(self._grams(key, noise))

    def by_scale(self, key: str, noise: ChannelNoise) -> Callable[[float], float]:
        """-2 log L by the logarithm of a factor of the noise of one key.

        A factor scales all of a Gram matrix: however many it is asked for, the samples are passed
        over once.
        """
        grams = self._grams(key, noise)

        def value(log: float) -> float:
            power = float(np.exp(-2 * log))
            return self._value(
                tuple(
                    (power * gram, determinant + 2 * log * len(cells.residual))
                    if cells.key == key
                    else (gram, determinant)
                    for cells, (gram, determinant) in zip(self.cells, grams, strict=True)
                )
            )

        return value

    def _value(self, grams: Sequence[tuple[np.ndarray, float]]) -> float:
        determinant = sum(log for _, log in grams)
        of_runs = [_eliminated(*of_run) for of_run in _by_run(self.cells, grams).values()]
        shared = np.sum([rest for rest, _ in of_runs], axis=0)
        rest, log = _eliminated(shared, len(shared) - 1)
        return determinant + sum(log for _, log in of_runs) + log + float(rest[0, 0])

    def _grams(self, key: str, noise: ChannelNoise) -> tuple[tuple[np.ndarray, float], ...]:
        return tuple(
            cells.gram(noise) if cells.key == key else before
            for cells, before in zip(self.cells, self.grams, strict=True)
        )


def conditioned(cells: Sequence[Cells], noise: Mapping[str, ChannelNoise]) -> tuple[Cells, ...]:
    """The cells with other columns that span the same: orthonormal with the given noise.

    Directions that no cell responds to are left out; so are own columns that do not respond.
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
    shared = orthonormal(np.sum(triangles, axis=0))
    return tuple(
        dataclasses.replace(each, shared=each.shared @ shared) for each in changed.values()
    )


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
