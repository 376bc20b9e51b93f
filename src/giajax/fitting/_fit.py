"""Fit a model to runs: a host loop around one jitted trust-region step."""

import dataclasses
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._errors import InputError
from .._typing import Array
from ..models import AbstractModel
from ..parameters import Parameter, check_within_bounds, default_free, elements, find, replace
from ..runs import Run
from ._bijector import Bijector
from ._identifiability import responds
from ._loss import check_loss
from ._noise import from_differences, from_residuals
from ._problem import (
    Prediction,
    Problem,
    Sigmas,
    build_groups,
    predictions_by_run,
    residual,
    stated_sigmas,
)
from ._report import Outcome, report
from ._result import FitResult, Status
from ._solver import Marquardt, MarquardtState

MAX_ITERATIONS = 50

# Estimating the noise and fitting with it alternate until the noise changes by less than this.
_NOISE_CHANGE = 0.05
_NOISE_ROUNDS = 4

# What a sidecar says about a run that a fit depends on; [arm] is in the model.
_ABOUT_RUNS = ("free_motion", "initial", "command", "wind", "noise")


@dataclasses.dataclass(frozen=True)
class Iteration:
    """What `progress` is told after each trial step.

    Attributes:
        number: 0 for the evaluation of the start.
        cost: half the sum of the loss, at the best point so far.
        step: largest relative change of a free parameter that was tried.
        accepted: whether the trial point became the best one.
        parameters: values of the free parameters at the best point, by path.
    """

    number: int
    cost: float
    step: float
    accepted: bool
    parameters: dict[str, float]


class Fitter:
    """The state of one fit between the steps of its host loop."""

    def __init__(self, problem: Problem, start: np.ndarray) -> None:
        """Begin at values of the free parameters; nothing is evaluated yet."""
        self.problem = problem
        self.start = start
        self.solver = Marquardt()
        self.coordinate: Array = jnp.asarray(
            problem.bijector.inverse(start), dtype=jnp.result_type(float)
        )
        self.active = jnp.ones(len(problem.paths), bool)
        self.state = self.fresh_state()
        self.step_seconds: list[float] = []
        self.converged = False

    def fresh_state(self) -> MarquardtState:
        """The solver's state before its first evaluation."""
        groups = self.problem.groups
        dtype = self.coordinate.dtype
        count = sum(group.observed.size for group in groups)
        prediction = Prediction(
            tuple(jax.ShapeDtypeStruct(group.observed.shape, dtype) for group in groups),
            jax.ShapeDtypeStruct((), bool),
        )
        shape = jax.ShapeDtypeStruct((count,), dtype)
        return self.solver.init(
            residual, self.coordinate, self.problem, {}, shape, prediction, frozenset()
        )

    def step(self) -> bool:
        """One step; returns whether the solver is done."""
        began = time.perf_counter()
        self.coordinate, self.state, done, converged = _step(
            self.solver, self.coordinate, self.problem, self.state, self.active
        )
        self.converged = bool(converged)  # waits for the result
        self.step_seconds.append(time.perf_counter() - began)
        return bool(done)

    def evaluate(self, coordinate: Any, problem: Problem | None = None) -> MarquardtState:
        """Residual and Jacobian at a point, by the same compiled program as a step."""
        coordinate = jnp.asarray(coordinate, dtype=self.coordinate.dtype)
        problem = self.problem if problem is None else problem
        fresh = self.fresh_state()
        _, state, _, _ = _step(self.solver, coordinate, problem, fresh, self.active)
        return state

    def parameters(self) -> dict[str, float]:
        """Values of the free parameters at the best point."""
        values = np.asarray(self.problem.bijector.forward(self.coordinate))
        # What is held keeps its start exactly, not as it comes back from its coordinate.
        values = np.where(np.asarray(self.active), values, self.start)
        return {path: float(v) for path, v in zip(self.problem.paths, values, strict=True)}


@eqx.filter_jit
def _step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> tuple[Array, MarquardtState, Array, Array]:
    options = {"active": active}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    done, result = solver.terminate(residual, coordinate, problem, options, state, frozenset())
    return coordinate, state, done, done & (result == optx.RESULTS.successful)


