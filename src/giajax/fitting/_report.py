"""From the end of a fit to its result: errors, remarks and checks."""

import dataclasses
import platform
import time
from collections.abc import Sequence
from importlib.metadata import version
from typing import Any

import numpy as np

from ..parameters import Declaration, Parameter, replace
from ..runs import Run
from ._derived import derived_estimates
from ._fitter import Fitter
from ._identifiability import largest_correlations, responds, undetermined_groups
from ._problem import Sigmas, predictions_by_run
from ._result import Estimate, FitResult, Status, finite_or_none, held_estimates
from ._uncertainty import correlation_matrix, uncertainty

# Central differences in the free coordinate, at a tolerance where the steps of the integrator
# do not show: truncation and noise are then both near 1e-8.
_DIFFERENCE = 1e-4
_DIFFERENCE_32 = 3e-2
_FINER = 1e-3

_NEARLY_THE_SAME = 0.98

# Residuals of this many times the stated noise are worth a word.
_NOTABLE = 1.15

# A parameter this close to its bound, in standard errors, is at it.
_AT_BOUND = 0.1


@dataclasses.dataclass
class Outcome:
    """How the loop ended, and what it was asked."""

    status: Status
    message: str
    parameters: list[Parameter]
    sigmas: Sigmas
    noise_estimated: bool
    noise_guessed: bool
    history: list[dict[str, Any]]
    began: float
    config: dict[str, Any]


def report(fitter: Fitter, runs: Sequence[Run], outcome: Outcome, *, check: bool) -> FitResult:
    """Everything that is known at the end."""
    problem, state = fitter.problem, fitter.state
    active = np.asarray(fitter.active)
    model = replace(problem.model, fitter.parameters())
    predictions = predictions_by_run(problem, state.aux, runs)
    errors = _Errors(fitter, outcome, problem.labels(runs))
    estimates = {
        parameter.path: _estimate(parameter, errors, index, bool(active[index]))
        for index, parameter in enumerate(outcome.parameters)
    }
    gradient = tolerance = None
    if check and active.any():
        try:
            gradient = _gradient_check(fitter)
            tolerance = _tolerance_effect(fitter, errors)
        except KeyboardInterrupt:  # the fit itself is done, and worth keeping
            outcome.status = "interrupted"
            outcome.message += ", then interrupted before its result was checked"
    paths = list(problem.paths)
    determined = [i for i in errors.determined if i < len(paths)]
    rows = [errors.determined.index(i) for i in determined]
    elapsed = time.perf_counter() - outcome.began
    compiling = fitter.step_seconds[0] - float(np.median(fitter.step_seconds[1:] or [0.0]))
    compiling = max(compiling, 0.0)
    return FitResult(
        status=outcome.status,
        message=outcome.message + errors.note(outcome),
        model=model,
        parameters={**estimates, **held_estimates(model, paths)},
        derived=derived_estimates(
            model, problem.paths, errors.alive, errors.root, errors.covariance
        ),
        correlation={
            "parameters": [paths[i] for i in determined],
            "matrix": errors.correlation[np.ix_(rows, rows)].tolist(),
        },
        runs=[
            _run_record(run, predicted, sigma, own)
            for run, predicted, sigma, own in zip(
                runs, predictions, outcome.sigmas, _own_values(fitter, errors, runs), strict=True
            )
        ],
        cost=finite_or_none(float(state.cost)),
        reduced_chi_square=finite_or_none(errors.reduced_chi_square),
        iterations=outcome.history[-1]["number"] if outcome.history else 0,
        gradient_check=gradient,
        tolerance_effect=tolerance,
        conditions=model.conditions([paths[i] for i in range(len(paths)) if active[i]], runs),
        seconds={"compile": compiling, "run": elapsed - compiling},
        versions=_versions(),
        config=outcome.config,
        history=outcome.history,
        predictions=predictions,
    )


