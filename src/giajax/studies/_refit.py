"""Refits with small changes, starting from the end of another fit, and records of studies."""

import dataclasses
import functools
import hashlib
import itertools
import json
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, Self

import numpy as np

from ..fitting import (
    AbstractLoss,
    Budget,
    FitResult,
    Iteration,
    Optimum,
    RunFit,
    Seconds,
    between,
    matching_runs,
    optimum,
    prepared_with,
    set_up,
    solve,
)
from ..models import AbstractModel, capabilities
from ..recordings import Definition, FitSettings, NoiseModel, PriorEntry, Run
from ..runtime.execution import prepared, run_tasks
from ..runtime.identities import fields_of
from ..runtime.programs import content
from ..runtime.records import json_text, parse_record
from ..runtime.tasks import Outcome, Task
from ..runtime.text import InputError
from ..schema.parameters import Parameter, declared, elements, get, switched_on

# Minimum distance of an initial guess from a bound, as a fraction of the magnitude of a parameter
# or of its range.
_INSIDE = 1e-3


def end_values(result: FitResult) -> dict[str, float]:
    """Return the values of the free parameters at the end of a fit, by path, SI."""
    return {path: float(estimate.value) for path, estimate in result.free.items()}


def with_fitted_states(result: FitResult, runs: Sequence[Run]) -> list[Run]:
    """Return the runs of a result, in the same order, with their fitted initial states."""
    return [_begun_as(result, run, record) for run, record in zip(runs, result.runs, strict=True)]


def with_fitted_state(result: FitResult, run: Run) -> Run:
    """Return a run with its fitted initial state.

    A run whose name or file differs from the fitted runs is returned unchanged.
    """
    for record in result.runs:
        if (record.name, record.sha256) == (run.name, run.sha256):
            return _begun_as(result, run, record)
    return run


def _begun_as(result: FitResult, run: Run, record: RunFit) -> Run:
    model = result.model
    if not capabilities.free_inputs(model, run):
        return run
    own = {path: estimate.value for path, estimate in record.parameters.items()}
    inputs = prepared_with(model, run, own)
    contents = run.definition.contents()
    contents["initial"] = {**capabilities.initial_section(model, inputs), "free": True}
    return dataclasses.replace(run, definition=Definition.parse(contents, run.name))


def optimum_of(result: FitResult, runs: Sequence[Run]) -> Optimum:
    """Return the end of a fit of runs, in the same order, for evaluations without recompilation."""
    settings, model = FitSettings.shared_with(result.config), result.model
    values = end_values(result)
    start = {
        part.path: _inside(part, values[part.path], settings.bounds)
        for path in values
        for part in elements(model, path)
    }
    asked = settings.model_copy(update={"free": list(values), "start": start})
    setup = set_up(model, runs, asked)
    own = {
        record.name: {path: each.value for path, each in record.parameters.items()}
        for record in result.runs
    }
    # The end of the fit may be on a bound, where no fit may start.
    there = setup.started_at(values)
    return optimum(dataclasses.replace(there, own=own), result.runs)


