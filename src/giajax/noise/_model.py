"""White noise plus noise with a memory, of one channel."""

import dataclasses
import math
from typing import Self


@dataclasses.dataclass(frozen=True)
class ChannelNoise:
    """What each cell of a channel is off by: a part of its own, and one that it shares.

    The second part is an Ornstein-Uhlenbeck process, the continuous-time AR(1): a normal variable
    whose correlation between two instants is exp(-|dt| / time_s), so that uneven samples and gaps
    are treated as they are.

    Attributes:
        white: standard deviation of the part that differs from cell to cell, SI.
        correlated: standard deviation of the part with a memory, SI.
        time_s: its correlation time, s; 0 where there is no such part.
    """

    white: float
    correlated: float = 0.0
    time_s: float = 0.0

    @classmethod
    def of_cell(cls, deviation: float, correlated: float, time_s: float) -> Self:
        """The noise whose two parts together are that of a cell.

        Arguments:
            deviation: standard deviation of a cell, SI.
            correlated: of the part with a memory; 0 where there is none.
            time_s: its correlation time, s.
        """
        white = math.sqrt(max(deviation**2 - correlated**2, 0.0))
        return cls(white, correlated, time_s if correlated else 0.0)

    @property
    def deviation(self) -> float:
        """Standard deviation of a cell, both parts together, SI."""
        return math.hypot(self.white, self.correlated)

    @property
    def is_white(self) -> bool:
        """Whether no part has a memory."""
        return self.correlated == 0

    def times(self, factor: float) -> Self:
        """The same noise, a number of times as large."""
        return dataclasses.replace(
            self, white=self.white * factor, correlated=self.correlated * factor
        )


@dataclasses.dataclass(frozen=True)
class Stated:
    """What is known of the noise of a key beforehand.

    Attributes:
        deviation: of a cell, SI; None where nothing is.
        correlated: of the part with a memory; None where nothing is.
        time_s: its correlation time, s.
    """

    deviation: float | None = None
    correlated: float | None = None
    time_s: float = 0.0

    @property
    def noise(self) -> ChannelNoise | None:
        """The noise as it is stated; None where its size is not."""
        return self.noise_of(memory=True)

    def noise_of(self, *, memory: bool) -> ChannelNoise | None:
        """The noise as it is stated, or as white as it is large; None where its size is not."""
        if self.deviation is None:
            return None
        return ChannelNoise.of_cell(
            self.deviation, (self.correlated or 0.0) if memory else 0.0, self.time_s
        )