class _Errors:
    """Standard errors of the free parameters, and which of them there are."""

    def __init__(self, fitter: Fitter, outcome: Outcome, labels: list[str]) -> None:
        problem, state = fitter.problem, fitter.state
        self.paths = labels
        self.values = [float(value) for value in fitter.values()]
        jacobian = fitter.natural_jacobian()
        moved = responds(jacobian.norms(), fitter.sizes)
        alive = np.flatnonzero(np.asarray(fitter.active) & moved)
        root = jacobian.reduced()[:, alive]
        groups = undetermined_groups(root)
        self.together = [[int(alive[i]) for i in group] for group in groups]
        loose = {index for group in self.together for index in group}
        self.determined = [int(i) for i in alive if i not in loose]
        weights = np.concatenate([np.asarray(g.weight).ravel() for g in problem.groups])
        observed = np.concatenate([np.asarray(g.observed).ravel() for g in problem.groups])
        predicted = np.concatenate([np.asarray(p).ravel() for p in state.aux.channels])
        measured = weights > 0
        weighted = np.where(measured, (predicted - observed) * weights, 0.0)
        found = uncertainty(weighted, jacobian, loss=problem.loss, measured=measured, columns=alive)
        self.alive, self.root, self.covariance = alive, root, found.covariance
        rows = [int(np.flatnonzero(alive == i)[0]) for i in self.determined]
        covariance = found.covariance[np.ix_(rows, rows)]
        self.correlation = correlation_matrix(covariance)
        self.reduced_chi_square = found.reduced_chi_square
        self.scale = found.scale
        self.loss = problem.loss
        self.standard = dict(zip(self.determined, np.sqrt(np.diag(covariance)), strict=True))
        self.partners = largest_correlations(self.correlation, _NEARLY_THE_SAME)

    def note(self, outcome: Outcome) -> str:
        """What to add to the message about the residuals."""
        notes = ""
        if outcome.noise_estimated:
            notes += "; the noise was estimated from the residuals where it was not stated"
        elif outcome.noise_guessed:
            notes += (
                "; the noise that was not stated is guessed from the differences of neighbouring "
                "samples, and the standard errors with it"
            )
        ratio = np.sqrt(self.reduced_chi_square)
        if ratio > _NOTABLE:
            notes += f"; the residuals are {ratio:.3g} times the noise"
            if self.scale > 1:
                notes += ", and the standard errors are scaled by that"
        return notes


def _estimate(parameter: Parameter, errors: _Errors, index: int, active: bool) -> Estimate:
    declaration = parameter.declaration
    error = finite_or_none(errors.standard.get(index))
    return Estimate(
        value=errors.values[index],
        standard_error=error,
        unit=declaration.unit,
        lower=finite_or_none(declaration.lower),
        upper=finite_or_none(declaration.upper),
        free=True,
        remark=_remark(errors, index, declaration, error, active),
    )


def _remark(
    errors: _Errors, index: int, declaration: Declaration, error: float | None, active: bool
) -> str:
    if not active:
        return "not determined: no channel responds to it; left at its start"
    for group in errors.together:
        if index in group:
            others = ", ".join(errors.paths[i] for i in group if i != index)
            return f"not determined alone: only a combination with {others} is"
    if error is None:
        return "not determined: no channel responds to it where it ended"
    value = errors.values[index]
    for bound, name in ((declaration.lower, "lower"), (declaration.upper, "upper")):
        if abs(value - bound) < _AT_BOUND * error:
            return (
                f"at its {name} bound: the best value is the bound itself, and the standard error "
                "says how far from it the data allow"
            )
    if error > abs(value):
        return "barely determined: the standard error exceeds the value"
    row = errors.determined.index(index)
    if row in errors.partners:
        partner, correlation = errors.partners[row]
        other = errors.paths[errors.determined[partner]]
        return f"correlation {correlation:+.3f} with {other}"
    return ""