def refit(
    result: FitResult,
    runs: Sequence[Run],
    *,
    model: AbstractModel | None = None,
    free: Sequence[str] = (),
    start: Mapping[str, float | Sequence[float]] | None = None,
    fix: Mapping[str, float | Sequence[float]] | None = None,
    priors: Mapping[str, PriorEntry | None] | None = None,
    ties: Mapping[str, str] | None = None,
    noise_model: NoiseModel | None = None,
    loss: AbstractLoss | str | None = None,
    max_iterations: int | None = None,
    budget: Budget | None = None,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = False,
) -> FitResult:
    """Fit the same runs again from the end of a fit, with more parameters or another model.

    Arguments:
        result, runs: the fit to start from. Its free parameters with their priors, bounds, ties and
            groups of runs, and its loss, are used again.
        model: model that replaces the fitted one; it must have the free parameters.
        free: paths of further parameters to free; omitted parts are switched on.
        start: initial guesses by path, SI, that replace the values of the model. A parameter that
            ended at a bound starts slightly inside it.
        fix: values by path, SI, at which parameters are fixed; they are no longer free.
        priors: priors by path that replace the priors of free parameters; None removes a prior.
        ties: further ties, of parameters that were fixed.
        noise_model, loss, max_iterations, budget, progress, check: as for `giajax.fit`; the noise
            model and the loss default to those of `result`.
    """
    model = result.model if model is None else model
    own, model = _own_values(result, model), switched_on(model, free)

    def is_held(path: str) -> bool:
        return bool({path, path.partition("[")[0]} & set(fix or {}))

    settings = FitSettings.shared_with(result.config)
    changed: dict[str, Any] = {
        name: {path: item for path, item in getattr(settings, name).items() if not is_held(path)}
        for name in ("priors", "bounds", "ties", "groups")
    }
    paths = [path for path in (*result.free, *free) if not is_held(path)]
    begin: dict[str, Any] = dict(start or {})
    values: dict[str, float] = {}
    for path in paths:
        parts = elements(model, path)
        wanted = np.broadcast_to(
            np.asarray(begin.get(path, get(model, path)), dtype=float), (len(parts),)
        )
        for part, value in zip(parts, wanted, strict=True):
            values[part.path] = _inside(part, float(value), changed["bounds"])
    changed |= {"free": paths, "start": values, "fix": dict(fix or {})}
    together = {**changed["priors"], **(priors or {})}
    changed["priors"] = {path: prior for path, prior in together.items() if prior is not None}
    changed["ties"] |= ties or {}
    if noise_model is not None:
        changed["noise_model"] = noise_model
    if loss is not None:
        changed["loss"] = loss
    asked = settings.model_copy(update=changed)
    setup = set_up(model, with_fitted_states(result, runs), asked)
    begun = {path.partition("[")[0] for path in begin}
    setup = dataclasses.replace(setup, own={
        name: {path: value for path, value in values.items() if path.partition("[")[0] not in begun}
        for name, values in own.items()
    })  # fmt: skip
    nuisances = [p for p in result.nuisances if p in setup.priors]
    # Start of the held-out part of each run, because the files of the runs are read again with it.
    before = [about.get("held_from") for about in result.config.get("runs", ())]
    several = [
        {**about, **({"held_from": first} if first else {})}
        for about, first in itertools.zip_longest(setup.config["runs"], before[: len(runs)])
    ]
    config = {**setup.config, "nuisances": nuisances, "runs": several}
    setup = dataclasses.replace(setup, config=config)
    if result.integration is not None and result.integration.chosen:
        # A tolerance that is fine enough for one model may be too coarse for another.
        config = {**setup.config, "tolerance": None}
        setup = dataclasses.replace(setup, reopened=True, config=config)
    return solve(
        setup, max_iterations=max_iterations, progress=progress, check=check, budget=budget
    )


def _own_values(result: FitResult, model: AbstractModel) -> dict[str, dict[str, float]]:
    """Return, by the name of each run, the values of the parameters that not all runs share.

    Only parameters that have the same value in the model as in the fit are included, because
    another choice of the model may scale them all.
    """
    known = declared(model)
    kept = {
        path
        for path, estimate in result.free.items()
        if path.partition("[")[0] in known and float(get(model, path)) == estimate.value
    }
    return {
        record.name: {path: own.value for path, own in record.parameters.items() if path in kept}
        for record in result.runs
    }


def _inside(parameter: Parameter, value: float, bounds: Mapping[str, Sequence[float]]) -> float:
    """Return a value well inside the bounds of a fit. A start on a bound would remain there."""
    declaration, path = parameter.declaration, parameter.path
    whole = bounds.get(path.partition("[")[0], (declaration.lower, declaration.upper))
    lower, upper = bounds.get(path, whole)
    width = min(upper - lower, abs(declaration.default) or 1.0)
    return between(value, lower, upper, margin=_INSIDE * width)


