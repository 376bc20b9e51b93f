"""Fit a model to runs: the public functions, and the result from the last state."""

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

_NOTABLE = 1.15  # smallest ratio of the residuals to the noise that the message mentions


def conclude(state: FitState, *, check: bool, max_iterations: int, began: float) -> FitResult:
    """Return the result of a fit, including its checks.

    Arguments:
        state: state at the end of the fit.
        check: whether to compute the checks.
        max_iterations: maximum number of trial steps of the fit.
        began: time at which the fit began, by `time.perf_counter`, s.
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
        message += ", then interrupted before the result was checked"
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
    """Return the conditions on which the values depend, except for those of nuisance parameters."""
    own = tuple(f"{path.partition('[')[0]}:" for path in setup.nuisances)
    sentences = capabilities.conditions(model, moved, setup.runs)
    return tuple(each for each in sentences if not own or not each.startswith(own))


def _lengths(state: FitState) -> list[tuple[str, float]]:
    """Return the length of each run, in correlation times of its slowest estimated noise."""
    lengths = []
    for run, noise in zip(state.setup.runs, state.noise.values, strict=True):
        found = (each.time_s for name, each in noise.items() if not run.correlated_noise(name))
        longest = max(found, default=0.0)
        if longest and run.times is not None:
            lengths.append((run.name, float(np.ptp(run.times)) / longest))
    return lengths


def _correlation(known: Statistics, problem: Problem) -> Correlation:
    """Return the correlations of the parameters that all runs share."""
    shared = {places[0] for places in problem.positions if len(places) == 1}
    rows = [row for row, index in enumerate(known.determined) if index in shared]
    matrix = known.correlation[np.ix_(rows, rows)].tolist()
    return Correlation(
        tuple(known.labels[known.determined[row]] for row in rows), tuple(map(tuple, matrix))
    )


def _note(state: FitState, known: Statistics) -> str:
    """Return the notes on noise and residuals that are appended to the message."""
    note = ""
    if state.noise.estimated and not state.noise.complete:
        note += "; the noise was estimated from the residuals where it was not stated"
    elif not state.noise.complete:
        note += (
            "; the noise that was not stated is estimated from differences of neighbouring "
            "samples, which affects the standard errors"
        )
    if not state.noise.is_white:
        note += "; the standard errors account for the temporal correlation of the noise"
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
        # The geometric mean of the standard deviations, given all earlier cells of the channel.
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
    """Return the noise of the fit as a record."""
    widening = {
        path: finite_or_none(known.widening[places[0]])
        for path, places in zip(state.problem.paths, state.problem.positions, strict=True)
        if places[0] in known.widening
    }
    model, estimated = state.setup.settings.noise_model, state.noise.estimated
    return NoiseFit(model, estimated, widening, trends(state))


def versions() -> dict[str, str]:
    """Return the versions of Python, giajax and the numerical libraries, by name."""
    return dict(_versions())


@functools.cache
def _versions() -> dict[str, str]:
    # Reading the versions from files would dominate the end of a small fit, so they are cached.
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

    Each recorded cell is weighted by the noise that the run specifies for its channel. If none is
    specified, the noise is estimated per channel from the residuals of all runs. If the noise is
    correlated in time, its correlation is estimated as well, and the residuals are decorrelated
    (generalised least squares). Empty cells are ignored.

    Arguments:
        model: model with its constants. Its parameter values are the initial values of the fit.
        runs: one run, or several runs that are fitted together.
        settings: all of the following settings except `progress` and `check`, as an alternative to
            keywords.
        free: paths of the parameters to fit (`links.mass[2]` for one element of an array). The
            default is the parameters that the model declares free.
        start: initial values by path, in SI units: one value, or one for each element.
        fix: values by path that are set and not fitted, in the same form as `start`.
        loss: "linear", or for data with a few outliers "huber", "soft_l1", "student_t", or an
            `AbstractLoss` such as `giajax.fitting.StudentT(degrees_of_freedom=3.0)`.
        noise_model: "correlated" tests whether the noise of a channel is correlated (white noise
            plus an AR(1) process in continuous time), and estimates its standard deviation and
            correlation time if the runs do not specify them. "white" treats the noise of all cells
            as independent.
        noise_per_run: estimate the noise of a channel separately in each run instead of from all
            runs.
        solver: solver of the simulation, one of `giajax.simulation.SOLVERS` or of diffrax, such as
            `diffrax.Kvaerno4()`. The default is the solver of the model.
        tolerance: relative and absolute tolerance of the simulation. The default is the tolerance
            of the model. If the model does not specify one, it is 1e-5 (3e-6 for more than 5,000
            rows), reduced until no estimate shifts by a noticeable fraction of its standard error.
        priors: priors of free parameters, by path. A parameter without an initial value starts at
            the value of its prior.
        bounds: lower and upper bounds of free parameters, by path, within their declared bounds.
        ties: expressions by the path of the parameter that they determine, such as
            `{"joints.yaw_stiffness": "1.5 * joints.pitch_stiffness"}`. Elements of an array that
            its own expression names stay free: `{"links.mass": "links.mass[0]"}` gives all links
            the same mass.
        per_run: paths of free parameters that have a separate value in each recording.
        groups: names of the runs that share a value, group by group, by path.
        optimiser: least-squares solver of optimistix that replaces giajax's own, such as
            `optimistix.LevenbergMarquardt(rtol=1e-8, atol=1e-8)`. All its steps are one program,
            which reports no progress and cannot be interrupted. Beyond a bound its derivatives are
            zero. Studies of the result use giajax's own optimiser.
        max_iterations: maximum number of trial steps.
        budget: maximum wall-clock time of the fit, in s or as "10m". The fit then ends with the
            best point so far.
        progress: function that is called after each step with an `Iteration`.
        check: compute the gradient check and the effect of the solver tolerance at the end.

    Returns:
        The result. `result.status` specifies whether the fit converged. Ctrl-C ends the fit and
        returns the best point so far.

    Raises:
        InputError: an unknown path, an initial value outside its bounds, a run without measured
            channels, a solver or tolerance for a model that has none, or initial values at which
            the model cannot be evaluated.

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
    """Refuse settings that the named function, which accepts these keywords, would ignore."""
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
    """Run the fit that `set_up` resolved.

    Arguments:
        setup: resolved configuration of the fit.
        max_iterations: maximum number of trial steps. The default is the number in the settings.
        progress, check: as in `fit`.
        budget: maximum wall-clock time of this and other fits together. The default is the budget
            of the settings, for this fit alone.
        journal: record of the running fit. If it has content, the fit is resumed from it.

    Raises:
        InputError: the model cannot be evaluated at the initial values, or the journal belongs to
            another fit.
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
    # The checks require a few evaluations, for which no time is left.
    check = check and (budget is None or budget.left() > 0)
    try:
        result = conclude(state, check=check, max_iterations=max_iterations, began=began)
    except KeyboardInterrupt:
        # The computed values are kept. Everything except the checks takes little time.
        if state.ending is not None and state.ending[0] != "interrupted":
            message = f"{state.ending[1]}, then interrupted before the result was checked"
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
    """End of a fit that began at the end of another fit.

    Attributes:
        state: last state of the fit.
        converged: whether the fit reached an optimum of the free parameters.
        reason: reason for the end, as in `FitResult`: "iterations" if the maximum number was
            reached, "wall" if the model cannot be evaluated at the initial values.
    """

    state: FitState
    converged: bool
    reason: Reason

    @property
    def values(self) -> np.ndarray:
        """Values of all free parameters, SI units, in the order of `Optimum.labels`.

        Held parameters keep their values.
        """
        return self.state.values()

    @property
    def cost(self) -> float:
        """Half the sum of the losses of the residuals, which are divided by the noise."""
        return self.state.cost

    @property
    def iterations(self) -> int:
        """Number of trial steps."""
        return self.state.trials

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Standard errors and correlations at the end of the fit."""
        return statistics(self.state)


def refitted(state: FitState, most: int) -> Refit:
    """Step until the fit ends, with the noise and the tolerance unchanged."""
    state = descend(state, most, None, advance=advance_alone)
    assert state.ending is not None
    status, _, reason = state.ending
    if reason == "interrupted":
        raise KeyboardInterrupt
    return Refit(state, status == "converged", reason)
