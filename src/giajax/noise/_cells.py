"""The cells of a channel with their derivatives: what the noise is estimated from."""

import dataclasses
import functools
from typing import Self

import numpy as np

from .._typing import Bool, Float
from ._model import ChannelNoise
from ._segment import solve


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
