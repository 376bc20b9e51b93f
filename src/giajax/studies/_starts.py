"""Starts of a fit: their initial guesses, their order, their execution as tasks, and their ends."""

import dataclasses
import functools
import hashlib
import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.special import ndtri

from ..fitting import (
    AbstractLoss,
    Budget,
    FitResult,
    Iteration,
    Setup,
    Start,
    between,
    loss_of,
    parse_result,
    prior_of,
    set_up,
    solve,
)
from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, Run
from ..runtime.arrays import sobol_points
from ..runtime.execution import prepared, run_tasks
from ..runtime.parallel import Tell, directly, run_in_threads
from ..runtime.plugins import sources_named, sources_of
from ..runtime.programs import content
from ..runtime.tasks import Outcome, Task
from ..runtime.text import InputError
from ..schema.parameters import Parameter
from ._refit import end_values, fingerprint


def interrupted(result: FitResult, when: str) -> FitResult:
    """Return the result, marked as interrupted; it is the best so far."""
    message = f"{result.message}; interrupted {when}"
    return dataclasses.replace(result, status="interrupted", message=message, reason="interrupted")


def misfit(result: FitResult) -> float:
    """Return minus the log-likelihood of a fit, up to a constant."""
    channels = [channel for run in result.runs for channel in run.channels.values()]
    cost = np.inf if result.cost is None else result.cost
    return float(cost + sum(c.n * np.log(c.innovation or c.noise) for c in channels))


def end_of(start: Mapping[str, float], result: FitResult) -> Start:
    """Return the record of a start that was fitted."""
    message = None if result.status == "converged" else result.message
    return Start(dict(start), result.status, misfit(result), end_values(result), message)


End = tuple[Start, FitResult | None]
"""Record of a start, and its result; None for a start that failed or was fitted before."""

One = Callable[[int, Sequence[FitResult], Tell], End | None]
"""Fits the start with a given number, using earlier results. Returns None if no time is left."""

Others = Callable[[Sequence[int], Sequence[FitResult]], list[End]]
"""Fits the starts with several given numbers, using earlier results."""


def in_order(
    one: One, others: Others, starts: int, known: Sequence[End], fitted: Sequence[FitResult]
) -> list[End]:
    """Return the ends of the starts, in their order; the first ones may be known.

    The starts up to the first that converges run one after the other, because it compiles the
    programs of the others and chooses their tolerance. The results of each start are therefore the
    same for any number of cores.
    """
    ended = list(known)
    while len(ended) < starts and not any(start.status == "converged" for start, _ in ended):
        end = one(len(ended) + 1, (), directly)
        ended += [] if end is None else [end]
        if end is None or interrupts(end):
            return ended
    earlier = [*fitted, *(result for _, result in ended if result is not None)]
    left = range(len(ended) + 1, starts + 1)
    return ended + others(left, earlier) if left else ended


def in_threads(one: One, most: int) -> Others:
    """Fit at most the given number of starts at once in this process."""

    def others(numbers: Sequence[int], earlier: Sequence[FitResult]) -> list[End]:
        jobs = [functools.partial(one, number, earlier) for number in numbers]
        ends = run_in_threads(jobs, min(most, len(jobs)), until=interrupts)
        return [end for end in ends if end is not None]

    return others


def interrupts(end: End | None) -> bool:
    """Return whether the other starts must also stop. Starts without time notice themselves."""
    return end is not None and end[0].status == "interrupted"


def with_tolerance_of(setup: Setup, ended: Sequence[FitResult]) -> Setup:
    """Use the tolerance chosen by a fit of the same data, so that it is not determined again."""
    for result in ended:
        # A fit that did not converge may have reduced it unnecessarily.
        if result.status == "converged" and result.integration is not None:
            return dataclasses.replace(setup, suited=result.integration.tolerance)
    return setup


