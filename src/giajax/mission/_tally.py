"""What missions in air of one speed come to."""

import dataclasses
from collections import Counter

import numpy as np


@dataclasses.dataclass(frozen=True)
class Case:
    """One of many missions.

    Attributes:
        wind: speed of the air, m/s.
        seed: of its arm and its air.
        reached: after so long, s; None: it was not.
        reason: why not.
        flattening: of a link at most, m.
        force: on a link at most, N.
        touched: names of the obstacles.
    """

    wind: float
    seed: int
    reached: float | None
    reason: str
    flattening: float
    force: float
    touched: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Tally:
    """Missions in air of one speed.

    Attributes:
        wind: speed of the air, m/s.
        cases: the missions, at least one.
    """

    wind: float
    cases: tuple[Case, ...]

    @property
    def times(self) -> list[float]:
        """Until the tip was inside, of those in which it was, s."""
        return [case.reached for case in self.cases if case.reached is not None]

    @property
    def inside(self) -> int:
        """In how many the tip was inside."""
        return len(self.times)

    @property
    def interval(self) -> tuple[float, float]:
        """Between which shares that of success is, with 95 %.

        Wilson, J. Am. Stat. Assoc. 22 (1927) 209.
        """
        count, square, share = len(self.cases), 1.959964**2, self.inside / len(self.cases)
        middle = share + square / (2 * count)
        half = np.sqrt(square * (share * (1 - share) / count + square / (4 * count**2)))
        low, high = ((middle + sign * half) / (1 + square / count) for sign in (-1, 1))
        return max(0.0, float(low)), min(1.0, float(high))

    @property
    def quartiles(self) -> tuple[float, float, float] | None:
        """Of the times, s; None where there is none."""
        if not self.times:
            return None
        low, middle, high = np.percentile(self.times, [25, 50, 75])
        return float(low), float(middle), float(high)

    @property
    def reasons(self) -> dict[str, int]:
        """How often it failed for each reason, the most frequent first."""
        return dict(
            Counter(case.reason for case in self.cases if case.reached is None).most_common()
        )

    @property
    def touched(self) -> int:
        """In how many something was touched."""
        return sum(bool(case.touched) for case in self.cases)

    @property
    def flattening(self) -> float:
        """Of any link at most, m."""
        return max(case.flattening for case in self.cases)

    @property
    def force(self) -> float:
        """On any link at most, N."""
        return max(case.force for case in self.cases)
