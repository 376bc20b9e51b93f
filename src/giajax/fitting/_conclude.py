"""From the last state of a fit to its result."""

import functools
import platform
import time
from collections.abc import Mapping
from importlib.metadata import version

import numpy as np

from ..noise import ChannelNoise, gains
from ..runs import Run
from ._checks import Checks, checks
from ._derived import derived_estimates, with_tied
from ._estimates import estimates, own_estimates
from ._findings import findings
from ._integration import integration_of
from ._problem import Problem, predictions_by_run
from ._records import (
    Correlation,
    NoiseFit,
    Seconds,
    finite_or_none,
)
from ._result import FitResult
from ._run_records import ChannelFit, OwnEstimate, RunFit
from ._state import FitState
from ._statistics import Statistics, statistics
from ._verdict import verdict

# Residuals of this many times the noise are worth a word.
_NOTABLE = 1.15


def conclude(state: FitState, *, check: bool, max_iterations: int, began: float) -> FitResult:
    """Everything that is known at the end.

    Arguments:
        state: the last one, with its ending.
        check: compute the gradient check and the effect of the solver tolerance.
        max_iterations: that were allowed, for `config`.
        began: when the fit began, by `time.perf_counter`, s.

    Returns:
        The result.
    """
    if state.ending is None:
        raise ValueError("the fit has not ended: call `descend` first")
    status, message, reason = state.ending
    setup, problem = state.setup, state.problem
    model = problem.with_values(np.asarray(list(state.parameters().values())))
    known = statistics(state)
    derived = derived_estimates(problem, known)
    done = Checks(None, None, {}, interrupted=False)
    if check and status != "interrupted" and np.any(np.asarray(state.active)):
        done = checks(state, known)
    if done.interrupted:
        status = reason = "interrupted"
        message += ", then interrupted before its result was checked"
    predictions = predictions_by_run(problem, state.inner.aux, setup.runs)
    active = np.asarray(state.active)
    moved = [
        path
        for path, places in zip(problem.paths, problem.positions, strict=True)
        if np.any(active[list(places)])
    ]
    compiling = state.step_seconds[0] - float(np.median(state.step_seconds[1:] or [0.0]))
    compiling = max(compiling, 0.0)
    elapsed = time.perf_counter() - began
    return FitResult(
        status=status,
        message=message + _note(state, known),
        reason=reason,
        model=model,
        parameters=with_tied(estimates(state, known, model), derived, problem.ties),
        noise=_noise(state, known),
        integration=integration_of(state),
        verdict=verdict(state, status, known.prior_freedom),
        derived=derived,
        findings=findings(state, known, done.curvatures, _lengths(state)),
        correlation=_correlation(known, problem),
        runs=tuple(
            _run_fit(run, predicted, noise, own)
            for run, predicted, noise, own in zip(
                setup.runs,
                predictions,
                state.noise.values,
                own_estimates(state, known),
                strict=True,
            )
        ),
        cost=finite_or_none(state.cost),
        reduced_chi_square=finite_or_none(known.reduced_chi_square),
        iterations=state.history[-1].number,
        gradient_check=done.gradient,
        tolerance_effect=done.tolerance,
        conditions=tuple(model.conditions(moved, setup.runs)),
        seconds=Seconds(compile=compiling, run=elapsed - compiling),
        versions=versions(),
        config={**setup.config, "max_iterations": max_iterations},
        history=state.history,
        predictions=tuple(predictions),
    )


def _lengths(state: FitState) -> list[tuple[str, float]]:
    """How many correlation times of its slowest noise each run is long, where any has a memory."""
    lengths = []
    for run, noise in zip(state.setup.runs, state.noise.values, strict=True):
        longest = max((each.time_s for each in noise.values()), default=0.0)
        if longest and run.times is not None:
            lengths.append((run.name, float(np.ptp(run.times)) / longest))
    return lengths


def _correlation(known: Statistics, problem: Problem) -> Correlation:
    """Correlations of what all runs share."""
    shared = {places[0] for places in problem.positions if len(places) == 1}
    rows = [row for row, index in enumerate(known.determined) if index in shared]
    matrix = known.correlation[np.ix_(rows, rows)].tolist()
    return Correlation(
        tuple(known.labels[known.determined[row]] for row in rows), tuple(map(tuple, matrix))
    )


def _note(state: FitState, known: Statistics) -> str:
    """What to add to the message about the residuals."""
    note = ""
    if state.noise.estimated and not state.noise.complete:
        note += "; the noise was estimated from the residuals where it was not stated"
    elif not state.noise.complete:
        note += (
            "; the noise that was not stated is guessed from the differences of neighbouring "
            "samples, and the standard errors with it"
        )
    if not state.noise.is_white:
        note += "; the noise is correlated in time, and the standard errors allow for it"
    ratio = np.sqrt(known.reduced_chi_square)
    if ratio > _NOTABLE:
        note += f"; the residuals are {ratio:.3g} times the noise"
        if known.scale > 1:
            note += ", and the standard errors are scaled by that"
    return note


def _run_fit(
    run: Run,
    predicted: Mapping[str, np.ndarray],
    noise: Mapping[str, ChannelNoise],
    own: dict[str, OwnEstimate],
) -> RunFit:
    channels = {}
    for name, values in run.observations.items():
        channel = run.channels[name]
        difference = (predicted[name] - values)[~np.isnan(values)]
        rmse = float(np.sqrt(np.mean(difference**2)))
        channels[name] = ChannelFit(
            unit=channel.unit,
            rmse=finite_or_none(float(channel.from_si(rmse))),
            n=len(difference),
            noise=float(channel.from_si(noise[name].deviation)),
            correlated=float(channel.from_si(noise[name].correlated)),
            correlation_time_s=noise[name].time_s,
            innovation=float(channel.from_si(_innovation(noise[name], run, values))),
        )
    path = None if run.path is None else str(run.path)
    return RunFit(run.name, path, run.sha256, channels, own)


def _innovation(noise: ChannelNoise, run: Run, values: np.ndarray) -> float:
    """Geometric mean of the deviations of what the cells before do not foretell, SI."""
    measured = ~np.isnan(values)
    _, _, deviation = gains(noise, run.times, measured.astype(float))
    return float(np.exp(np.mean(np.log(deviation[measured]))))


def _noise(state: FitState, known: Statistics) -> NoiseFit:
    """What was taken for noise."""
    widening = {
        path: finite_or_none(known.widening[places[0]])
        for path, places in zip(state.problem.paths, state.problem.positions, strict=True)
        if places[0] in known.widening
    }
    return NoiseFit(state.setup.noise_model, state.noise.estimated, widening)


def versions() -> dict[str, str]:
    """Of Python, of giajax and of the libraries that compute, by name."""
    return dict(_versions())


@functools.cache
def _versions() -> dict[str, str]:
    # Each is read from a file, which takes longer than all else at the end of a small fit.
    names = ("giajax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
