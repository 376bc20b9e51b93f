"""A fit from several starts: long motions have optima that lead nowhere."""

import contextlib
import dataclasses
import functools
import threading
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import NamedTuple, Unpack

from ..fitting import (
    Budget,
    FitJournal,
    FitResult,
    Iteration,
    Seconds,
    Setup,
    Start,
    check_effect,
    set_up,
    solve,
)
from ..models import AbstractModel
from ..recordings import FIT_DEFAULTS, FitSettings, Run, StartsKeywords, fit_settings
from ..runtime.parallel import Tell
from ..runtime.process import cores
from ..runtime.text import InputError, keywords_listed
from ._refit import end_values
from ._starts import (
    End,
    by_executor,
    earlier_starts,
    end_of,
    in_order,
    in_threads,
    inside_bounds,
    interrupted,
    misfit,
    start_values,
    with_tolerance_of,
)

# An end whose misfit is this much above the best one, per measured value, is another optimum.
SAME_END = 1e-3

_APART = 1.0  # and so is one that is this many standard errors away


class DistinctOptimum(NamedTuple):
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


def distinct_optima(result: FitResult) -> list[DistinctOptimum]:
    """The optima that the starts of a result converged to, the best first.

    Two ends are of one optimum where they describe the data as well as each other and no parameter
    that is determined differs by more than its standard error. Of one start there is none.
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

    def optimum(start: Start, reached: int) -> DistinctOptimum:
        worse = (start.misfit or 0.0) - best
        is_result = worse < SAME_END * values and _is_same(result, start, here)
        return DistinctOptimum(max(worse, 0.0), reached, start.parameters or {}, is_result)

    return [optimum(*each) for each in found]


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


STARTS = 8
"""Starts of `multi_start`, by default."""


@keywords_listed(FIT_DEFAULTS | {"starts": STARTS})
def multi_start(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    settings: FitSettings | None = None,
    *,
    progress: Callable[[Iteration], None] | None = None,
    announce: Callable[[int, Mapping[str, float]], None] | None = None,
    check: bool = True,
    before: FitResult | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    **keywords: Unpack[StartsKeywords],
) -> FitResult:
    """Fit from several starts, and return the best end.

    The first start is the one that a fit has; the others fill the room around it evenly (a Sobol
    sequence). A parameter with a prior begins where that says; one with two bounds of this fit
    between them; any other is changed by a factor between 1 / (1 + spread) and 1 + spread, or
    where it has no sign by up to `spread` times its size. Ends are compared by
    the misfit, which is the logarithm of the likelihood: a cost alone means nothing where each fit
    estimates its own noise.

    Arguments:
        model, runs, settings, progress, check: as of `giajax.fit`; a budget is that of all starts.
        starts: how many (8); 1 is `giajax.fit`.
        spread: relative distance of the other starts (0.3).
        seed: of the other starts (0).
        **keywords: these three, and those of `giajax.fit`, in place of `settings`.
        announce: called before each fit with its number, from 1, and its start. Of fits side by
            side the later ones are reported, with their steps, when the earlier ones have ended.
        before: a result of the same fit from fewer starts, which are not fitted again.
        executor: who fits the starts after the first that converges, each a task
            (`giajax.runtime.execution.run_tasks`), and is reported once it has ended; by default
            threads of this process.
        folder: of a file for each of these tasks, by which the same call goes on.

    Returns:
        The best result, so far after Ctrl-C; `result.starts` has where each start ended. The first
        one must be evaluable.
    """
    settings = fit_settings(keywords, settings=settings)
    if "starts" not in settings.model_fields_set:
        settings = settings.model_copy(update={"starts": STARTS})
    check_effect(settings, StartsKeywords, "giajax.multi_start")
    return solve_from_starts(
        set_up(model, runs, settings),
        progress=progress,
        announce=announce,
        check=check,
        before=before,
        executor=executor,
        folder=folder,
    )


def solve_from_starts(
    setup: Setup,
    *,
    progress: Callable[[Iteration], None] | None = None,
    announce: Callable[[int, Mapping[str, float]], None] | None = None,
    check: bool = True,
    journal: Callable[[int], FitJournal] | None = None,
    before: FitResult | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
) -> FitResult:
    """Fit what `giajax.fitting.set_up` resolved from several starts; else as `multi_start`.

    The journal is that of each fit, by its number: the starts from 1, then the one that checks the
    result. A start that has ended there is evaluated where it ended.
    """
    setup, settings = setup.at_start(), setup.settings
    starts, values = settings.starts, start_values(setup)
    budget = None if settings.budget_s is None else Budget(settings.budget_s)
    # What is wrong is refused before the first start, not after it.
    if executor is not None and settings.optimiser is not None:
        raise InputError(
            "parallel workers support only giajax's own optimiser: omit the executor or the "
            "optimiser"
        )
    count, spent = cores(), threading.Event()

    def one(number: int, earlier: Sequence[FitResult], tell: Tell) -> End | None:
        """How a start ends; None where there is no time left for it."""
        start = values[number - 1]
        if budget is not None and number > 1 and (spent.is_set() or not budget.left() > 0):
            return None
        try:
            if announce is not None:
                tell(announce, number, start)
            result = solve(
                with_tolerance_of(setup.started_at(start), earlier),
                # Also where nobody listens: what a start tells is where it is stopped.
                progress=functools.partial(tell, progress or (lambda _: None)),
                check=False,
                budget=budget,
                journal=None if journal is None else journal(number),
            )
        except InputError as error:
            if number == 1:
                raise
            return Start(start, "failed", message=str(error)), None
        except KeyboardInterrupt:
            # Nothing of this start was evaluated.
            return Start(start, "interrupted"), None
        if result.reason == "budget":
            # What is left of it is too little for a step of any start.
            spent.set()
        return end_of(start, result), result

    earlier = [] if before is None else earlier_starts(before, setup, values)
    known: list[End] = [(start, None) for start in earlier]
    fitted = [before] if before is not None and before.status == "converged" else []
    if executor is None:
        others = in_threads(one, count)
    else:
        others = by_executor(setup, values, executor, folder, budget, announce, progress, spent.set)
    ended = in_order(one, others, starts, known, fitted)
    ends = [start for start, _ in ended]
    results = [*fitted, *(result for _, result in ended if result is not None)]
    if not results:
        raise KeyboardInterrupt
    best = min(results, key=misfit)
    seconds = Seconds(
        compile=sum(result.seconds.compile for result in results),
        run=sum(result.seconds.run for result in results),
    )
    stopped = any(end.status == "interrupted" for end in ends)
    if stopped and best.status == "converged":
        best = interrupted(best, f"at start {len(ends)} of {starts}")
    late = spent.is_set() or (len(ends) < starts and not stopped)
    if budget is not None and late and budget.ended_it not in best.message:
        message = f"{best.message}; {budget.ended_it} after {len(ends)} of {starts} starts"
        best = dataclasses.replace(best, status="not_converged", message=message, reason="budget")
    # Of a result that was loaded, the predictions are missing, and the verdict on held-out data.
    bare = best is before or (executor is not None and not best.predictions)
    if (check or bare) and best.status == "converged":
        last = None if journal is None else journal(starts + 1)
        best = _checked(setup, best, progress, budget, last)
    if executor is not None and not best.predictions:
        best = dataclasses.replace(best, predictions=tuple(map(best.predict, setup.runs)))
    drawn = {"starts": starts, "spread": settings.spread, "seed": settings.seed}
    config = {**best.config, **drawn}
    return dataclasses.replace(best, starts=tuple(ends), config=config, seconds=seconds)


def _checked(
    setup: Setup,
    best: FitResult,
    progress: Callable[[Iteration], None] | None,
    budget: Budget | None,
    journal: FitJournal | None,
) -> FitResult:
    """The best end fitted again from where it is, with the checks that were left out before."""
    status = "interrupted"
    with contextlib.suppress(KeyboardInterrupt):
        inside = with_tolerance_of(setup.started_at(inside_bounds(setup, end_values(best))), [best])
        again = solve(inside, progress=progress, budget=budget, journal=journal)
        status = again.status
    if status == "interrupted":
        return interrupted(best, "before its result was checked")
    if status != "converged":
        return best
    return dataclasses.replace(
        again, message=best.message, iterations=best.iterations, history=best.history
    )
