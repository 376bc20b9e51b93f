"""The residuals of one channel of one run, as a verdict looks at them."""

import dataclasses
from typing import Self

import numpy as np

from .._typing import Bool, Float
from ..noise import ChannelNoise, whitened

# Of the cells, for the variance of white noise by their second differences: 18 / 35, because these
# have the autocorrelations 1, -2/3 and 1/6.
DIFFERENCES = 18 / 35

# Deviations beyond which a cell is an outlier, for a loss that lets outliers stand.
OUTLIER = 3.0

# Second differences tell noise from motion where so many of them are there.
_FEW = 16


@dataclasses.dataclass(frozen=True)
class Series:
    """The residuals of one channel of one run.

    Attributes:
        run: name of the run.
        channel: name of the channel.
        residual: predicted minus recorded where measured, SI, shape (cell,).
        times: of these cells, s; None for a run without time.
        stated: noise that the run states; None where it states none.
        key: cells of the same key have the same noise.
        adopted: deviation of the noise that the fit adopted for a cell, SI.
        lost: degrees of freedom that the fit took from it.
    """

    run: str
    channel: str
    residual: Float[np.ndarray, " cell"]
    times: Float[np.ndarray, " cell"] | None
    stated: ChannelNoise | None
    key: str
    adopted: float
    lost: float

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def freedom(self) -> float:
        """Degrees of freedom."""
        return max(len(self) - self.lost, 1.0)

    @property
    def white(self) -> float:
        """Deviation of what differs from cell to cell: stated, or more by second differences."""
        stated = 0.0 if self.stated is None else self.stated.deviation
        return max(stated, self.from_differences)

    @property
    def white_freedom(self) -> float:
        """Degrees of freedom of `white`; infinite where it is stated."""
        known = self.stated is not None and self.stated.deviation >= self.from_differences
        return np.inf if known else DIFFERENCES * len(self)

    @property
    def from_differences(self) -> float:
        """Deviation of white noise by the second differences of the residuals.

        Their mean square is 6 times its variance (`giajax.noise.from_differences`), and knows it
        as well as `DIFFERENCES` times as many independent cells would.
        """
        if len(self) < _FEW:
            return self.adopted
        # Residuals without any difference are those of a perfect description.
        return float(np.sqrt(np.mean(np.diff(self.residual, 2) ** 2) / 6)) or self.adopted

    def without_outliers(self, limit: float) -> Self:
        """The cells within so many deviations of the noise that was adopted."""
        return self.where(np.abs(self.residual) <= limit * self.adopted)

    def where(self, kept: Bool[np.ndarray, " cell"]) -> Self:
        """Some of the cells."""
        times = None if self.times is None else self.times[kept]
        return dataclasses.replace(self, residual=self.residual[kept], times=times)

    def known_memory_removed(self) -> Self:
        """The residuals made independent by the correlation that the run states, if it does."""
        if self.stated is None or self.stated.is_white:
            return self
        white = whitened(self.stated, self.times, self.residual[:, None])[:, 0]
        unit = ChannelNoise(1.0)
        return dataclasses.replace(self, residual=white, stated=unit, adopted=1.0)
