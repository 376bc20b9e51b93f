"""A fit and what it was fitted to, as an argument of tasks that other processes do."""

import dataclasses
import functools
import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np

from .._identities import fields_of
from .._structure import content
from ..execution import prepared
from ..fitting import FitResult, Optimum, Seconds, matching_runs
from ..runs import Run
from ._refit import optimum_of


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A result with its runs, which any process can take up.

        task = Task("giajax.study._profile_task:profiled", {"fitted": Fitted.of(result, runs)})

    The function of the task asks it for its `optimum`, which a process evaluates once, however many
    tasks it does: its programs are loaded or compiled for the first of them.

    Attributes:
        result: without predictions.
        runs: that it was fitted to, in their order.
    """

    result: FitResult
    runs: tuple[Run, ...]

    @classmethod
    def of(cls, result: FitResult, runs: Run | Sequence[Run]) -> Self:
        """A result and its runs.

        Arguments:
            result: of `fit` or `load_result`.
            runs: what it was fitted to, in their order.

        Raises:
            InputError: these are not its runs.
        """
        several = tuple(matching_runs(result.runs, runs))
        bare = dataclasses.replace(
            result, predictions=(), held_predictions=(), seconds=Seconds(0.0, 0.0)
        )
        return cls(bare, several)

    @functools.cached_property
    def task_key(self) -> str:
        """SHA-256 of what decides the optimum: the same for a result and its `result.json`.

        Times, places of files, versions, and what was asked of a result afterwards do not count.
        """
        told = content(list(map(told_of, self.runs)))
        return hashlib.sha256((fit_key(self.result) + told).encode()).hexdigest()

    def optimum(self) -> Optimum:
        """Where the fit ended, kept in this process for the tasks to come.

        Raises:
            InputError: the model cannot be evaluated there.
        """
        return prepared(
            ("optimum", self.task_key), lambda: optimum_of(self.result, list(self.runs))
        )


def fit_key(result: FitResult) -> str:
    """SHA-256 of what of a result decides its optimum; the runs count by their checksums.

    It says whether a file beside `result.json` is of this fit.
    """
    kept: dict[str, Any] = {
        name: _told(getattr(result, name)) for name in ("config", "parameters", "integration")
    }
    kept["model"] = result.model.kind
    kept["runs"] = [{**_told(record), "path": None} for record in result.runs]
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


def _told(value: Any) -> Any:
    """What of a record counts, as JSON gives it: a field by the name that it has in keys."""
    if dataclasses.is_dataclass(value):
        fields = ((name, _told(item), default) for name, item, default in fields_of(value))
        return {
            name: item
            for name, item, default in fields
            if default is dataclasses.MISSING or item != _told(default)
        }
    if isinstance(value, Mapping):
        return {key: _told(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_told(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


def told_of(run: Run) -> tuple[Any, ...]:
    """What a fit knows of a run, wherever its file lies."""
    arrays = {
        name: list(values) if values.dtype == object else values
        for name, values in run.values.items()
    }
    return run.name, run.model, run.times, arrays, run.channels, run.observed
