"""Fit a model to runs: the public functions, and the result of the last state."""

import dataclasses
import functools
import platform
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Unpack

import jax
import numpy as np

from ..models import AbstractModel, capabilities
from ..noise import ChannelNoise, gains, white_deviation
from ..recordings import FIT_DEFAULTS, FitKeywords, FitSettings, Run, fit_settings
from ..runtime.plugins import sources_of
from ..runtime.records import finite_or_none
from ..runtime.text import InputError, keywords_listed
from ._checks import Checks, checks
from ._configuration import Setup, set_up
from ._derived import derived_estimates, with_tied
from ._estimates import beyond_usual, estimates, findings, own_estimates, vanished
from ._loop import Budget, advance_alone, descend
from ._problem import Problem, predictions_by_run
from ._records import ChannelFit, Correlation, Iteration, NoiseFit, OwnEstimate, RunFit, Seconds
from ._result import FitResult, PredictedRun, integration_of
from ._statistics import Statistics, statistics
from ._steps import CHANGED, FitJournal, FitState, Reason, begin, journal_writer, restored
from ._uncertainty import trends, verdict

_NOTABLE = 1.15  # residuals of this many times the noise are worth a word


def conclude(state: FitState, *, check: bool, max_iterations: int, began: float) -> FitResult:
    """Everything that is known at the end of a fit that `began` then, by `time.perf_counter`, s."""
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
    found = verdict(state, status, known.prior_degrees_of_freedom)
    for doubt in (beyond_usual(state, known), vanished(state, known)):
        found = found if doubt is None else found.doubted(doubt)
    active = np.asarray(state.active)
    places = zip(problem.paths, problem.positions, strict=True)
    moved = [path for path, at in places if np.any(active[list(at)])]
    usual = float(np.median(state.step_seconds[1:] or [0.0]))
    compiling = max(state.step_seconds[0] - usual, 0.0)
    elapsed = time.perf_counter() - began
    return FitResult(
        status=status,
        message=message + _note(state, known),
        reason=reason,
        model=model,
        parameters=with_tied(estimates(state, known, model), derived, problem.ties),
        noise=_noise(state, known),
        integration=integration_of(state),
        verdict=found,
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
        conditions=_conditions(model, moved, setup),
        seconds=Seconds(compile=compiling, run=elapsed - compiling),
        versions={**versions(), **sources_of((model, setup.loss, setup.settings.optimiser))},
        config={**setup.config, "max_iterations": max_iterations},
        history=state.history,
        predictions=tuple(map(PredictedRun, setup.runs, predictions)),
    )


def _conditions(model: AbstractModel, moved: Sequence[str], setup: Setup) -> tuple[str, ...]:
    """On what the values are conditional; not what those of the nuisances are."""
    own = tuple(f"{path.partition('[')[0]}:" for path in setup.nuisances)
    sentences = capabilities.conditions(model, moved, setup.runs)
    return tuple(each for each in sentences if not own or not each.startswith(own))


def _lengths(state: FitState) -> list[tuple[str, float]]:
    """How many correlation times of its slowest noise each run is long, of what is not stated."""
    lengths = []
    for run, noise in zip(state.setup.runs, state.noise.values, strict=True):
        found = (each.time_s for name, each in noise.items() if not run.correlated_noise(name))
        longest = max(found, default=0.0)
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
            "; the noise that was not stated is estimated from differences of neighbouring "
            "samples, which affects the standard errors"
        )
    if not state.noise.is_white:
        note += "; the standard errors include the correlation of the noise in time"
    ratio = np.sqrt(known.reduced_chi_square)
    if ratio > _NOTABLE:
        note += f"; the residuals are {ratio:.3g} times the noise"
        if known.scale > 1:
            note += ", and the standard errors are scaled by this factor"
    return note