def start_values(setup: Setup) -> list[dict[str, float]]:
    """Return the initial guesses by path: the guess of the setup, and others around it.

    The others are a scrambled Sobol sequence, so a larger number of starts begins with the same
    ones. For a parameter with a prior they are quantiles of the prior. Between two bounds of the
    fit they are evenly spread (in the logarithm if both bounds are positive). Otherwise they are
    near the values of the setup.
    """
    first = {each.path: float(each.value(setup.model)) for each in setup.parameters}
    count, spread = setup.settings.starts, setup.settings.spread
    if count < 2 or not first:
        return [dict(first) for _ in range(count)]
    shares = sobol_points(count - 1, len(first), setup.settings.seed)
    others = [
        {
            each.path: _value(setup, each, spread, float(share))
            for each, share in zip(setup.parameters, row, strict=True)
        }
        for row in shares
    ]
    return [first, *others]


def _value(setup: Setup, parameter: Parameter, spread: float, share: float) -> float:
    """Return the initial guess of a parameter for a coordinate between 0 and 1 (`share`)."""
    declaration, value = parameter.declaration, float(parameter.value(setup.model))
    lower, upper, path = declaration.lower, declaration.upper, parameter.path
    stated = setup.config.get("bounds", {})
    if (prior := prior_of(setup.priors, path)) is not None:
        # No initial guess is more than about three standard deviations from the prior value.
        quantile = prior.centre + prior.spread * float(ndtri(np.clip(share, 1e-3, 1 - 1e-3)))
        value = float(np.exp(quantile)) if prior.logarithmic else quantile
    elif (path in stated or path.partition("[")[0] in stated) and np.isfinite(upper - lower):
        # Uniform in the logarithm, so that each decade is equally likely.
        value = lower * (upper / lower) ** share if lower > 0 else lower + share * (upper - lower)
    elif lower >= 0:
        value *= (1 + spread) ** (2 * share - 1)
    else:
        size = abs(value) or abs(declaration.default) or 1.0
        value += (2 * share - 1) * spread * size
    return between(value, lower, upper)


def inside_bounds(setup: Setup, values: Mapping[str, float]) -> dict[str, float]:
    """Return values strictly between the bounds, from which a fit may start."""
    return {
        each.path: between(values[each.path], each.declaration.lower, each.declaration.upper)
        for each in setup.parameters
    }


# Message of a start for which there was no time. It is not treated as failed.
_NO_TIME = "the time budget of the fit was exhausted during this start"


@dataclasses.dataclass(frozen=True)
class Asked:
    """The data that all starts of a fit share, taken from a `Setup`, which cannot be pickled."""

    model: AbstractModel
    runs: tuple[Run, ...]
    own: Mapping[str, Mapping[str, float]]
    config: Mapping[str, Any]
    suited: float | None
    loss: AbstractLoss | None = None  # unpickling it imports its class, as for the model

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """Return the data of a setup whose model is at a point where the fit may start."""
        loss = loss_of(setup.config["loss"])
        return cls(setup.model, setup.runs, setup.own, setup.config, setup.suited, loss)

    @functools.cached_property
    def task_key(self) -> str:
        """SHA-256 of all that determines where a start ends."""
        words = json.dumps([self.config, self.own, self.suited], sort_keys=True)
        data = content([self.model, [fingerprint(run) for run in self.runs]])
        said = [self.config[key] for key in ("loss", "solver", "definition")]
        others = (sources_named(str(said)) | sources_of(self.model)).items()
        return hashlib.sha256((words + data + "".join(map(str, others))).encode()).hexdigest()

    def setup(self) -> Setup:
        """Return the setup, which is kept in this process for later tasks."""
        return prepared(("setup", self.task_key), self._made)

    def _made(self) -> Setup:
        settings = FitSettings.shared_with(self.config)
        free = settings.model_copy(update={"free": self.config["free"]})
        again = set_up(self.model, self.runs, free)
        return dataclasses.replace(
            again,
            model=self.model,
            unstarted=(),
            own=self.own,
            config=dict(self.config),
            suited=self.suited,
        )


def one_start(
    asked: Asked, start: Mapping[str, float], most: int, until: float | None = None
) -> str:
    """Task: fit from one start and return the result as JSON.

    `most` is the maximum number of trial steps and `until` the time at which the budget ends, s
    since the epoch. An `InputError` is raised if the model cannot be evaluated at the start, or if
    there was no time to complete the fit.
    """
    budget = None if until is None else Budget(until - time.time())
    if budget is not None and not budget.left() > 0:
        raise InputError(_NO_TIME)
    setup = asked.setup().started_at(start)
    result = solve(setup, max_iterations=most, check=False, budget=budget)
    if result.reason == "budget":
        raise InputError(_NO_TIME)
    return result.to_json()