def fit(
    model: AbstractModel,
    runs: Run | Sequence[Run],
    *,
    free: Sequence[str] | None = None,
    start: Mapping[str, float] | None = None,
    fix: Mapping[str, float] | None = None,
    loss: str = "linear",
    max_iterations: int = MAX_ITERATIONS,
    progress: Callable[[Iteration], None] | None = None,
    check: bool = True,
) -> FitResult:
    """Fit parameters of a model to recorded runs by weighted least squares.

    Each recorded cell counts with the noise that the run states for its channel; where it states
    none, the noise is estimated per channel from the residuals. Empty cells do not count.

    Arguments:
        model: the model with its constants; its values are where the fit starts.
        runs: one run or several, fitted together.
        free: paths of the parameters to fit (`links.mass[2]` for one element of an array); by
            default those that the model declares free.
        start: start values by path, in SI units.
        fix: values by path that are set and not fitted.
        loss: "linear", or "huber" or "soft_l1" where a few cells are outliers.
        max_iterations: trial steps before the fit gives up.
        progress: called after each step with an `Iteration`.
        check: compute the gradient check and the effect of the solver tolerance at the end.

    Returns:
        The result; `result.status` says whether it converged. Ctrl-C ends the fit and returns
        the best point so far.

    Raises:
        InputError: an unknown path, a start outside its bounds, a run without measured channels,
            or a start from which the model cannot be evaluated.

    Example:
        >>> import giajax
        >>> run = giajax.read_run("data/synthetic/base_step.csv")  # doctest: +SKIP
        >>> result = giajax.fit(giajax.model_for([run]), run)  # doctest: +SKIP
        >>> result.parameters["air.drag_coefficient"].value  # doctest: +SKIP
    """
    _warn_once_in_32_bit()
    runs = [runs] if isinstance(runs, Run) else list(runs)
    start, fix = dict(start or {}), dict(fix or {})
    config = configuration(model, runs, free=free, start=start, fix=fix, loss=loss)
    model, parameters = _set_up(model, free, start, fix)
    stated = stated_sigmas(runs)
    sigmas: Sigmas = [
        {
            name: sigma if sigma is not None else from_differences(run.observations[name])
            for name, sigma in noise.items()
        }
        for run, noise in zip(runs, stated, strict=True)
    ]
    bijector = Bijector(
        tuple(p.declaration.lower for p in parameters),
        tuple(p.declaration.upper for p in parameters),
    )
    problem = Problem(
        model=model,
        groups=build_groups(model, runs, sigmas),
        bijector=bijector,
        paths=tuple(p.path for p in parameters),
        loss=loss,
    )
    values = np.asarray([float(p.value(model)) for p in parameters])
    fitter = Fitter(problem, values)
    estimated = any(sigma is None for noise in stated for sigma in noise.values())
    began = time.perf_counter()
    history: list[dict[str, Any]] = []
    status, message = _descend(fitter, runs, stated, sigmas, max_iterations, history, progress)
    outcome = Outcome(
        status=status,
        message=message,
        parameters=parameters,
        sigmas=sigmas,
        noise_estimated=estimated,
        history=history,
        began=began,
        config={**config, "max_iterations": max_iterations},
    )
    return report(fitter, runs, outcome, check=check and status != "interrupted")


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
    model, parameters = _set_up(model, free, start, fix)
    for run in runs:
        model.prepare(run)
    stated = [run.definition.given() for run in runs]
    return {
        "definition": model.definition(),
        "runs": [{key: said[key] for key in _ABOUT_RUNS if key in said} for said in stated],
        "free": [parameter.path for parameter in parameters],
        "start": {path: float(value) for path, value in start.items()},
        "fix": {path: float(value) for path, value in fix.items()},
        "loss": loss,
    }


