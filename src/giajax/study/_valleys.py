"""The optima that several starts have found, and what became of the other starts."""

from collections import Counter
from collections.abc import Mapping
from typing import NamedTuple

from ..fitting import FitResult, Start
from ._ends import end_values, misfit

# An end whose misfit is this much above the best one, per measured value, is another valley.
SAME_END = 1e-3

# And so is one that is this many standard errors away.
_APART = 1.0


class Valley(NamedTuple):
    """An optimum, and the starts that reached it.

    Attributes:
        worse: its misfit above that of the result, in log-likelihood.
        reached: how many starts.
        values: of the free parameters, by path, SI, where the best of them ended.
        is_result: whether it is where the result is.
    """

    worse: float
    reached: int
    values: Mapping[str, float]
    is_result: bool


def valleys(result: FitResult) -> list[Valley]:
    """The optima that the starts of a result converged to, the best first.

    Two ends are of one optimum where they describe the data as well as each other and no parameter
    that is determined differs by more than its standard error.

    Arguments:
        result: of `multi_start`; of one start there is none.
    """
    best = misfit(result)
    values = sum(channel.n for run in result.runs for channel in run.channels.values())
    found: list[tuple[Start, int]] = []
    ended = [start for start in result.starts if start.status == "converged"]
    for start in sorted(ended, key=lambda start: start.misfit or 0.0):
        for place, (other, reached) in enumerate(found):
            near = (start.misfit or 0.0) - (other.misfit or 0.0) < SAME_END * values
            if near and _is_same(result, start, other):
                found[place] = other, reached + 1
                break
        else:
            found.append((start, 1))
    here = Start({}, result.status, best, end_values(result))

    def valley(start: Start, reached: int) -> Valley:
        worse = (start.misfit or 0.0) - best
        is_result = worse < SAME_END * values and _is_same(result, start, here)
        return Valley(max(worse, 0.0), reached, start.parameters or {}, is_result)

    return [valley(*each) for each in found]


def lost_starts(result: FitResult) -> dict[str, int]:
    """How many starts did not converge, by why, the most frequent first."""
    ended = [start for start in result.starts if start.status != "converged"]
    return dict(Counter(start.message or start.status for start in ended).most_common())


def _is_same(result: FitResult, one: Start, other: Start) -> bool:
    return all(
        abs((one.parameters or {})[path] - (other.parameters or {})[path])
        <= _APART * estimate.standard_error
        for path, estimate in result.free.items()
        if estimate.standard_error is not None
    )