def by_executor(
    setup: Setup,
    values: Sequence[Mapping[str, float]],
    executor: Executor,
    folder: str | Path | None,
    budget: Budget | None,
    announce: Callable[[int, Mapping[str, float]], None] | None,
    progress: Callable[[Iteration], None] | None,
    spent: Callable[[], None],
) -> Others:
    """Fit starts on the workers of an executor, with a common time budget.

    A start is announced, with its steps, when it has ended. `spent` is called if there was no time
    for a start.
    """

    def others(numbers: Sequence[int], earlier: Sequence[FitResult]) -> list[End]:
        asked, most = Asked.of(with_tolerance_of(setup, earlier)), setup.settings.max_iterations
        until = None if budget is None else time.time() + budget.left()
        tasks = {
            number: Task(
                one_start,
                {"asked": asked, "start": dict(values[number - 1]), "most": most},
                aside={"until": until},
            )
            for number in numbers
        }
        place = {task.key: number for number, task in tasks.items()}

        def tell(outcome: Outcome, done: int, total: int) -> None:
            if outcome.status != "done" or outcome.key not in place:
                return
            start = values[place[outcome.key] - 1]
            if announce is not None:
                announce(place[outcome.key], start)
            if progress is not None:
                for step in _result(setup, outcome.value).history:
                    progress(step)

        outcomes = run_tasks(tasks.values(), executor=executor, folder=folder, progress=tell)
        ends: list[End] = []
        for number, outcome in zip(numbers, outcomes, strict=True):
            start = dict(values[number - 1])
            if outcome.status == "done":
                result = _result(setup, outcome.value)
                ends.append((end_of(start, result), result))
            # Completed starts after this one are stored in their files, and no earlier end is
            # missing.
            elif outcome.status == "stopped":
                return [*ends, (Start(start, "interrupted"), None)]
            elif outcome.message == _NO_TIME:
                spent()
                return ends
            else:
                ends.append((Start(start, "failed", message=outcome.message), None))
        return ends

    return others


def _result(setup: Setup, text: str) -> FitResult:
    """Return the result from a worker, without predictions."""
    bare = parse_result(text, setup.model)
    model = setup.started_at(end_values(bare)).model
    if bare.integration is not None:
        model = capabilities.with_integration(
            model, solver=None, tolerance=bare.integration.tolerance
        )
    return dataclasses.replace(bare, model=model)


_LIMITS = ("priors", "bounds", "ties", "groups", "begin", "optimiser")


def has_earlier_starts(before: FitResult | None, setup: Setup) -> bool:
    """Return whether starts can be added to a result; for example, older versions chose others."""
    if before is None:
        return False
    begun = setup.at_start()
    try:
        earlier_starts(before, begun, start_values(begun))
    except InputError:
        return False
    return True


def earlier_starts(
    before: FitResult, setup: Setup, values: Sequence[Mapping[str, float]]
) -> list[Start]:
    """Return the starts of a result that need not be fitted again in a fit from more starts.

    The result must be from the same fit with fewer starts. The starts before the first one that did
    not end are returned.
    """
    asked = json.loads(json.dumps(setup.config))
    # The configuration of a fit omits keys that the fit does not use.
    asked = {**dict.fromkeys(_LIMITS), **asked}
    if any((before.config.get(key) or None) != (value or None) for key, value in asked.items()):
        raise InputError(
            "the result to which starts are added belongs to another fit: give the same runs and "
            "settings"
        )
    known = before.starts or [end_of(values[0], before)]
    ends = ("converged", "failed")
    whole = list(itertools.takewhile(lambda start: start.status in ends, known))
    for start, wanted in zip(whole, values, strict=False):
        if start.start.keys() != wanted.keys() or not np.allclose(
            list(start.start.values()), [wanted[path] for path in start.start], rtol=1e-9, atol=0
        ):
            raise InputError(
                "the result to which starts are added has different initial guesses: give the same "
                "seed and spread"
            )
    if len(whole) > len(values):
        raise InputError(
            f"the result to which starts are added already has {len(whole)} starts: give a total "
            f"of at least {len(whole)}"
        )
    return whole
