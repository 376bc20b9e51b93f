"""Fit a model to runs: a host loop around one jitted trust-region step."""

import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence

import jax
import numpy.typing as npt

from .._errors import InputError
from ..models import AbstractModel
from ..quantities import Prior
from ..runs import Run
from ._budget import Budget
from ._conclude import conclude
from ._configuration import Setup, set_up
from ._descend import descend
from ._noise import NoiseModel
from ._records import Iteration
from ._result import FitResult
from ._snapshot import FitJournal, keeper, restored
from ._state import FitState
from ._transitions import begin

MAX_ITERATIONS = 50


def fit(
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
    priors: Mapping[str, Prior] | None = None,
    bounds: Mapping[str, Sequence[float]] | None = None,
    ties: Mapping[str, str] | None = None,
    per_run: Sequence[str] = (),
    groups: Mapping[str, Sequence[Sequence[str]]] | None = None,
    max_iterations: int = MAX_ITERATIONS,
    budget: float | None = None,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
) -> FitResult:
    """Fit parameters of a model to recorded runs by weighted least squares.

    Each recorded cell counts with the noise that the run states for its channel; where it states
    none, the noise is estimated per channel from the residuals of all runs. Where noise is
    correlated in time, that is estimated, too, and the residuals are made independent (generalised
    least squares). Empty cells do not count.

    Arguments:
        model: the model with its constants; its values are where the fit starts.
        runs: one run or several, fitted together.
        free: paths of the parameters to fit (`links.mass[2]` for one element of an array); by
            default those that the model declares free.
        start: start values by path, in SI units: one, or one for each element.
        fix: values by path that are set and not fitted, as `start`.
        loss: "linear", or "huber" or "soft_l1" where a few cells are outliers.
        noise_model: "correlated" finds out whether the noise of a channel has a memory (white
            noise plus an AR(1) in continuous time), and how large and long it is where the runs
            do not state it; "white" takes every cell for independent of the others.
        noise_per_run: estimate the noise of a channel in each run by itself, not in all together.
        solver: of the simulation, one of `giajax.SOLVERS`; by default that of the model.
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
        max_iterations: trial steps before the fit gives up.
        budget: wall time that the fit may take, s; it then ends with the best so far.
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
    setup = set_up(
        model,
        runs,
        free=free,
        start=start,
        fix=fix,
        loss=loss,
        noise_model=noise_model,
        noise_per_run=noise_per_run,
        solver=solver,
        tolerance=tolerance,
        priors=priors,
        bounds=bounds,
        ties=ties,
        per_run=per_run,
        groups=groups,
    )
    return solve(
        setup,
        max_iterations=max_iterations,
        progress=progress,
        check=check,
        budget=None if budget is None else Budget(budget),
    )


def solve(
    setup: Setup,
    *,
    max_iterations: int = MAX_ITERATIONS,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
    budget: Budget | None = None,
    journal: FitJournal | None = None,
) -> FitResult:
    """Fit what `set_up` resolved.

    Arguments:
        setup: what to fit to what.
        max_iterations, progress, check: as of `fit`.
        budget: wall time that the fit may take.
        journal: what the fit keeps while it runs, and goes on from where it holds something.

    Returns:
        As `fit`.

    Raises:
        InputError: the model cannot be evaluated at the start, or the journal is of another fit.
    """
    _warn_once_in_32_bit()
    began = time.perf_counter()
    state, keep = begin(setup), None
    if journal is not None:
        state, before = _gone_on(state, journal)
        began -= before
        keep = keeper(state, journal, lambda: time.perf_counter() - began)
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


def _gone_on(begun: FitState, journal: FitJournal) -> tuple[FitState, float]:
    """As `restored`."""
    try:
        return restored(begun, journal)
    except (ValueError, LookupError, TypeError):
        raise InputError(
            "the journal is not that of this fit, or a line of it was changed: begin again "
            "without it"
        ) from None


_warned = False


def _warn_once_in_32_bit() -> None:
    global _warned
    if _warned or jax.config.read("jax_enable_x64"):
        return
    _warned = True
    warnings.warn(
        "giajax is fitting in 32-bit, where a long chain keeps about three digits: call "
        'jax.config.update("jax_enable_x64", True) before anything else',
        stacklevel=4,
    )
