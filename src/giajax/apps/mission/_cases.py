"""Simulation of many missions: frequency and time of success at several wind speeds."""

import dataclasses
import time
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Self, TypeVar

import numpy as np

from ...runtime.parallel import Tell, run_in_threads
from ...runtime.process import cores
from ._mission import Mission, Outcome

Given = TypeVar("Given")
Found = TypeVar("Found")


@dataclasses.dataclass(frozen=True)
class Case:
    """Result of one of many missions.

    Attributes:
        wind: wind speed, m/s.
        seed: seed of the mission.
        reached: time until the tip was inside the opening, s; None if the mission failed.
        reason: reason of the failure; empty if the mission succeeded.
        flattening: largest flattening of a link, m.
        force: largest contact force on a link, N.
        touched: names of the obstacles that the arm touched.
    """

    wind: float
    seed: int
    reached: float | None
    reason: str
    flattening: float
    force: float
    touched: tuple[str, ...]

    @classmethod
    def of(cls, outcome: Outcome, wind: float, seed: int) -> Self:
        """Return the summary of a mission."""
        force = max((each.force for each in outcome.touched), default=0.0)
        touched = tuple(each.obstacle for each in outcome.touched if each.links)
        came = outcome.reached, outcome.reason, outcome.flattening
        return cls(wind, seed, *came, force, touched)


@dataclasses.dataclass(frozen=True)
class Tally:
    """Missions (`cases`) at one wind speed (`wind`, m/s)."""

    wind: float
    cases: tuple[Case, ...]

    @property
    def times(self) -> list[float]:
        """Times until the tip was inside the opening, of the successful missions, s."""
        return [case.reached for case in self.cases if case.reached is not None]

    @property
    def inside(self) -> int:
        """Number of missions in which the tip was inside the opening."""
        return len(self.times)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % interval of the probability of success (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
        count, square, share = len(self.cases), 1.959964**2, self.inside / len(self.cases)
        middle = share + square / (2 * count)
        half = np.sqrt(square * (share * (1 - share) / count + square / (4 * count**2)))
        low, high = ((middle + sign * half) / (1 + square / count) for sign in (-1, 1))
        return max(0.0, float(low)), min(1.0, float(high))

    @property
    def quartiles(self) -> tuple[float, float, float] | None:
        """Quartiles of the times to success, s; None if no mission succeeded."""
        if not self.times:
            return None
        low, middle, high = np.percentile(self.times, [25, 50, 75])
        return float(low), float(middle), float(high)

    @property
    def reasons(self) -> dict[str, int]:
        """Number of failures for each reason, the most frequent first."""
        failed = Counter(case.reason for case in self.cases if case.reached is None)
        return dict(failed.most_common())

    @property
    def touched(self) -> int:
        """Number of missions in which the arm touched an obstacle."""
        return sum(bool(case.touched) for case in self.cases)

    @property
    def flattening(self) -> float:
        """Largest flattening of a link, m."""
        return max(case.flattening for case in self.cases)

    @property
    def force(self) -> float:
        """Largest contact force on a link, N."""
        return max(case.force for case in self.cases)


@dataclasses.dataclass(frozen=True)
class Cases:
    """Results of many missions.

    Attributes:
        cases: results in the order of the wind speeds, then of the seeds.
        seconds: mean computing time of a mission on one core, s.
    """

    cases: tuple[Case, ...]
    seconds: float

    @property
    def tallies(self) -> list[Tally]:
        """Missions grouped by wind speed."""
        winds = dict.fromkeys(case.wind for case in self.cases)
        return [
            Tally(wind, tuple(case for case in self.cases if case.wind == wind)) for wind in winds
        ]


def fly_cases(
    mission: Mission,
    winds: Sequence[float],
    count: int,
    *,
    seed: int = 0,
    on_case: Callable[[int, int], object] | None = None,
) -> Cases:
    """Simulate missions of random arms in random gusts, the same ones for each wind speed.

    Ctrl-C stops the simulation, and the completed missions are returned.

    Arguments:
        mission: nominal mission; `[mission.spread]` gives the spread of the arms about it.
        winds: wind speeds, m/s.
        count: number of missions per wind speed.
        seed: seed of the first mission; each further mission uses the next integer.
        on_case: function that is called after each mission with the completed and the total number.

    Raises:
        InputError: `[mission.spread]` has a parameter that the arm does not have.
    """
    todo = [(wind, seed + place) for wind in winds for place in range(count)]
    mission.case(seed)
    took: list[float] = []

    def fly(given: tuple[float, int]) -> Case:
        wind, number = given
        began = time.perf_counter()
        outcome = mission.in_wind(wind).case(number).fly(number, drawn=mission)
        took.append(time.perf_counter() - began)
        return Case.of(outcome, wind, number)

    cases = flown_on_all_cores(fly, todo, on_case)
    return Cases(cases, float(np.mean(took)) if took else 0.0)


def flown_on_all_cores(
    fly: Callable[[Given], Found],
    todo: Sequence[Given],
    on_case: Callable[[int, int], object] | None,
) -> tuple[Found, ...]:
    """Return the result of each job; after Ctrl-C, only those of the completed jobs."""
    done: list[Found] = []

    def job(given: Given) -> Callable[[Tell], Found | None]:
        def flown(tell: Tell) -> Found | None:
            try:
                found = fly(given)
                done.append(found)
                if on_case is not None:
                    tell(lambda: on_case(len(done), len(todo)))
            except KeyboardInterrupt:
                return None
            return found

        return flown

    jobs = [job(each) for each in todo]
    found = run_in_threads(jobs, cores(), until=lambda each: each is None)
    return tuple(each for each in found if each is not None)
