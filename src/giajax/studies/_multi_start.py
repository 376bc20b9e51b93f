"""Fit from several initial guesses, because fits of long motions may end at local optima."""

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

# A fit whose misfit exceeds the best misfit by more than this, per measured value, is at another
# optimum.
SAME_END = 1e-3

# So is a fit with a parameter that differs by more than this many standard errors.
_APART = 1.0


class DistinctOptimum(NamedTuple):
    """An optimum and the starts that reached it.

    Attributes:
        worse: misfit minus the misfit of the result, as a difference of log-likelihoods.
        reached: number of starts that reached it.
        values: values of the free parameters at the best of these ends, by path, SI.
        is_result: whether the result is at this optimum.
    """

    worse: float
    reached: int
    values: Mapping[str, float]
    is_result: bool


def distinct_optima(result: FitResult) -> list[DistinctOptimum]:
    """Return the optima to which the starts of a result converged, the best first.

    Two ends belong to the same optimum if they describe the data equally well and no determined
    parameter differs by more than its standard error. The list is empty for a fit from a single
    start.
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
    """Return the number of starts that did not converge, by reason, the most frequent first."""
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
"""Default number of starts of `multi_start`."""


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
    """Fit from several initial guesses and return the best fit.

    The first start is the initial guess of `giajax.fit`. The others cover the space around it
    evenly (a Sobol sequence). The initial guess of a parameter with a prior is drawn from the
    prior. If this fit has two bounds for a parameter, its initial guess lies between them. Any
    other parameter is multiplied by a factor between 1 / (1 + spread) and 1 + spread, or, if it can
    have either sign, changed by up to `spread` times its magnitude. Fits are compared by their
    misfit, which is minus the log-likelihood. The cost alone cannot be compared, because each fit
    estimates its own noise.

    Arguments:
        model, runs, settings, progress, check: as for `giajax.fit`; a time budget applies to all
            starts together.
        starts: number of starts (8); 1 is equivalent to `giajax.fit`.
        spread: relative spread of the other starts (0.3).
        seed: seed of the other starts (0).
        **keywords: the previous three and the keywords of `giajax.fit`, instead of `settings`.
        announce: function that is called before each fit with its number, from 1, and its initial
            guess. If fits run in parallel, the later ones are reported, with their steps, when the
            earlier ones have ended.
        before: result of the same fit from fewer starts, which are not fitted again.
        executor: executor of the starts after the first that converges; each start is a task
            (`giajax.runtime.execution.run_tasks`) and is reported when it has ended. Defaults to
            threads of this process.
        folder: folder with a file for each of these tasks, from which the same call can be
            continued.

    Returns:
        The best result, or the best so far after Ctrl-C. `result.starts` contains the end of each
        start. The model must be evaluable at the first start.
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
    """Fit a setup of `giajax.fitting.set_up` from several starts, as `multi_start` does.

    `journal` returns the journal of a fit by its number: the starts from 1, then the fit that
    checks the result. A start that is complete in its journal is only evaluated at its end.
    """
    setup, settings = setup.at_start(), setup.settings
    starts, values = settings.starts, start_values(setup)
    budget = None if settings.budget_s is None else Budget(settings.budget_s)
    # Reject invalid settings before the first start.
    if executor is not None and settings.optimiser is not None:
        raise InputError(
            "parallel workers support only giajax's own optimiser: omit the executor or the "
            "optimiser"
        )
    count, spent = cores(), threading.Event()

    def one(number: int, earlier: Sequence[FitResult], tell: Tell) -> End | None:
        """Return the end of a start; None if no time is left for it."""
        start = values[number - 1]
        if budget is not None and number > 1 and (spent.is_set() or not budget.left() > 0):
            return None
        try:
            if announce is not None:
                tell(announce, number, start)
            result = solve(
                with_tolerance_of(setup.started_at(start), earlier),
                # Progress is needed even without a listener, because a start can only be stopped
                # when it reports.
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
            # No evaluation of this start was completed.
            return Start(start, "interrupted"), None
        if result.reason == "budget":
            # The remaining budget is too short for a step of any start.
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
    # A loaded result lacks the predictions and the verdict on held-out data.
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
    """Repeat the best fit from its end, with the checks that were omitted before."""
    status = "interrupted"
    with contextlib.suppress(KeyboardInterrupt):
        inside = with_tolerance_of(setup.started_at(inside_bounds(setup, end_values(best))), [best])
        again = solve(inside, progress=progress, budget=budget, journal=journal)
        status = again.status
    if status == "interrupted":
        return interrupted(best, "before the result was checked")
    if status != "converged":
        return best
    return dataclasses.replace(
        again, message=best.message, iterations=best.iterations, history=best.history
    )
