"""Many missions: how often, and how soon, the opening is reached in how much wind."""

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
    """One of many missions.

    Attributes:
        wind: speed of the air, m/s.
        reached: after so long, s; None: it was not, for the reason.
        flattening: of a link at most, m.
        force: on a link at most, N.
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
        """What came of a mission, in short."""
        force = max((each.force for each in outcome.touched), default=0.0)
        touched = tuple(each.obstacle for each in outcome.touched if each.links)
        came = outcome.reached, outcome.reason, outcome.flattening
        return cls(wind, seed, *came, force, touched)


@dataclasses.dataclass(frozen=True)
class Tally:
    """Missions in air (`wind`) of one speed, m/s."""

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
        """Between which shares success is, with 95 % (Wilson, J. Am. Stat. Assoc. 22, 1927)."""
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
        failed = Counter(case.reason for case in self.cases if case.reached is None)
        return dict(failed.most_common())

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


@dataclasses.dataclass(frozen=True)
class Cases:
    """Many missions.

    Attributes:
        cases: in the order of their winds, then of their seeds.
        seconds: that a case took on a core, on average.
    """

    cases: tuple[Case, ...]
    seconds: float

    @property
    def tallies(self) -> list[Tally]:
        """What they come to, for each speed of the air."""
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
    """Missions of arms and air that are drawn, the same ones for each speed of the air.

    Ctrl-C ends them: those that were flown are returned.

    Arguments:
        mission: as it is drawn; its `[mission.spread]` says how arms differ from that.
        winds: speeds of the air, m/s.
        count: for each of them.
        seed: of the first; each has the next one.
        on_case: told how many there are of how many, after each.

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
    """What comes of each; after Ctrl-C of those that were flown."""
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
