"""Checks at the end of a fit: derivatives, integrator tolerance and nonlinearity."""

import contextlib
import dataclasses
import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..models import capabilities
from ..runtime.arrays import Float
from ..runtime.parallel import Tell, all_in_threads
from ..runtime.records import finite_or_none
from ._linearise import BlockJacobian
from ._problem import Problem
from ._records import GradientCheck, Shift, ToleranceEffect
from ._statistics import Statistics
from ._steps import FitState, at_tolerance, evaluate, has_many_rows, move, residuals_at, step
from ._uncertainty import inverse_gram

# Second derivatives show whether a standard error describes the range that the data allow.
#
# A standard error assumes that the residuals are linear in the parameters. Consider the direction
# in which a parameter moves by one standard error while all others follow to the lowest cost. Along
# it, the second derivative r'' of the residuals r measures the error of that assumption: r . r'' is
# the part of the Hessian that Gauss-Newton omits, and (r') . r'' makes the two sides unequal (Bates
# and Watts, "Nonlinear Regression Analysis", 1988, chapter 7). Both are relative to |r'|^2. The
# third derivative is neglected. It matters only if the residuals are as large as the change that
# the parameter causes.

# Step over which the Jacobian is differenced, as a fraction of a standard error. It is large
# compared with the integrator's error, and small enough that the third derivative is negligible.
_STEP = 0.1

# Step for recordings with many rows, whose second derivatives are computed from residuals alone.
# The curvature must exceed the integrator's error, which a shorter step (near a bound) would not
# achieve.
_STEP_OF_RESIDUALS = 0.5

# Each curvature requires one evaluation. Therefore only the parameters with the largest relative
# errors are checked, and none whose relative error is below `_SURE`: even a power of such a
# parameter has a relative curvature of at most that size within its error.
_MOST = 10
_SURE = 0.03


class Curvature(NamedTuple):
    """Curvature of the residuals within one standard error of a parameter.

    Attributes:
        left_out: part of the second derivative of the cost that Gauss-Newton omits, relative.
        skew: asymmetry of the two sides: third-order part at one standard error, relative.
    """

    left_out: float
    skew: float


def _curved(state: FitState, statistics: Statistics) -> list[int]:
    """Return the positions of the parameters whose curvature is computed.

    Parameters of single runs, parameters at a bound and parameters with small relative errors are
    omitted.
    """
    relative = {
        index: error / (abs(statistics.values[index]) or 1e-300)
        for index, error in statistics.standard_errors.items()
        if index < state.problem.shared and index not in statistics.bounds
    }
    asked = [i for i in sorted(relative, key=lambda i: -relative[i]) if relative[i] > _SURE]
    return sorted(asked[:_MOST])


def _curvature(state: FitState, statistics: Statistics, index: int) -> Curvature | None:
    """Return the curvature along a parameter; None if the model fails near it."""
    bijector, values = state.problem.bijector, statistics.values
    row = int(np.flatnonzero(statistics.alive == index)[0])
    # The parameter moves by its standard error, and the others follow to the lowest cost.
    following = inverse_gram(statistics.root)[row]
    direction = np.zeros(len(values))
    direction[statistics.alive] = following * statistics.standard_errors[index] / following[row]
    room = np.where(direction > 0, np.asarray(bijector.upper) - values, values - bijector.lower)
    with np.errstate(divide="ignore", invalid="ignore"):
        most = np.nanmin(np.where(direction == 0, np.inf, room / np.abs(direction)))
    bends = has_many_rows(state) and 0.5 * float(most) >= _STEP_OF_RESIDUALS
    step = _STEP_OF_RESIDUALS if bends else min(_STEP, 0.5 * float(most))
    if not step > 0:
        return None
    there = bijector.inverse(values + step * direction)
    here = state.natural_jacobian.times(direction)
    residual = np.asarray(state.inner.residual, dtype=float)
    if bends:
        # Residuals suffice. Their derivatives would take most of the time.
        second = 2 * (residuals_at(state, there) - residual - step * here) / step**2
    else:
        slopes = np.maximum(bijector.slope(there), 1e-300)
        ahead = state.jacobian_at(evaluate(state, there)).scaled(1 / slopes).times(direction)
        second = (ahead - here) / step
    length = float(here @ here)
    if length == 0 or not np.all(np.isfinite(second)):
        return None
    return Curvature(float(residual @ second) / length, float(here @ second) / length)


# The tolerance of the integrator is chosen by the shift of the estimates that it causes, in units
# of the standard error.
#
# An error of a residual that is small compared with the noise does not show that the tolerance
# suffices. The optimum shifts by the part of the error that the parameters can imitate. To first
# order the shift is R^-1 Q^T dr, where Q R is the factorised Jacobian and dr is the change of the
# residuals at a far finer tolerance. In units of the standard error, along all directions that the
# data determine, it is Q^T dr.

