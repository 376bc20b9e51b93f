"""In what order the starts of a fit are begun: up to the first that converges one by one."""

import dataclasses
import functools
from collections.abc import Callable, Sequence

from .._threads import Tell, directly, side_by_side
from ..fitting import FitResult, Setup, Start

End = tuple[Start, FitResult | None]
"""Where a start ended, and its result; None of one that failed or was fitted before."""

One = Callable[[int, Sequence[FitResult], Tell], End | None]
"""How the start of a number ends, after some results; None where there is no time left for it."""

Others = Callable[[Sequence[int], Sequence[FitResult]], list[End]]
"""How several of them end that are begun."""


def in_order(
    one: One, others: Others, starts: int, known: Sequence[End], fitted: Sequence[FitResult]
) -> list[End]:
    """How the starts end that are begun, in their order.

    Those up to the first that converges come one by one: it compiles the programs of the others and
    chooses their tolerance. On one core or on several, each start then has the same numbers.

    Arguments:
        one: fits one of them here.
        others: fits those that are left.
        starts: how many there are.
        known: the first ones, where they were fitted before.
        fitted: their results, as far as there are any.
    """
    ended = list(known)
    while len(ended) < starts and not any(start.status == "converged" for start, _ in ended):
        end = one(len(ended) + 1, (), directly)
        if end is None:
            return ended
        ended.append(end)
        if interrupts(end):
            return ended
    earlier = [*fitted, *(result for _, result in ended if result is not None)]
    left = range(len(ended) + 1, starts + 1)
    return ended + others(left, earlier) if left else ended


def in_threads(one: One, most: int) -> Others:
    """Several starts at once in this process.

    Arguments:
        one: fits one of them.
        most: so many at once.
    """

    def others(numbers: Sequence[int], earlier: Sequence[FitResult]) -> list[End]:
        jobs = [functools.partial(one, number, earlier) for number in numbers]
        ends = side_by_side(jobs, min(most, len(jobs)), until=interrupts)
        return [end for end in ends if end is not None]

    return others


def interrupts(end: End | None) -> bool:
    """Whether the other starts are to be stopped, too; those without time see it themselves."""
    return end is not None and end[0].status == "interrupted"


def as_fine(setup: Setup, ended: Sequence[FitResult]) -> Setup:
    """With the tolerance that a fit of the same data chose: it need not be looked for again."""
    for result in ended:
        # One that did not converge may have made it finer for nothing.
        if result.status == "converged" and result.integration is not None:
            return dataclasses.replace(setup, suited=result.integration.tolerance)
    return setup
