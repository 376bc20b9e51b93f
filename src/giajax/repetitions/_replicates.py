"""The task of a bootstrap: some repetitions of a fit, one after the other, by its own programs."""

import dataclasses
from typing import Any

import numpy as np

from .._typing import Float
from ..fitting import FitResult, Optimum, Recorded, Statistics, student_reach
from ..noise import drawn
from ..parameters import get
from ..study import Fitted, optimum_of, refit
from ._blocks import Residuals
from ._records import Method


def replicates(
    fitted: Fitted,
    first: int,
    count: int,
    method: Method,
    whole: bool,
    seed: int,
) -> list[dict[str, Any]]:
    """Repetitions of a fit, each with random numbers of its own: of the seed and its number.

    Arguments:
        fitted: the fit.
        first, count: numbers of the repetitions.
        method, whole, seed: as of `bootstrap`.

    Returns:
        Of each: `converged`, `reason`, `values` and `reach` (half of a 95 % interval, None without
        one) in the order of `Optimum.labels`, `derived` by name, and the labels in `bounds`.
    """
    optimum = fitted.optimum()
    sources = _sources(optimum) if method == "block" else []
    rows = []
    for number in range(first, first + count):
        random = np.random.default_rng([seed, number])
        recorded: Recorded
        if method == "block":
            recorded = [source.again(random) for source in sources]
        else:
            recorded = noisy(optimum, random)
        if whole:
            rows.append(_whole(fitted, recorded))
        else:
            rows.append(_held(fitted, recorded, known_again(optimum, random)))
    return rows


def noisy(optimum: Optimum, random: np.random.Generator) -> Recorded:
    """What each run would have recorded of the fitted model, with noise of the fitted noise model.

    Noise is larger where standard errors are scaled, because residuals exceed what is stated.

    Arguments:
        optimum: where the fit ended.
        random: draws the noise.

    Returns:
        By channel, SI; NaN where nothing was measured.
    """
    state, factor = optimum.state, np.sqrt(optimum.statistics.scale)
    recorded = []
    for index, (run, predicted) in enumerate(
        zip(state.setup.runs, optimum.predictions, strict=True)
    ):
        names = list(run.observations)
        weights = np.ones((len(predicted[names[0]]), len(names)))
        if state.noise.weights is not None:
            of_run = state.noise.weights[index]
            weights = np.stack([of_run[name] for name in names], axis=-1)
        noises = [state.noise.values[index][name] for name in names]
        noise = factor * drawn(noises, run.times, weights, random)
        recorded.append(
            {
                name: np.where(np.isnan(run.observations[name]), np.nan, predicted[name] + column)
                for name, column in zip(names, noise.T, strict=True)
            }
        )
    return recorded


def known_again(
    optimum: Optimum, random: np.random.Generator
) -> Float[np.ndarray, " prior"] | None:
    """Centres that the priors might have had: each is a measurement, and is made again.

    Were they the same in each repetition, all would be drawn to where the first fit was drawn to.

    Arguments:
        optimum: where the fit ended.
        random: draws them.

    Returns:
        As `Optimum.refit` takes them; None where there is no prior.
    """
    priors = optimum.state.problem.priors
    if not len(priors):
        return None
    values = optimum.values[list(priors.columns)]
    middle = np.where(priors.logarithmic, np.log(np.where(priors.logarithmic, values, 1)), values)
    return np.asarray(random.normal(middle, np.asarray(priors.spread)))


def block_lengths(optimum: Optimum) -> dict[str, int]:
    """Samples of a block of residuals, by run."""
    runs = optimum.state.setup.runs
    return {run.name: each.length for run, each in zip(runs, _sources(optimum), strict=True)}


def _sources(optimum: Optimum) -> list[Residuals]:
    state = optimum.state
    cells = sum(
        int(np.sum(~np.isnan(row))) for run in state.setup.runs for row in run.observations.values()
    )
    freedom = max(cells - len(optimum.statistics.alive), 1)
    inflation = float(np.sqrt(max(cells, 1) / freedom))
    several = zip(state.setup.runs, optimum.predictions, state.noise.values, strict=True)
    return [Residuals.of(run, at, noise, inflation) for run, at, noise in several]


def _held(fitted: Fitted, recorded: Recorded, centres: np.ndarray | None) -> dict[str, Any]:
    """A fit with the noise as it is."""
    optimum = fitted.optimum()
    again = optimum.refit(recorded=recorded, centres=centres)
    if not again.state.evaluated:
        return _row(False, again.reason)
    return _row(again.converged, again.reason) | _found(fitted.result, optimum, again.statistics)


def _whole(fitted: Fitted, recorded: Recorded) -> dict[str, Any]:
    """A fit as the data were fitted, noise and all, from where that ended."""
    others = [
        dataclasses.replace(run, values={**run.values, **values})
        for run, values in zip(fitted.runs, recorded, strict=True)
    ]
    again = refit(fitted.result, others)
    there = optimum_of(again, others)
    converged = again.status == "converged"
    return _row(converged, again.reason) | _found(fitted.result, there, there.statistics)


def _row(converged: bool, reason: str) -> dict[str, Any]:
    return {"converged": converged, "reason": reason}


def _found(result: FitResult, optimum: Optimum, statistics: Statistics) -> dict[str, Any]:
    """Where a repetition ended, with what a result would say of it."""
    values = statistics.values
    reach = [
        None
        if (error := statistics.standard_errors.get(place)) is None
        else student_reach(statistics.freedom[place]) * error
        for place in range(len(values))
    ]
    model = optimum.model(values)
    follows = model.derived() if result.derived else {}
    derived = {
        name: float(np.mean(follows[name].value if name in follows else get(model, name)))
        for name in result.derived
    }
    bounds = [statistics.labels[place] for place in statistics.bounds]
    return {"values": values.tolist(), "reach": reach, "derived": derived, "bounds": bounds}