FINER = 0.01
"""Factor by which a tolerance is multiplied to measure its effect on the estimates.

A factor of 0.5 would underestimate this effect.
"""

# Factor for recordings with many rows. It takes two thirds of the time, and the rest of the effect
# is extrapolated.
_FINER_OF_MANY = 0.1

# Permitted shift, in standard errors: one fifth of the largest distance of a converged fit from the
# optimum.
_ALLOWED = 0.002
_TIGHTER = 0.1
# If the shift is at most this multiple of the permitted shift, the tolerance is reduced by half as
# many digits.
_LITTLE = 5.0
# If the shift that remains after a reduction of the tolerance is at most this fraction of the
# permitted shift, no finer simulation is tried before the optimum.
_ENOUGH = 0.8
# Largest shift, in standard errors, that is predicted to first order from a change of the
# residuals.
_NEAR = 0.1
_FINEST = 1e-10  # at a finer tolerance, rounding errors dominate the comparison

# A coordinate to which the residuals, divided by the noise, respond by less is ignored.
_RESPONSE = 1e-2
_SINGULAR = 1e-8  # smallest singular value of a direction that the data determine, relative

# If the roughness of the cost exceeds this fraction of the predicted decrease, it may hide the gain
# of a step.
_ROUGH = 0.01


def with_suitable_tolerance(state: FitState) -> FitState:
    """Return the state at the coarsest tolerance that has a negligible effect on the estimates.

    A specified tolerance stays. Otherwise the tolerance is reduced by a factor of ten, or by the
    square root of ten, and the state is evaluated again.
    """
    while state.setup.chooses_tolerance:
        compared = residual_change(state)
        change = compared * (1 - FINER) / (1 - finer_factor(state))
        moved = np.linalg.norm(_explained(state, change))
        # If the finer simulation fails, the shift is NaN, and the tolerance stays.
        allowed = _allowed(state)
        factor = _TIGHTER if moved > _LITTLE * allowed else _TIGHTER**0.5
        tighter = None
        if moved > allowed:
            tighter = _tightened(state, factor, _followed(state, change * (1 - factor)))
        if tighter is None:
            return dataclasses.replace(state, finer=compared)
        # Most of the remaining change is known at this point, without another, finer simulation.
        went = np.asarray(tighter.coordinate) - np.asarray(state.coordinate)
        before = np.asarray(state.inner.residual) + state.jacobian.times(went)
        left = change + before - np.asarray(tighter.inner.residual)
        if np.linalg.norm(_explained(tighter, left)) <= _ENOUGH * _allowed(tighter):
            return tighter
        state = dataclasses.replace(tighter, converged=state.converged)
    return state


def with_finer_tolerance(state: FitState, *, surely: bool = False) -> FitState | None:
    """Return the state at a finer tolerance if the tolerance may be why no step lowers the cost.

    The number of integrator steps varies with the parameters, which makes the residuals jump. Near
    the optimum these jumps of the cost exceed the gain of a step. The function returns None if the
    tolerance is specified or as fine as permitted, or if the cost is sufficiently smooth. With
    `surely`, the smoothness is not tested.
    """
    if not state.setup.chooses_tolerance:
        return None
    if surely:
        return _tightened(state)
    residuals = np.asarray(state.inner.residual)
    change = residual_change(state)
    roughness = abs(residuals @ change + change @ change / 2)
    return _tightened(state) if roughness > _ROUGH * state.predicted_decrease() else None


def can_improve(state: FitState) -> bool:
    """Return whether a step from an optimum would move it by more than the tolerance may.

    A fit that chooses its tolerance continues until it is as near to the optimum as that requires,
    unless the last step was rejected.
    """
    if not (state.setup.chooses_tolerance and bool(state.inner.accepted)):
        return False
    return bool(np.sqrt(2 * state.predicted_decrease()) > _allowed(state))


def finer_factor(state: FitState) -> float:
    """Return the factor on the tolerance, or on the model's own step size, for the comparison."""
    if state.tolerance is None:
        return 0.5
    return _FINER_OF_MANY if has_many_rows(state) else FINER


def residual_change(state: FitState) -> Float[np.ndarray, " residual"]:
    """Return the change of the residuals at a finer tolerance.

    The change is NaN if the finer simulation fails or the model cannot be refined.
    """
    if state.finer is not None:
        return state.finer
    model = capabilities.refined(state.problem.model, finer_factor(state))
    if model is None:
        return np.full(len(np.asarray(state.inner.residual)), np.nan)
    problem = dataclasses.replace(state.problem, model=model)
    return residuals_at(state, state.coordinate, problem) - np.asarray(state.inner.residual)


