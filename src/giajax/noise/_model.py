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
