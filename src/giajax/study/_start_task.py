"""Starts of a fit as tasks that other processes do."""

import dataclasses
import functools
import hashlib
import json
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, Self

from .._errors import InputError
from .._structure import content
from ..execution import Outcome, Task, prepared, run_tasks
from ..fitting import (
    Budget,
    FitResult,
    Iteration,
    Setup,
    Start,
    parse_result,
    set_up,
    solve,
)
from ..models import AbstractModel
from ..runs import Run
from ._ends import end_of, end_values
from ._fitted import told_of
from ._start_order import End, Others, as_fine

# What becomes of a start for which there is no time: it is not one that failed.
_NO_TIME = "the budget of the fit ended this start"


@dataclasses.dataclass(frozen=True)
class Asked:
    """What all starts of a fit have in common, which any process can take up.

    Attributes:
        model, runs, own, config, suited: as of a `Setup`, which itself cannot be pickled.
    """

    model: AbstractModel
    runs: tuple[Run, ...]
    own: Mapping[str, Mapping[str, float]]
    config: Mapping[str, Any]
    suited: float | None

    @classmethod
    def of(cls, setup: Setup) -> Self:
        """What a setup asks whose model is where the fit may start."""
        return cls(setup.model, setup.runs, setup.own, setup.config, setup.suited)

    @functools.cached_property
    def task_key(self) -> str:
        """SHA-256 of what decides where a start ends."""
        words = json.dumps([self.config, self.own, self.suited], sort_keys=True)
        told = content([self.model, [told_of(run) for run in self.runs]])
        return hashlib.sha256((words + told).encode()).hexdigest()

    def setup(self) -> Setup:
        """The setup again, kept in this process for the tasks to come."""
        return prepared(("setup", self.task_key), self._made)

    def _made(self) -> Setup:
        config = self.config
        again = set_up(
            self.model,
            self.runs,
            free=config["free"],
            loss=config["loss"],
            noise_model=config["noise_model"],
            noise_per_run=config["noise_per_run"],
            **{key: config.get(key, {}) for key in ("priors", "bounds", "ties", "groups")},
        )
        return dataclasses.replace(
            again,
            model=self.model,
            unstarted=(),
            own=self.own,
            config=dict(config),
            suited=self.suited,
        )


def one_start(
    asked: Asked, start: Mapping[str, float], most: int, until: float | None = None
) -> str:
    """A task: the result of a fit from one start, as JSON.

    Arguments:
        asked: what to fit to what.
        start: values by path.
        most: trial steps.
        until: when the time of the fit is over, s since the epoch; None for never.

    Raises:
        InputError: the start cannot be evaluated, or there was no time to fit it to its end.
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
    *,
    executor: Executor,
    folder: str | Path | None,
    most: int,
    budget: Budget | None,
    announce: Callable[[int, Mapping[str, float]], None] | None,
    progress: Callable[[Iteration], None] | None,
    spent: Callable[[], None],
) -> Others:
    """Starts that the workers of an executor fit.

    Arguments:
        setup: what to fit to what.
        values: of all starts.
        executor, folder: as of `run_tasks`.
        most: trial steps of each.
        budget: of all of them together.
        announce, progress: told of a start, and of its steps, once it has ended.
        spent: called where there was no time for a start.
    """

    def others(numbers: Sequence[int], earlier: Sequence[FitResult]) -> list[End]:
        asked = Asked.of(as_fine(setup, earlier))
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
            # What was done of those behind it has its file, and no end before it is missing.
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
    """A result as a worker returned it; without predictions."""
    bare = parse_result(text, setup.model)
    model = setup.started_at(end_values(bare)).model
    if bare.integration is not None:
        model = model.with_integration(solver=None, tolerance=bare.integration.tolerance)
    return dataclasses.replace(bare, model=model)
