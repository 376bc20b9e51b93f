"""A fit from several starts: long motions have valleys that lead nowhere."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Iteration, fit, set_up
from ..models import AbstractModel
from ..parameters import Parameter, elements
from ..runs import Run

# An end whose misfit is this much above the best one, per measured value, is another valley.
SAME_END = 1e-3


def multi_start(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    *,
    starts: int = 8,
    spread: float = 0.3,
    seed: int = 0,
    free: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    fix: Mapping[str, float] | None = None,
    progress: Callable[[Iteration], None] | None = None,
    announce: Callable[[int, Mapping[str, float]], None] | None = None,
    **options: Any,
) -> FitResult:
    """Fit from several starts, and return the best end.

    The first start is the one that is given; the others change every free parameter by a factor
    between 1 / (1 + spread) and 1 + spread, or where a parameter has no sign by up to `spread`
    times its size. Ends are compared by the misfit, which is the logarithm of the likelihood: a
    cost alone means nothing where each fit estimates its own noise.

    Arguments:
        model, runs, free, start, fix: as of `giajax.fit`.
        starts: how many; 1 is `giajax.fit`.
        spread: relative distance of the other starts.
        seed: of the other starts.
        progress: as of `giajax.fit`.
        announce: called before each fit with its number, from 1, and its start.
        options: other arguments of `giajax.fit`.

    Returns:
        The best result; `result.starts` tells of all of them.

    Raises:
        InputError: as `giajax.fit`, or no start can be evaluated.
    """
    runs = [runs] if isinstance(runs, Run) else list(runs)
    start, fix = dict(start or {}), dict(fix or {})
    check = options.pop("check", True)
    arguments: dict[str, Any] = {**options, "free": free, "fix": fix, "progress": progress}
    on, parameters = set_up(model, runs, free, start, fix)
    random = np.random.default_rng(seed)
    found: list[tuple[float, FitResult]] = []
    told: list[dict[str, Any]] = []
    for number in range(1, starts + 1):
        values = _start(on, parameters, spread, random if number > 1 else None)
        if announce is not None:
            announce(number, values)
        try:
            result = fit(model, runs, start={**start, **values}, check=False, **arguments)
        except InputError as error:
            if number == 1:
                raise
            told.append({"start": values, "status": "failed", "message": str(error)})
            continue
        ended = {path: estimate.value for path, estimate in result.free.items()}
        told.append(
            {
                "start": values,
                "status": result.status,
                "misfit": misfit(result),
                "parameters": ended,
            }
        )
        found.append((misfit(result), result))
        if result.status == "interrupted":
            break
    _, best = min(found, key=lambda pair: pair[0])
    seconds = {key: sum(result.seconds[key] for _, result in found) for key in ("compile", "run")}
    if check and best.status == "converged" and told[-1]["status"] != "interrupted":
        # From its own end, for the checks that were left out above.
        ended = {path: estimate.value for path, estimate in best.free.items()}
        polished = fit(model, runs, start={**start, **_inside(on, ended)}, **arguments)
        if polished.status == "converged":
            best = dataclasses.replace(
                polished, message=best.message, iterations=best.iterations, history=best.history
            )
    config = {**best.config, "start": start, "starts": starts, "spread": spread, "seed": seed}
    return dataclasses.replace(best, starts=told, config=config, seconds=seconds)


def misfit(result: FitResult) -> float:
    """Minus the logarithm of the likelihood of a fit, up to a constant."""
    channels = [channel for run in result.runs for channel in run["channels"].values()]
    cost = np.inf if result.cost is None else result.cost
    return float(cost + sum(c["n"] * np.log(c["noise"]) for c in channels))


def _start(
    model: AbstractModel,
    parameters: Sequence[Parameter],
    spread: float,
    random: np.random.Generator | None,
) -> dict[str, float]:
    values = {}
    for parameter in parameters:
        said, value = parameter.declaration, float(parameter.value(model))
        if random is not None:
            if said.lower >= 0:
                value *= (1 + spread) ** random.uniform(-1, 1)
            else:
                value += random.uniform(-1, 1) * spread * (abs(value) or abs(said.default) or 1.0)
            value = _between(value, said.lower, said.upper)
        values[parameter.path] = value
    return values


def _inside(model: AbstractModel, values: Mapping[str, float]) -> dict[str, float]:
    """Values strictly between the bounds, at which a fit may start."""
    inside = {}
    for path, value in values.items():
        (element,) = elements(model, path)
        inside[path] = _between(value, element.declaration.lower, element.declaration.upper)
    return inside


def _between(value: float, lower: float, upper: float) -> float:
    if np.isfinite(lower) and np.isfinite(upper):
        margin = 1e-9 * (upper - lower)
        return float(np.clip(value, lower + margin, upper - margin))
    tiny = np.finfo(float).tiny
    return max(value, lower + tiny) if np.isfinite(lower) else min(value, upper)
