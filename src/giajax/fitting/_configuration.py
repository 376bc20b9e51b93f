"""What a fit is asked: checked and resolved before anything is evaluated."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..models import AbstractModel
from ..parameters import (
    Parameter,
    check_within_bounds,
    default_free,
    elements,
    find,
    get,
    replace,
    switched_on,
)
from ..runs import Run, run_keys
from ._loss import check_loss


def configuration(
    model: AbstractModel,
    runs: Sequence[Run],
    *,
    free: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    fix: Mapping[str, float] | None = None,
    loss: str = "linear",
) -> dict[str, Any]:
    """What a fit with these arguments is asked, resolved: `config` of its result.

    Checks the arguments without evaluating the model; two fits of the same data with the same
    configuration have the same result.

    Raises:
        InputError: as `fit` does, apart from a start that cannot be evaluated.
    """
    start, fix = dict(start or {}), dict(fix or {})
    check_loss(loss)
    if not runs:
        raise InputError("no run was given; a fit needs at least one")
    for run in runs:
        run.require_observations()
    _check_doubles(runs)
    model, parameters = _resolved(model, free, start, fix)
    own = 0
    for run in runs:
        inputs = model.prepare(run)
        own += sum(get(inputs, path).size for path in model.free_inputs(run))
    measured = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    if not parameters and not own:
        raise InputError("no parameter is free; free at least one")
    if measured <= len(parameters) + own:
        raise InputError(
            f"{measured} measured values cannot determine {len(parameters) + own} parameters and "
            "their "
            "errors; free fewer parameters or give a longer run"
        )
    stated = [run.definition.given() for run in runs]
    return {
        "definition": model.definition(),
        "runs": [
            {key: said[key] for key in run_keys(model=False) if key in said}
            | ({} if run.observed is None else {"channels": list(run.observed)})
            | ({} if run.times is None else {"from_s": float(run.times[0]), "rows": len(run.times)})
            for run, said in zip(runs, stated, strict=True)
        ],
        "free": [parameter.path for parameter in parameters],
        "start": {path: float(value) for path, value in start.items()},
        "fix": {path: float(value) for path, value in fix.items()},
        "loss": loss,
    }


def _check_doubles(runs: Sequence[Run]) -> None:
    """Refuse a recording that is given twice: its errors would shrink for nothing."""
    seen: dict[tuple[str, float], str] = {}
    for run in runs:
        if run.sha256 is None:
            continue
        # Windows of one recording are several runs.
        part = (run.sha256, 0.0 if run.times is None else float(run.times[0]))
        if part in seen:
            raise InputError(
                f"'{seen[part]}' and '{run.path}' are the same recording; give it once"
            )
        seen[part] = str(run.path)


def set_up(
    model: AbstractModel,
    runs: Sequence[Run],
    free: Sequence[str] | None,
    start: Mapping[str, float],
    fix: Mapping[str, float],
) -> tuple[AbstractModel, list[Parameter]]:
    """The model at its start, and the scalar parameters to fit."""
    model, parameters = _resolved(model, free, start, fix)
    given = {element.path for path in start for element in elements(model, path)}
    unstated = [parameter.path for parameter in parameters if parameter.path not in given]
    return model.at_start(runs, unstated), parameters


def _resolved(
    model: AbstractModel,
    free: Sequence[str] | None,
    start: Mapping[str, float],
    fix: Mapping[str, float],
) -> tuple[AbstractModel, list[Parameter]]:
    """The model with what is stated, and the scalar parameters to fit; evaluates nothing."""
    model = switched_on(model, (*start, *fix, *(free or ())))
    for path in (*start, *fix):
        find(model, path)
    for path in set(start) & set(fix):
        raise InputError(f"'{path}' is given a start and a fixed value; give one of them")
    wanted = default_free(model, start) if free is None else free
    model = replace(model, {**start, **fix})
    fixed = {element.path for path in fix for element in elements(model, path)}
    parameters: dict[str, Parameter] = {}
    for path in wanted:
        for element in elements(model, path):
            if element.path not in fixed:
                parameters[element.path] = element
            elif free is not None:
                raise InputError(f"'{element.path}' is both free and fixed; give one of them")
    for path in fix:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    for element in parameters.values():
        check_within_bounds(element, float(element.value(model)), free=True)
    for path in start:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    return model, list(parameters.values())