def _set_up(
    model: AbstractModel,
    free: Sequence[str] | None,
    start: Mapping[str, float],
    fix: Mapping[str, float],
) -> tuple[AbstractModel, list[Parameter]]:
    """The model at its start, and the scalar parameters to fit."""
    for path in (*start, *fix):
        find(model, path)
    for path in set(start) & set(fix):
        raise InputError(f"'{path}' is given a start and a fixed value; give one of them")
    model = replace(model, {**start, **fix})
    wanted = default_free(model) if free is None else free
    fixed = {element.path for path in fix for element in elements(model, path)}
    parameters: dict[str, Parameter] = {}
    for path in wanted:
        for element in elements(model, path):
            if element.path not in fixed:
                parameters[element.path] = element
            elif free is not None:
                raise InputError(f"'{element.path}' is both free and fixed; give one of them")
    if not parameters:
        raise InputError("no parameter is free; free at least one")
    for path in fix:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    for element in parameters.values():
        check_within_bounds(element, float(element.value(model)), free=True)
    for path in start:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    return model, list(parameters.values())


def _descend(
    fitter: Fitter,
    runs: Sequence[Run],
    stated: Sequence[Mapping[str, float | None]],
    sigmas: Sigmas,
    max_iterations: int,
    history: list[dict[str, Any]],
    progress: Callable[[Iteration], None] | None,
) -> tuple[Status, str]:
    """Step until converged; `sigmas` and `history` are updated in place."""
    trials = 0

    def tell(step: np.ndarray, accepted: bool) -> None:
        iteration = Iteration(
            number=trials,
            cost=float(fitter.state.cost),
            step=float(np.max(np.abs(step), initial=0.0)),
            accepted=accepted,
            parameters=fitter.parameters(),
        )
        history.append(dataclasses.asdict(iteration))
        if progress is not None:
            progress(iteration)

    try:
        fitter.step()
        if not np.isfinite(float(fitter.state.cost)):
            raise InputError(
                "the model cannot be evaluated at the start values (the simulation fails); "
                "choose other start values"
            )
        fitter.active = jnp.asarray(responds(np.asarray(fitter.state.jacobian)))
        tell(np.zeros(len(fitter.active)), True)
        if not bool(jnp.any(fitter.active)):
            return "not_converged", "no channel responds to any of the free parameters"
        for _ in range(_NOISE_ROUNDS):
            done = False
            while not done:
                if trials >= max_iterations:
                    return "not_converged", (
                        f"no optimum after {trials} iterations; start nearer, free fewer "
                        "parameters or allow more iterations"
                    )
                done = fitter.step()
                trials += 1
                tell(np.asarray(fitter.state.step), bool(fitter.state.accepted))
            if not fitter.converged:
                return "not_converged", (
                    "no step lowers the cost any further, and the optimum is not reached; "
                    "start elsewhere or free fewer parameters"
                )
            if _update_noise(fitter, runs, stated, sigmas) < _NOISE_CHANGE:
                break
            fitter.problem = dataclasses.replace(
                fitter.problem, groups=build_groups(fitter.problem.model, runs, sigmas)
            )
            fitter.state = fitter.fresh_state()
            fitter.step()
    except KeyboardInterrupt:
        if not np.isfinite(float(fitter.state.cost)):
            raise
        return "interrupted", f"interrupted after {trials} iterations; this is the best so far"
    return "converged", f"converged in {trials} iterations"


def _update_noise(
    fitter: Fitter,
    runs: Sequence[Run],
    stated: Sequence[Mapping[str, float | None]],
    sigmas: Sigmas,
) -> float:
    """Re-estimate what was not stated; returns the largest relative change."""
    predictions = predictions_by_run(fitter.problem, fitter.state.aux, runs)
    channels = sum(len(noise) for noise in stated)
    taken = float(np.sum(np.asarray(fitter.active))) / channels
    robust = fitter.problem.loss != "linear"
    change = 0.0
    for run, noise, sigma, predicted in zip(runs, stated, sigmas, predictions, strict=True):
        for name, known in noise.items():
            if known is not None:
                continue
            difference = predicted[name] - run.observations[name]
            new = from_residuals(difference[~np.isnan(difference)], taken, robust=robust)
            change = max(change, abs(np.log(new / sigma[name])))
            sigma[name] = new
    return change


_warned = False


def _warn_once_in_32_bit() -> None:
    global _warned
    if _warned or jax.config.read("jax_enable_x64"):
        return
    _warned = True
    warnings.warn(
        "giajax is fitting in 32-bit, where a long chain keeps about three digits; call "
        'jax.config.update("jax_enable_x64", True) before anything else',
        stacklevel=3,
    )