def _tightened(
    state: FitState, factor: float = _TIGHTER, shift: np.ndarray | float = 0.0
) -> FitState | None:
    """Return the state, shifted within its bounds, evaluated at a finer tolerance."""
    tolerance = state.tolerance
    if tolerance is None or tolerance < _FINEST * 1.5:
        return None
    tighter = at_tolerance(state, tolerance * factor)
    if np.any(shift):
        lower, upper = (np.asarray(each) for each in state.problem.bijector.ends())
        there = step(move(tighter, np.clip(np.asarray(state.coordinate) + shift, lower, upper)))
        if there.evaluated:
            return there
    tighter = step(tighter)
    return tighter if tighter.evaluated else None


def _allowed(state: FitState) -> float:
    """Return the permitted change along a unit direction, larger if residuals exceed the noise."""
    return _ALLOWED * max(1.0, state.residual_scale())


def _explained(state: FitState, row: np.ndarray) -> Float[np.ndarray, " direction"]:
    """Return the part of a row of residuals that parameters explain: Q^T row, up to a rotation."""
    singular, directions = _told(state)
    return directions @ state.jacobian.transposed_times(row) / singular


def _followed(state: FitState, row: np.ndarray) -> Float[np.ndarray, " parameter"]:
    """Return the shift of the optimum if the residuals change by `row`, to first order.

    The shift saves the step that would find the new optimum. It is zero if the state is not an
    optimum or if the shift is too large. Parameters at a bound stay there.
    """
    stays = np.zeros(state.problem.size)
    if not (state.converged and np.linalg.norm(_explained(state, row)) < _NEAR):
        return stays
    lower, upper = (np.asarray(each) for each in state.problem.bijector.ends())
    here = np.asarray(state.coordinate)
    singular, directions = _told(state, (here > lower) & (here < upper))
    gradient = state.jacobian.transposed_times(np.asarray(state.inner.residual) + row)
    moved = directions @ gradient / singular
    return -(moved / singular) @ directions if np.linalg.norm(moved) < _NEAR else stays


def _told(state: FitState, free: np.ndarray | bool = True) -> tuple[np.ndarray, np.ndarray]:
    """Return the singular values and the directions that the data determine.

    Returns:
        Change of the residuals along each direction, shape (direction,), and the directions in
        coordinates, shape (direction, parameter). Only `free` coordinates are included.
    """
    jacobian = state.jacobian
    norms = jacobian.norms()
    has_size = (norms > _RESPONSE) & free
    sizes = np.divide(1, norms, out=np.zeros_like(norms), where=has_size)
    _, singular, directions = np.linalg.svd(jacobian.scaled(sizes).reduced(), full_matrices=False)
    told = singular > _SINGULAR * np.max(singular, initial=0.0)
    return singular[told], directions[told] * sizes


# Finite differences in the free coordinate are central unless stated otherwise. They are computed
# at a tolerance at which the steps of the integrator are negligible. The truncation error and the
# numerical noise are then both near 1e-8.
_DIFFERENCE = 1e-4
_DIFFERENCE_32 = 3e-2
_FINER = 1e-3

# A response smaller than this fraction of the response of all runs is mainly numerical noise.
_TOLD = 1e-3
_FINE = 1e-9


class Checks(NamedTuple):
    """All checks. A check that could not be done is None or empty.

    Attributes:
        gradient: check of the Jacobian against a finite difference.
        tolerance: effect of the integrator tolerance on the estimates.
        curvatures: curvature along each checked parameter, by position.
        interrupted: whether Ctrl-C was pressed during the checks.
    """

    gradient: GradientCheck | None
    tolerance: ToleranceEffect | None
    curvatures: dict[int, Curvature]
    interrupted: bool


def checks(state: FitState, statistics: Statistics) -> Checks:
    """Return the checks of a finished fit. After Ctrl-C the completed checks are kept."""
    done, bent = Checks(None, None, {}, interrupted=True), dict[int, Curvature]()

    def bend(index: int, _: Tell) -> bool:
        found = _curvature(state, statistics, index)
        if found is not None:
            bent[index] = found
        return True

    # The fine Jacobian takes most of the time of all checks, so it begins first.
    jobs: list[Callable[[Tell], Any]] = [lambda _: _finely(state)]
    jobs += [functools.partial(bend, index) for index in _curved(state, statistics)]
    with contextlib.suppress(KeyboardInterrupt):
        done = done._replace(tolerance=tolerance_effect(state, statistics))
        fine, *_ = all_in_threads(jobs)
        done = done._replace(gradient=_gradient_check(state, statistics, *fine), interrupted=False)
    return done._replace(curvatures=dict(sorted(bent.items())))