@dataclasses.dataclass(frozen=True)
class Fitted:
    """A result without predictions and its runs, in the same order, for use in any process."""

    result: FitResult
    runs: tuple[Run, ...]

    @classmethod
    def of(cls, result: FitResult, runs: Run | Sequence[Run], *, converged: bool = False) -> Self:
        """Return a result with its runs, in the same order; require convergence if `converged`."""
        if converged and result.status != "converged":
            raise InputError(
                "the fit did not converge, so there is no optimum: continue the fit until it "
                "converges"
            )
        bare = dataclasses.replace(
            result, predictions=(), held_predictions=(), seconds=Seconds(0.0, 0.0)
        )
        return cls(bare, tuple(matching_runs(result.runs, runs)))

    @functools.cached_property
    def task_key(self) -> str:
        """SHA-256 of all that determines the optimum: equal for a result and its `result.json`.

        Times, locations of files, versions and later analyses of the result do not affect it.
        """
        data = content(list(map(fingerprint, self.runs)))
        return hashlib.sha256((fit_key(self.result) + data).encode()).hexdigest()

    def study(
        self, function: Callable[..., Any], each: Iterable[Mapping[str, Any]], **how: Any
    ) -> list[Outcome]:
        """Call a function with this fit, and other arguments, on any worker.

        All studies of a fit are of this form: their settings determine the calls, and their record
        is made from the returned values. Seeds are derived from the functions and arguments. The
        function is defined at the top level of a module and has a first argument `fitted`. `each`
        contains the other arguments of each call.
        """
        tasks = [Task(function, {"fitted": self, **arguments}) for arguments in each]
        return run_tasks(tasks, **how)

    def optimum(self) -> Optimum:
        """Return the end of the fit, which is evaluated once per process for all tasks."""
        return prepared(("optimum", self.task_key), lambda: optimum_of(self.result, self.runs))


def fit_key(result: FitResult) -> str:
    """Return the SHA-256 of the data of a result that determine its optimum.

    The checksums of the runs are included. The key identifies the files beside `result.json` that
    belong to this fit.
    """
    kept: dict[str, Any] = {
        name: _counted(getattr(result, name)) for name in ("config", "parameters", "integration")
    }
    kept["model"] = result.model.kind
    kept["runs"] = [{**_counted(record), "path": None} for record in result.runs]
    return hashlib.sha256(json.dumps(kept, sort_keys=True).encode()).hexdigest()


def _counted(value: Any) -> Any:
    """Return the data of a record that determine the optimum, as plain JSON data."""
    if dataclasses.is_dataclass(value):
        fields = ((name, _counted(item), default) for name, item, default in fields_of(value))
        return {
            name: item
            for name, item, default in fields
            if default is dataclasses.MISSING or item != _counted(default)
        }
    if isinstance(value, Mapping):
        return {key: _counted(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_counted(item) for item in value]
    if isinstance(value, float | np.floating):
        return float(value) if math.isfinite(value) else None
    return value


class StudyRecord:
    """Result of a study of a fit, stored as a file beside its `result.json`.

    The record of a study is a frozen dataclass that is derived from this class with the keywords
    below. Its `giajax.report.RecordView` defines how it is shown.

    Attributes:
        file: name of the file.
        head: first keys of the file: the version of its format.
        remedy: instruction for a file that does not contain such a record.
        indent: number of spaces per level of indentation.
    """

    file: ClassVar[str]
    head: ClassVar[Mapping[str, int]]
    remedy: ClassVar[str]
    indent: ClassVar[int]

    def __init_subclass__(
        cls, *, file: str, head: Mapping[str, int], remedy: str, indent: int = 1
    ) -> None:
        cls.file, cls.head, cls.remedy, cls.indent = file, head, remedy, indent

    def is_of(self, result: FitResult) -> bool:
        """Return whether the record belongs to this fit rather than to an earlier one.

        Records contain the key of the result (`fit`), its values (`fitted`), or its `cost`.
        """
        known = {"fit": fit_key, "fitted": end_values, "cost": lambda result: result.cost}
        for name, of in known.items():
            if (stated := getattr(self, name, None)) is not None:
                return bool(stated == of(result))
        return False

    def to_json(self) -> str:
        """Return the text of the file; values that are not finite are null."""
        return json_text(self, self.head, indent=self.indent)

    @classmethod
    def of_json(cls, text: str | bytes) -> Self:
        """Return the record in a text of `to_json`."""
        what = f"this is not a valid {cls.file} file of this version of giajax"
        return parse_record(cls, text, cls.head, what, cls.remedy)


def fingerprint(run: Run) -> tuple[Any, ...]:
    """Return all that a fit uses of a run, regardless of the location of its file."""
    arrays = {
        name: list(values) if values.dtype == object else values
        for name, values in run.values.items()
    }
    return run.name, run.model, run.times, arrays, run.channels, run.observed
