"""The cells of a channel with their derivatives: what the noise is estimated from."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Self

import numpy as np

from .._typing import Bool, Float
from ._model import ChannelNoise
from ._segment import solve

# Numbers that are passed over together, at most: what is near the processor.
_TOGETHER = 2**17


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

    @functools.cached_property
    def instants(self) -> tuple[bytes, bytes]:
        """Cells of the same ones have the same times and weights, whatever they measure."""
        return b"" if self.times is None else self.times.tobytes(), self.weights.tobytes()


def grams(cells: Sequence[Cells], noise: ChannelNoise) -> list[tuple[np.ndarray, float]]:
    """`Cells.gram` of each; those at the same instants go through their samples together."""
    results: dict[int, tuple[np.ndarray, float]] = {}
    for at in _batches(cells):
        first = cells[at[0]]
        columns = [cells[i]._columns for i in at]
        solved = solve(noise, first.times, first.weights, np.hstack(columns))
        ends = np.cumsum([each.shape[1] for each in columns])[:-1]
        for i, of_cells, one in zip(at, columns, np.hsplit(solved.columns, ends), strict=True):
            results[i] = of_cells.T @ one, solved.log_determinant
    return [results[i] for i in range(len(cells))]


def _batches(cells: Sequence[Cells]) -> list[list[int]]:
    """Positions of cells at the same instants, of no more numbers than go together."""
    batches: list[list[int]] = []
    open_ones: dict[tuple[bytes, bytes], tuple[list[int], int]] = {}
    for i, each in enumerate(cells):
        batch, size = open_ones.get(each.instants, ([], 0))
        # A channel may have no cells at all.
        if not batch or size + each._columns.size > _TOGETHER:
            batch, size = [], 0
            batches.append(batch)
        batch.append(i)
        open_ones[each.instants] = batch, size + each._columns.size
    return batches
