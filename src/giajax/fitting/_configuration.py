"""What a fit is asked: checked and resolved before anything is evaluated.

The file is longer than 200 lines because all that can be wrong with a question is looked at here.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..models import AbstractModel
from ..parameters import (
    Parameter,
    check_count,
    check_within_bounds,
    default_free,
    elements,
    get,
    replace,
    switched_on,
)
from ..runs import Run, run_keys
from ._beginning import Beginning, inside_bounds
from ._loss import check_loss
from ._noise import NOISE_MODELS, NoiseModel


@dataclasses.dataclass(frozen=True)
class Setup:
    """What a fit is asked, resolved once: `set_up` makes it, `solve` fits it.

    Attributes:
        model: with the start values and what is fixed.
        runs: what is fitted to.
        parameters: the scalar parameters to fit, apart from those of single runs.
        unstarted: paths of those that have no start of the caller's.
        loss: how a large residual counts.
        noise_model: "correlated" or "white".
        noise_per_run: whether each run has noise of its own.
        own: where the parameters of single runs start, by the run's name and their path, where
            that is not as the run is prepared.
        config: the same as plain data, `config` of the result: two fits of the same data with
            the same one have the same result.
    """

    model: AbstractModel
    runs: tuple[Run, ...]
    parameters: tuple[Parameter, ...]
    unstarted: tuple[str, ...]
    loss: str
    noise_model: NoiseModel
    noise_per_run: bool
    config: dict[str, Any]
    own: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def at_start(self) -> Self:
        """With the model where the fit may start (`AbstractModel.at_start`)."""
        model = self.model.at_start(self.runs, self.unstarted)
        return dataclasses.replace(self, model=model, unstarted=())

    def started_at(self, values: Mapping[str, float]) -> Self:
        """With other start values of the parameters to fit, by path."""
        return dataclasses.replace(self, model=replace(self.model, values), unstarted=())


def set_up(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    *,
    free: Sequence[str] | None = None,
    start: Mapping[str, npt.ArrayLike] | None = None,
    fix: Mapping[str, npt.ArrayLike] | None = None,
    loss: str = "linear",
    noise_model: NoiseModel = "correlated",
    noise_per_run: bool = False,
    solver: str | None = None,
    tolerance: float | None = None,
    begin: Beginning | None = None,
) -> Setup:
    """Check and resolve the arguments of a fit, without evaluating the model.

    Arguments:
        model, runs, free, start, fix, loss, noise_model, noise_per_run, solver, tolerance: as of
            `fit`.
        begin: where another fit ended, which goes before `start`; `fix` goes before both.

    Returns:
        What `solve` fits.

    Raises:
        InputError: as `fit`, apart from a start that cannot be evaluated.
    """
    runs = (runs,) if isinstance(runs, Run) else tuple(runs)
    start, fix = _plain(start or {}), _plain(fix or {})
    check_loss(loss)
    if noise_model not in NOISE_MODELS:
        raise InputError(
            f"there is no noise model '{noise_model}': use one of: {', '.join(NOISE_MODELS)}"
        )
    if not runs:
        raise InputError("there is no run: give at least one")
    for run in runs:
        run.require_observations()
    _check_doubles(runs)
    if solver is not None or tolerance is not None:
        model = model.with_integration(solver=solver, tolerance=tolerance)
    reached = {} if begin is None else begin.values_for(model)
    model, parameters = _resolved(model, free, start, fix, reached)
    _check_determined(model, runs, parameters)
    begun = {e.path for path in (*reached, *start) for e in elements(model, path)}
    return Setup(
        model=model,
        runs=runs,
        parameters=tuple(parameters),
        unstarted=tuple(p.path for p in parameters if p.path not in begun),
        loss=loss,
        noise_model=noise_model,
        noise_per_run=noise_per_run,
        config={
            "definition": model.definition(),
            "runs": [_about(run) for run in runs],
            "free": [parameter.path for parameter in parameters],
            "start": start,
            "fix": fix,
            "loss": loss,
            "noise_model": noise_model,
            "noise_per_run": noise_per_run,
            **_integration(model),
            **({} if begin is None else {"begin": dataclasses.asdict(begin)}),
        },
        own={} if begin is None else begin.own,
    )


def _plain(values: Mapping[str, npt.ArrayLike]) -> dict[str, Any]:
    """Values by path as a result states them: numbers, and lists of several."""
    arrays = {path: np.asarray(value, dtype=float) for path, value in values.items()}
    return {path: a.item() if a.size == 1 else a.tolist() for path, a in arrays.items()}


def _integration(model: AbstractModel) -> dict[str, Any]:
    """What computes the predictions: solver and tolerance, None for a model without one."""
    integration = model.integration()
    if integration is None:
        return {"solver": None, "tolerance": None}
    return {"solver": integration.solver, "tolerance": integration.tolerance}


def _about(run: Run) -> dict[str, Any]:
    """What of a run a fit depends on, beside its data and the constants of the model."""
    sidecar = run.definition.contents()
    about: dict[str, Any] = {key: sidecar[key] for key in run_keys(model=False) if key in sidecar}
    if run.observed is not None:
        about["channels"] = list(run.observed)
    if run.times is not None:
        about |= {"from_s": float(run.times[0]), "rows": len(run.times)}
    return about


def _check_determined(
    model: AbstractModel, runs: Sequence[Run], parameters: Sequence[Parameter]
) -> None:
    """Refuse a fit of nothing, and one of more parameters than there are values."""
    count = len(parameters)
    for run in runs:
        inputs = model.prepare(run)
        count += sum(get(inputs, path).size for path in model.free_inputs(run))
    measured = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    if not count:
        raise InputError("no parameter is free: free at least one")
    if measured <= count:
        raise InputError(
            f"{measured} measured values cannot determine {count} parameters and their "
            "standard errors: free fewer parameters or give a longer run"
        )


def _check_doubles(runs: Sequence[Run]) -> None:
    """Refuse a recording that is there twice: standard errors would shrink for nothing."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        if run.sha256 is None:
            continue
        # Windows of one recording are several runs.
        part = (run.sha256, 0.0 if run.times is None else float(run.times[0]))
        if part in seen:
            raise InputError(
                f"'{seen[part]}' and '{run.path}' are the same recording: give it once"
            )
        seen[part] = str(run.path)


def _resolved(
    model: AbstractModel,
    free: Sequence[str] | None,
    start: Mapping[str, npt.ArrayLike],
    fix: Mapping[str, npt.ArrayLike],
    reached: Mapping[str, Any],
) -> tuple[AbstractModel, list[Parameter]]:
    """The model with starts and fixed values, and the scalar parameters to fit."""
    model = switched_on(model, (*reached, *start, *fix, *(free or ())))
    for path, value in (*start.items(), *fix.items()):
        check_count(model, path, value)
    for path in set(start) & set(fix):
        raise InputError(f"'{path}' has a start and a fixed value: give one of them")
    chosen = default_free(model, start) if free is None else free
    for values in (start, reached, fix):
        model = replace(model, values)
    fixed = {element.path for path in fix for element in elements(model, path)}
    parameters: dict[str, Parameter] = {}
    for path in chosen:
        for element in elements(model, path):
            if element.path not in fixed:
                parameters[element.path] = element
            elif free is not None:
                raise InputError(f"'{element.path}' is both free and fixed: give one of them")
    for path in fix:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    if reached:
        # A fit may end on a bound, where none can start.
        model = replace(model, inside_bounds(model, reached, parameters))
    for element in parameters.values():
        check_within_bounds(element, float(element.value(model)), free=True)
    for path in start:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    return model, list(parameters.values())