def _run_fit(
    run: Run,
    predicted: Mapping[str, np.ndarray],
    noise: Mapping[str, ChannelNoise],
    own: dict[str, OwnEstimate],
) -> RunFit:
    channels = {}
    for name, values in run.observations.items():
        channel, known, measured = run.channels[name], noise[name], ~np.isnan(values)
        rest = predicted[name] - values
        difference = rest[measured]
        # Geometric mean of the deviations of what the cells before do not foretell.
        fresh = gains(known, run.times, measured.astype(float))[2][measured]
        sizes = (
            np.sqrt(np.mean(difference**2)),
            known.deviation,
            known.correlated,
            np.exp(np.mean(np.log(fresh))),
            white_deviation(rest, run.noise(name), known.deviation, in_time=run.times is not None),
        )
        rmse, deviation, correlated, innovation, white = channel.from_si(sizes).tolist()
        channels[name] = ChannelFit(
            unit=channel.unit,
            rmse=rmse if np.isfinite(rmse) else None,
            n=len(difference),
            noise=deviation,
            correlated=correlated,
            correlation_time_s=known.time_s,
            innovation=innovation,
            white=white,
        )
    path = None if run.path is None else str(run.path)
    return RunFit(run.name, path, run.sha256, channels, own)


def _noise(state: FitState, known: Statistics) -> NoiseFit:
    """What was taken for noise."""
    widening = {
        path: finite_or_none(known.widening[places[0]])
        for path, places in zip(state.problem.paths, state.problem.positions, strict=True)
        if places[0] in known.widening
    }
    model, estimated = state.setup.settings.noise_model, state.noise.estimated
    return NoiseFit(model, estimated, widening, trends(state))


def versions() -> dict[str, str]:
    """Of Python, of giajax and of the libraries that compute, by name."""
    return dict(_versions())


