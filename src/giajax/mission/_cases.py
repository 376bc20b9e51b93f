"""Many missions: how often, and how soon, the opening is reached in how much wind."""

import dataclasses
import time
from collections.abc import Callable, Sequence

import numpy as np

from .._cores import cores
from .._threads import Tell, side_by_side
from ._mission import Mission
from ._tally import Case, Tally


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

    def job(wind: float, number: int) -> Callable[[Tell], Case | None]:
        def fly(tell: Tell) -> Case | None:
            try:
                began = time.perf_counter()
                outcome = mission.in_wind(wind).case(number).fly(number, drawn=mission)
                took.append(time.perf_counter() - began)
                if on_case is not None:
                    tell(lambda: on_case(len(took), len(todo)))
            except KeyboardInterrupt:
                return None
            return Case(
                wind,
                number,
                outcome.reached,
                outcome.reason,
                outcome.flattening,
                max((each.force for each in outcome.touched), default=0.0),
                tuple(each.obstacle for each in outcome.touched if each.links),
            )

        return fly

    jobs = [job(*each) for each in todo]
    flown = side_by_side(jobs, cores(), until=lambda case: case is None)
    cases = tuple(case for case in flown if case is not None)
    return Cases(cases, float(np.mean(took)) if took else 0.0)
