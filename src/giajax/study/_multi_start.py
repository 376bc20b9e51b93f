"""A fit from several starts: long motions have valleys that lead nowhere."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..fitting import MAX_ITERATIONS, FitResult, Iteration, Seconds, Setup, Start, set_up, solve
from ..models import AbstractModel
from ..runs import Run

# An end whose misfit is this much above the best one, per measured value, is another valley.
SAME_END = 1e-3

STARTS, SPREAD, SEED = 8, 0.3, 0


def multi_start(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    *,
    starts: int = STARTS,
    spread: float = SPREAD,
    seed: int = SEED,
    free: Sequence[str] | None = None,
    start: Mapping[str, npt.ArrayLike] | None = None,
    fix: Mapping[str, npt.ArrayLike] | None = None,
    loss: str = "linear",
    solver: str | None = None,
    tolerance: float | None = None,
    max_iterations: int = MAX_ITERATIONS,
    progress: Callable[[Iteration], None] | None = None,
    announce: Callable[[int, Mapping[str, float]], None] | None = None,
    check: bool = True,
) -> FitResult:
    """Fit from several starts, and return the best end.

    The first start is the one that a fit has; the others change every free parameter by a factor
    between 1 / (1 + spread) and 1 + spread, or where a parameter has no sign by up to `spread`
    times its size. Ends are compared by the misfit, which is the logarithm of the likelihood: a
    cost alone means nothing where each fit estimates its own noise.

    Arguments:
        model, runs, free, start, fix, loss, solver, tolerance: as of `giajax.fit`.
        starts: how many; 1 is `giajax.fit`.
        spread: relative distance of the other starts.
        seed: of the other starts.
        max_iterations, progress, check: as of `giajax.fit`.
        announce: called before each fit with its number, from 1, and its start.

    Returns:
        The best result; `result.starts` tells of all of them.

    Raises:
        InputError: as `giajax.fit`, or no start can be evaluated.
    """
    setup = set_up(
        model,
        runs,
        free=free,
        start=start,
        fix=fix,
        loss=loss,
        solver=solver,
        tolerance=tolerance,
    )
    return solve_from_starts(
        setup,
        starts=starts,
        spread=spread,
        seed=seed,
        max_iterations=max_iterations,
        progress=progress,
        announce=announce,
        check=check,
    )


def solve_from_starts(
    setup: Setup,
    *,
    starts: int = STARTS,
    spread: float = SPREAD,
    seed: int = SEED,
    max_iterations: int = MAX_ITERATIONS,
    progress: Callable[[Iteration], None] | None = None,
    announce: Callable[[int, Mapping[str, float]], None] | None = None,
    check: bool = True,
) -> FitResult:
    """Fit what `giajax.fitting.set_up` resolved from several starts.

    Arguments, results and errors are those of `multi_start`.
    """
    setup = setup.at_start()
    random = np.random.default_rng(seed)
    results: list[FitResult] = []
    ends: list[Start] = []
    for number in range(1, starts + 1):
        values = _values(setup, spread, random if number > 1 else None)
        if announce is not None:
            announce(number, values)
        try:
            result = solve(
                setup.started_at(values),
                max_iterations=max_iterations,
                progress=progress,
                check=False,
            )
        except InputError as error:
            if number == 1:
                raise
            ends.append(Start(values, "failed", message=str(error)))
            continue
        ends.append(Start(values, result.status, misfit(result), _end(result)))
        results.append(result)
        if result.status == "interrupted":
            break
    best = min(results, key=misfit)
    seconds = Seconds(
        compile=sum(result.seconds.compile for result in results),
        run=sum(result.seconds.run for result in results),
    )
    if check and best.status == "converged" and ends[-1].status != "interrupted":
        # From its own end, for the checks that were left out above.
        inside = setup.started_at(_inside(setup, _end(best)))
        polished = solve(inside, max_iterations=max_iterations, progress=progress)
        if polished.status == "converged":
            best = dataclasses.replace(
                polished, message=best.message, iterations=best.iterations, history=best.history
            )
    config = {**best.config, "starts": starts, "spread": spread, "seed": seed}
    return dataclasses.replace(best, starts=tuple(ends), config=config, seconds=seconds)


def misfit(result: FitResult) -> float:
    """Minus the logarithm of the likelihood of a fit, up to a constant."""
    channels = [channel for run in result.runs for channel in run.channels.values()]
    cost = np.inf if result.cost is None else result.cost
    return float(cost + sum(channel.n * np.log(channel.noise) for channel in channels))


def _end(result: FitResult) -> dict[str, float]:
    """Where a fit ended, by path."""
    return {path: estimate.value for path, estimate in result.free.items()}


def _values(setup: Setup, spread: float, random: np.random.Generator | None) -> dict[str, float]:
    """Start values by path: those of the setup, or near them."""
    values = {}
    for parameter in setup.parameters:
        declaration, value = parameter.declaration, float(parameter.value(setup.model))
        lower, upper = declaration.lower, declaration.upper
        if random is not None:
            if lower >= 0:
                value *= (1 + spread) ** random.uniform(-1, 1)
            else:
                size = abs(value) or abs(declaration.default) or 1.0
                value += random.uniform(-1, 1) * spread * size
            value = _between(value, lower, upper)
        values[parameter.path] = value
    return values


def _inside(setup: Setup, values: Mapping[str, float]) -> dict[str, float]:
    """Values strictly between the bounds, at which a fit may start."""
    return {
        parameter.path: _between(
            values[parameter.path], parameter.declaration.lower, parameter.declaration.upper
        )
        for parameter in setup.parameters
    }


def _between(value: float, lower: float, upper: float) -> float:
    if np.isfinite(lower) and np.isfinite(upper):
        margin = 1e-9 * (upper - lower)
        return float(np.clip(value, lower + margin, upper - margin))
    tiny = np.finfo(float).tiny
    return max(value, lower + tiny) if np.isfinite(lower) else min(value, upper)