@functools.cache
def _versions() -> dict[str, str]:
    # Each is read from a file, which takes longer than all else at the end of a small fit.
    names = ("giajax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}


@keywords_listed(FIT_DEFAULTS)
def fit(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    settings: FitSettings | None = None,
    *,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
    **keywords: Unpack[FitKeywords],
) -> FitResult:
    """Fit parameters of a model to recorded runs by weighted least squares.

    Each recorded cell counts with the noise that the run states for its channel; where it states
    none, the noise is estimated per channel from the residuals of all runs. Where noise is
    correlated in time, that is estimated, too, and the residuals are made independent (generalised
    least squares). Empty cells do not count.

    Arguments:
        model: the model with its constants; its values are where the fit starts.
        runs: one run or several, fitted together.
        settings: all of what follows, apart from `progress` and `check`; or give it as keywords.
        free: paths of the parameters to fit (`links.mass[2]` for one element of an array); by
            default those that the model declares free.
        start: start values by path, in SI units: one, or one for each element.
        fix: values by path that are set and not fitted, as `start`.
        loss: "linear", or where a few cells are outliers "huber", "soft_l1", "student_t", or an
            `AbstractLoss` such as `giajax.fitting.StudentT(degrees_of_freedom=3.0)`.
        noise_model: "correlated" finds out whether the noise of a channel is correlated (white
            noise plus an AR(1) in continuous time), and how large and long it is where the runs
            do not state it; "white" takes every cell for independent of the others.
        noise_per_run: estimate the noise of a channel in each run by itself, not in all together.
        solver: of the simulation, one of `giajax.simulation.SOLVERS` or of diffrax, such as
            `diffrax.Kvaerno4()`; by default that of the model.
        tolerance: relative and absolute tolerance of the simulation; by default the model's, or
            where that leaves it open, 1e-5 (3e-6 of more than 5,000 rows) or as much finer as it
            takes to move no estimate by a noticeable part of its standard error.
        priors: what is known of free parameters before, by path; where one has no start, the
            fit starts there.
        bounds: lower and upper bounds of free parameters, by path, within those that they have.
        ties: expressions over paths by the path of the parameter that follows from them, such as
            `{"joints.yaw_stiffness": "1.5 * joints.pitch_stiffness"}`. Elements of an array that
            its own expression names stay free: `{"links.mass": "links.mass[0]"}` is one mass for
            all links.
        per_run: paths of free parameters that have a value of their own in each recording.
        groups: names of the runs that share a value, group by group, by path.
        optimiser: a least-squares solver of optimistix in place of giajax's own, such as
            `optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)`: its steps are one program, during
            which nothing is told or stopped, and its derivatives end at the bounds. Studies of the
            result use giajax's own.
        max_iterations: trial steps before the fit gives up.
        budget: wall time that the fit may take, s or "10m"; it then ends with the best so far.
        progress: called after each step with an `Iteration`.
        check: compute the gradient check and the effect of the solver tolerance at the end.

    Returns:
        The result; `result.status` says whether it converged. Ctrl-C ends the fit and returns
        the best point so far.

    Raises:
        InputError: an unknown path, a start outside its bounds, a run without measured channels,
            a solver or tolerance for a model that has none, or a start from which the model
            cannot be evaluated.

    Example:
        >>> import giajax
        >>> run = giajax.read_run("data/synthetic/base_step.csv")  # doctest: +SKIP
        >>> result = giajax.fit(giajax.model_for([run]), run)  # doctest: +SKIP
        >>> result.parameters["air.drag_coefficient"].value  # doctest: +SKIP
    """
    settings = fit_settings(keywords, settings=settings)
    check_effect(settings, FitKeywords, "giajax.fit")
    return solve(set_up(model, runs, settings), progress=progress, check=check)


def check_effect(settings: FitSettings, keywords: type, function: str) -> None:
    """Refuse settings that a function of this name, which knows these keywords, would pass over."""
    for name in settings.contents():
        if name not in keywords.__annotations__:
            raise InputError(
                f"{function} fits only the given runs and does not accept {name}: omit it, or "
                "use giajax.FitTask"
            )


def solve(
    setup: Setup,
    *,
    max_iterations: int | None = None,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
    budget: Budget | None = None,
    journal: FitJournal | None = None,
) -> FitResult:
    """Fit what `set_up` resolved.

    Arguments:
        setup: what to fit to what.
        max_iterations: trial steps before the fit gives up; by default what the settings say.
        progress, check: as of `fit`.
        budget: wall time that this and other fits may take together; by default that of the
            settings, for this one alone.
        journal: what the fit keeps while it runs, and continues from where it holds something.

    Raises:
        InputError: the model cannot be evaluated at the start, or the journal is of another fit.
    """
    _warn_once_in_32_bit()
    began = time.perf_counter()
    settings = setup.settings
    max_iterations = settings.max_iterations if max_iterations is None else max_iterations
    if budget is None and settings.budget_s is not None:
        budget = Budget(settings.budget_s)
    state, keep = begin(setup), None
    if journal is not None:
        try:
            state, before = restored(state, journal)
        except InputError:
            raise
        except (ValueError, LookupError, TypeError, ArithmeticError):
            raise InputError(f"{CHANGED}: start again without the journal") from None
        began -= before
        keep = journal_writer(state, journal, lambda: time.perf_counter() - began)
    state = descend(state, max_iterations, progress, budget=budget, keep=keep)
    # Checking takes a few evaluations, for which there is no time left.
    check = check and (budget is None or budget.left() > 0)
    try:
        result = conclude(state, check=check, max_iterations=max_iterations, began=began)
    except KeyboardInterrupt:
        # What was computed is worth keeping; all but the checks takes little.
        if state.ending is not None and state.ending[0] != "interrupted":
            message = f"{state.ending[1]}, then interrupted before its result was checked"
            state = state.ended("interrupted", message, "interrupted")
        result = conclude(state, check=False, max_iterations=max_iterations, began=began)
    if budget is None:
        return result
    return dataclasses.replace(result, config={**result.config, "budget_s": budget.seconds})


_warned = False


def _warn_once_in_32_bit() -> None:
    global _warned
    if _warned or jax.config.read("jax_enable_x64"):
        return
    _warned = True
    warnings.warn(
        "giajax is fitting in 32-bit precision, which is accurate to about three digits for a long "
        'chain: call jax.config.update("jax_enable_x64", True) before any other JAX operation',
        stacklevel=4,
    )


@dataclasses.dataclass(frozen=True)
class Refit:
    """How a fit ended that began from another one, and whether at an optimum of what was free.

    Its reason is as of `FitResult`; "iterations" where they were used up, "wall" where the model
    cannot be evaluated at the start.
    """

    state: FitState
    converged: bool
    reason: Reason

    @property
    def values(self) -> np.ndarray:
        """Of all free parameters, in the order of `Optimum.labels`, SI; what was held as held."""
        return self.state.values()

    @property
    def cost(self) -> float:
        """Half the sum of the loss, in units of the noise."""
        return self.state.cost

    @property
    def iterations(self) -> int:
        """Trial steps."""
        return self.state.trials

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Standard errors and correlations at the end."""
        return statistics(self.state)


def refitted(state: FitState, most: int) -> Refit:
    """Steps until none is left, with the noise and the tolerance as they are."""
    state = descend(state, most, None, advance=advance_alone)
    assert state.ending is not None
    status, _, reason = state.ending
    if reason == "interrupted":
        raise KeyboardInterrupt
    return Refit(state, status == "converged", reason)