def _finely(state: FitState) -> tuple[Problem, BlockJacobian]:
    """Return the problem at the tolerance of the gradient check, and a Jacobian at the optimum.

    The tolerance is at least 1e-10, and that of the Jacobian at least 1e-9, because a difference
    divides the errors of the integrator by its step. If many runs have the same channels, the
    Jacobian is that of a few of them, because one program differentiates all of them. For
    recordings with many rows, the tolerance is that of the fit, because a finer Jacobian would take
    as long as the fit.
    """
    tolerance = state.tolerance
    if tolerance is not None and has_many_rows(state):
        return state.problem, state.jacobian

    def refined(finest: float) -> Problem:
        finer = _FINER
        if tolerance is not None:
            finer = min(max(min(_FINER, _FINE / tolerance), finest / tolerance), 1.0)
        model = capabilities.refined(state.problem.model, finer)
        return dataclasses.replace(
            state.problem, model=state.problem.model if model is None else model
        )

    inner = evaluate(state, state.coordinate, refined(_FINE), sample=True)
    return refined(_FINEST), state.jacobian_at(inner)


def _gradient_check(
    state: FitState, statistics: Statistics, problem: Problem, jacobian: BlockJacobian
) -> GradientCheck | None:
    """Compare a Jacobian with a finite difference. The arguments are those of `_finely`.

    The difference is taken along one direction in which every parameter has the same weight in the
    residual, so an error in any column shows. Parameters at a bound are excluded, because no
    difference can be taken beyond it. Parameters to which no channel responds at their final values
    are excluded, too. At the tolerance of the fit, the difference is one-sided in 64 bit. The steps
    of the integrator then contribute about 1e-4, which is still small enough to detect a wrong
    column.

    Returns:
        The comparison, or None if no parameter is left or a simulation fails.
    """
    known_here, centre = problem is state.problem, np.asarray(state.coordinate)
    offset = _DIFFERENCE if centre.dtype == np.float64 else _DIFFERENCE_32
    norms = jacobian.norms()
    takes_part = np.zeros(problem.size, bool)
    takes_part[statistics.alive] = True
    takes_part[list(statistics.bounds)] = False
    # The difference cannot be taken beyond a bound.
    first, last = problem.bijector.ends()
    # If few runs are sampled and hardly respond to a parameter, they do not test its derivative.
    told = norms > _TOLD * state.jacobian.norms()
    takes_part &= told & (centre - first > offset) & (np.asarray(last) - centre > offset)
    if not np.any(takes_part):
        return None
    weakest = np.min(norms[takes_part])
    # The strongest response gets the smallest offset, and the weakest parameter moves by the step.
    direction = np.divide(weakest, norms, out=np.zeros_like(norms), where=takes_part)

    def at(shift: float) -> np.ndarray:
        return residuals_at(state, centre + shift * direction, problem, sample=not known_here)

    if known_here and centre.dtype == np.float64:
        by_difference = (at(offset) - np.asarray(state.inner.residual)) / offset
    else:
        ahead, behind = all_in_threads([lambda _: at(offset), lambda _: at(-offset)])
        by_difference = (ahead - behind) / (2 * offset)
    by_autodiff = jacobian.times(direction)
    relative = np.linalg.norm(by_autodiff - by_difference) / np.linalg.norm(by_autodiff)
    if not np.isfinite(relative):
        return None
    known = statistics.labels[: problem.shared]
    # The same program differentiates with respect to the values of the parameter in other runs.
    elsewhere = ~told
    elsewhere[list(statistics.bounds)] = False
    for places in map(list, problem.positions):
        takes_part[places] |= np.any(takes_part[places]) & elsewhere[places]
    return GradientCheck(
        relative_difference=float(relative),
        direction=dict(zip(known, direction.tolist(), strict=False)),
        step=offset,
        left_out=tuple(path for path, there in zip(known, takes_part, strict=False) if not there),
    )


def tolerance_effect(state: FitState, statistics: Statistics) -> ToleranceEffect | None:
    """Return the first-order shift of the optimum at a finer integrator tolerance.

    The finer tolerance is one hundredth of the current one, or one tenth for recordings with many
    rows. If the model has fixed steps instead of a tolerance, the steps are halved. The result is
    None if no parameter is determined or the finer simulation fails.
    """
    determined = list(statistics.determined)
    if not determined:
        return None
    change = residual_change(state)
    if not np.all(np.isfinite(change)):
        return None
    jacobian = state.natural_jacobian
    gram = np.linalg.pinv(jacobian.reduced()[:, determined])
    shifts = -gram @ (gram.T @ jacobian.transposed_times(change)[determined])
    by_parameter, largest = {}, 0.0
    for index, shift in zip(determined, shifts.tolist(), strict=True):
        error = statistics.standard_errors[index]
        relative = abs(shift) / error if error else np.inf
        largest = max(largest, relative)
        moved = Shift(finite_or_none(shift), finite_or_none(relative))
        by_parameter[statistics.labels[index]] = moved
    return ToleranceEffect(finer_factor(state), finite_or_none(largest), by_parameter)