def _own_values(
    fitter: Fitter, errors: _Errors, runs: Sequence[Run]
) -> list[dict[str, dict[str, float | None]]]:
    """What was fitted of each run alone: value and standard error by path."""
    found: list[dict[str, dict[str, float | None]]] = [{} for _ in runs]
    for group in fitter.problem.groups:
        for member, columns in zip(group.members, group.own_columns(), strict=True):
            for label, column in zip(group.own_labels(), columns, strict=True):
                error = finite_or_none(errors.standard.get(int(column)))
                found[member][label] = {"value": errors.values[column], "standard_error": error}
    return found


def _run_record(
    run: Run,
    predicted: dict[str, np.ndarray],
    sigmas: dict[str, float],
    own: dict[str, dict[str, float | None]],
) -> dict[str, Any]:
    channels = {}
    for name, values in run.observations.items():
        channel = run.channels[name]
        difference = (predicted[name] - values)[~np.isnan(values)]
        rmse = float(np.sqrt(np.mean(difference**2)))
        channels[name] = {
            "unit": channel.unit,
            "rmse": finite_or_none(float(channel.from_si(rmse))),
            "n": len(difference),
            "noise": float(channel.from_si(sigmas[name])),
        }
    return {
        "name": run.name,
        "path": None if run.path is None else str(run.path),
        "sha256": run.sha256,
        "channels": channels,
        "parameters": own,
    }


def _gradient_check(fitter: Fitter) -> dict[str, Any] | None:
    """The Jacobian against a central difference at the optimum, at a finer tolerance.

    One direction in which every parameter has the same weight in the residual: a wrong column
    of any of them shows.
    """
    problem = dataclasses.replace(fitter.problem, model=fitter.problem.model.refined(_FINER))
    centre = np.asarray(fitter.coordinate)
    offset = _DIFFERENCE if centre.dtype == np.float64 else _DIFFERENCE_32
    jacobian = fitter.jacobian(fitter.evaluate(centre, problem))
    norms = jacobian.norms()
    direction = np.where(norms > 0, np.min(norms[norms > 0], initial=np.inf), 0.0)
    direction = np.divide(direction, norms, out=np.zeros_like(norms), where=norms > 0)
    # The strongest response gets the smallest offset; the weakest parameter moves by the step.
    ahead, behind = (
        np.asarray(fitter.evaluate(centre + sign * offset * direction, problem).residual)
        for sign in (1, -1)
    )
    by_difference = (ahead - behind) / (2 * offset)
    by_autodiff = jacobian.times(direction)
    relative = np.linalg.norm(by_autodiff - by_difference) / np.linalg.norm(by_autodiff)
    if not np.isfinite(relative):
        return None
    return {
        "relative_difference": float(relative),
        "direction": dict(zip(problem.paths, direction.tolist(), strict=False)),
        "step": offset,
    }


def _tolerance_effect(fitter: Fitter, errors: _Errors) -> dict[str, Any] | None:
    """How far the optimum moves, to first order, when the solver tolerance is halved."""
    if not errors.determined:
        return None
    problem = dataclasses.replace(fitter.problem, model=fitter.problem.model.refined(0.5))
    finer = np.asarray(fitter.evaluate(fitter.coordinate, problem).residual)
    change = finer - np.asarray(fitter.state.residual)
    jacobian = fitter.natural_jacobian()
    gram = np.linalg.pinv(jacobian.reduced()[:, errors.determined])
    shift = -gram @ (gram.T @ jacobian.transposed_times(change)[errors.determined])
    parameters = {}
    largest = 0.0
    for row, index in enumerate(errors.determined):
        moved = float(shift[row])
        error = float(errors.standard[index])
        relative = abs(moved) / error if error else np.inf
        largest = max(largest, relative)
        parameters[errors.paths[index]] = {
            "shift": finite_or_none(moved),
            "standard_errors": finite_or_none(relative),
        }
    return {
        "factor": 0.5,
        "largest_in_standard_errors": finite_or_none(largest),
        "by_parameter": parameters,
    }


def _versions() -> dict[str, str]:
    names = ("giajax", "jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")
    return {"python": platform.python_version(), **{name: version(name) for name in names}}
