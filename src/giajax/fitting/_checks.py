"""Checks at the end of a fit: its derivatives, a finer tolerance, and how straight it all is."""

import contextlib
import dataclasses
from typing import NamedTuple

import numpy as np

from ..models import capabilities
from ..runtime.arrays import Float
from ..runtime.records import finite_or_none
from ._records import GradientCheck, Shift, ToleranceEffect
from ._statistics import Statistics
from ._steps import FitState, at_tolerance, evaluate, has_many_rows, move, residuals_at, step
from ._uncertainty import inverse_gram

# Whether a standard error says how far the data let a parameter go: second derivatives.
#
# A standard error takes the residuals to be straight in the parameters. Along the direction in
# which a parameter moves by one standard error and all others follow it, the second derivative
# r'' of the residuals r says how wrong that is: r . r'' is what Gauss-Newton leaves out of the
# Hessian, and (r') . r'' makes the two sides unequal (Bates and Watts, "Nonlinear Regression
# Analysis", 1988, chapter 7). Both are relative to |r'|^2. The third derivative is left out: it
# counts only where the residuals are as large as what the parameter changes.

# Part of a standard error over which the Jacobian is differenced: far above the integrator's error
# and far below where the third derivative counts.
_STEP = 0.1

# And of recordings with many rows, where residuals are differenced, twice: their bend is to be seen
# beside the integrator's error, which a shorter step, beside a bound, would not do.
_STEP_OF_RESIDUALS = 0.5

# Each takes an evaluation. Of more parameters those with the largest relative errors are asked, and
# none that is known this well: a power of it bends by no more than that within its error.
_MOST = 10
_SURE = 0.03


class Curvature(NamedTuple):
    """How much the residuals bend within one standard error of a parameter.

    Attributes:
        left_out: what Gauss-Newton leaves out of the second derivative of the cost, relative.
        skew: how unequal the two sides are: the third-order part at one standard error, relative.
    """

    left_out: float
    skew: float


def curvatures(state: FitState, statistics: Statistics) -> dict[int, Curvature]:
    """Curvature along each determined parameter that is not of a single run, by position.

    Without those at a bound, those that are known well, and those beside which the model fails.
    """
    relative = {
        index: error / (abs(statistics.values[index]) or 1e-300)
        for index, error in statistics.standard_errors.items()
        if index < state.problem.shared and index not in statistics.bounds
    }
    asked = [i for i in sorted(relative, key=lambda i: -relative[i]) if relative[i] > _SURE]
    bent = {index: _curvature(state, statistics, index) for index in sorted(asked[:_MOST])}
    return {index: known for index, known in bent.items() if known is not None}


def _curvature(state: FitState, statistics: Statistics, index: int) -> Curvature | None:
    bijector, values = state.problem.bijector, statistics.values
    row = int(np.flatnonzero(statistics.alive == index)[0])
    # Where the parameter moves by its standard error, the others follow to the lowest cost.
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
        # Without derivatives, which take most of the time.
        second = 2 * (residuals_at(state, there) - residual - step * here) / step**2
    else:
        slopes = np.maximum(bijector.slope(there), 1e-300)
        ahead = state.jacobian_at(evaluate(state, there)).scaled(1 / slopes).times(direction)
        second = (ahead - here) / step
    length = float(here @ here)
    if length == 0 or not np.all(np.isfinite(second)):
        return None
    return Curvature(float(residual @ second) / length, float(here @ second) / length)


# The tolerance of the integrator: chosen by what it moves the estimates by, in standard errors.
#
# That a residual is off by a small part of the noise says little: what counts is how much of the
# error the parameters can imitate, because by that the optimum moves. To first order it is R^-1
# Q^T dr, of the factors of the Jacobian and the change dr of the residuals with a far finer
# tolerance; in standard errors, along all directions that the data determine, it is Q^T dr.

FINER = 0.01
"""What a tolerance is multiplied by to see what it moves; half of it would understate that."""

# And of recordings with many rows, in two thirds of the time: the rest is extrapolated.
_FINER_OF_MANY = 0.1

# What it may move, in standard errors: five times less than a converged fit may be off.
_ALLOWED = 0.002
_TIGHTER = 0.1
# Where it moves them by no more than this many times that, half as many digits are enough.
_LITTLE = 5.0
# Where a tenth of a tolerance leaves no more than this part of that, a hundredth need not be tried
# before the optimum.
_ENOUGH = 0.8
# Beyond this, in standard errors, an optimum is not said to follow a change of the residuals.
_NEAR = 0.1
_FINEST = 1e-10  # against a finer one there is nothing but rounding to compare with

# A coordinate to which the residuals respond by less, in units of the noise, is no direction, ...
_RESPONSE = 1e-2
_SINGULAR = 1e-8  # ... nor is a combination that the data tell from the others by less than this

# A cost that is rough by more than this part of what a step promises may hide what it gains.
_ROUGH = 0.01


def with_suitable_tolerance(state: FitState) -> FitState:
    """The point with a tolerance that moves nothing by more than the data tell: coarse as may be.

    A stated one stays; another is lowered in steps of ten or of its root, and evaluated again.
    """
    while state.setup.chooses_tolerance:
        compared = residual_change(state)
        change = compared * (1 - FINER) / (1 - finer_factor(state))
        moved = np.linalg.norm(_explained(state, change))
        # Of a finer simulation that fails nothing is known.
        allowed = _allowed(state)
        factor = _TIGHTER if moved > _LITTLE * allowed else _TIGHTER**0.5
        tighter = None
        if moved > allowed:
            tighter = _tightened(state, factor, _followed(state, change * (1 - factor)))
        if tighter is None:
            return dataclasses.replace(state, finer=compared)
        # What is left is known by now, but for a part, without a finer simulation yet.
        went = np.asarray(tighter.coordinate) - np.asarray(state.coordinate)
        before = np.asarray(state.inner.residual) + state.jacobian.times(went)
        left = change + before - np.asarray(tighter.inner.residual)
        if np.linalg.norm(_explained(tighter, left)) <= _ENOUGH * _allowed(tighter):
            return tighter
        state = dataclasses.replace(tighter, converged=state.converged)
    return state


def with_finer_tolerance(state: FitState, *, surely: bool = False) -> FitState | None:
    """The point at which no step lowers the cost, where that may be the tolerance's fault.

    Steps of the integrator come and go as the parameters change, by which residuals jump. Near the
    optimum the jumps of the cost are larger than what a step could gain. None where the tolerance
    is stated or as fine as may be, or the cost smooth enough; whether it is smooth is not asked
    where it is `surely` the tolerance.
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
    """Whether a step from an optimum would move it by more than the tolerance may.

    A fit that chooses its tolerance ends as near to the optimum as that requires, unless the last
    step was refused.
    """
    if not (state.setup.chooses_tolerance and bool(state.inner.accepted)):
        return False
    return bool(np.sqrt(2 * state.predicted_decrease()) > _allowed(state))


def finer_factor(state: FitState) -> float:
    """What a tolerance, or what the model has in its place, is multiplied by to be compared."""
    if state.tolerance is None:
        return 0.5
    return _FINER_OF_MANY if has_many_rows(state) else FINER


def residual_change(state: FitState) -> Float[np.ndarray, " residual"]:
    """What a finer tolerance changes of the residuals.

    NaN where the finer simulation fails, or the model cannot be refined.
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
    """The point, shifted within its bounds, evaluated with a finer tolerance."""
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
    """What may change along a unit direction: residuals larger than the noise widen the errors."""
    return _ALLOWED * max(1.0, state.residual_scale())


def _explained(state: FitState, row: np.ndarray) -> Float[np.ndarray, " direction"]:
    """The part of a row of residuals that parameters can explain: Q^T of it, but for a rotation."""
    singular, directions = _told(state)
    return directions @ state.jacobian.transposed_times(row) / singular


def _followed(state: FitState, row: np.ndarray) -> Float[np.ndarray, " parameter"]:
    """Where an optimum lies, to first order, where the residuals change by a row, from here.

    No step has to find it there then. Nothing where the state is none, or it would be too far; what
    is at a bound stays there.
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
    """How much the residuals change along each direction that the data tell, shape (direction,).

    And the directions, in coordinates, shape (direction, parameter); `free` ones alone.
    """
    jacobian = state.jacobian
    norms = jacobian.norms()
    has_size = (norms > _RESPONSE) & free
    sizes = np.divide(1, norms, out=np.zeros_like(norms), where=has_size)
    _, singular, directions = np.linalg.svd(jacobian.scaled(sizes).reduced(), full_matrices=False)
    told = singular > _SINGULAR * np.max(singular, initial=0.0)
    return singular[told], directions[told] * sizes


# Differences in the free coordinate, central where not said otherwise, at a tolerance where the
# steps of the integrator do not show: truncation and noise are then both near 1e-8.
_DIFFERENCE = 1e-4
_DIFFERENCE_32 = 3e-2
_FINER = 1e-3

# A response smaller than this part of that of all runs is rather noise.
_TOLD = 1e-3
_FINE = 1e-9


class Checks(NamedTuple):
    """All checks, None or nothing where one could not be done, and whether Ctrl-C came between."""

    gradient: GradientCheck | None
    tolerance: ToleranceEffect | None
    curvatures: dict[int, Curvature]
    interrupted: bool


def checks(state: FitState, statistics: Statistics) -> Checks:
    """The checks of a fit; it is done, and worth keeping, when Ctrl-C comes here."""
    done = Checks(None, None, {}, interrupted=True)
    with contextlib.suppress(KeyboardInterrupt):
        done = done._replace(gradient=gradient_check(state, statistics))
        done = done._replace(tolerance=tolerance_effect(state, statistics))
        done = done._replace(curvatures=curvatures(state, statistics), interrupted=False)
    return done


def gradient_check(state: FitState, statistics: Statistics) -> GradientCheck | None:
    """The Jacobian against a difference at the optimum, at a finer tolerance.

    The finer one is 1e-10 at least. One direction in which every parameter has the same weight
    in the residual: a wrong column of any of them shows. Parameters at a bound take no part,
    because there is nothing beyond it to take a difference with, nor do those that nothing
    responds to where they ended. Of many runs with the same channels, whose derivatives are one
    program, a few are looked at. Of recordings with many rows the tolerance is that of the fit,
    and in 64 bit the difference is to one side: the steps of the integrator then show, by some
    1e-4, but a wrong column still does, and the finer Jacobian would take as long as the fit.
    None where no parameter is left, or a simulation fails.
    """
    tolerance = state.tolerance
    known_here = tolerance is not None and has_many_rows(state)
    centre, problem = np.asarray(state.coordinate), state.problem
    offset = _DIFFERENCE if centre.dtype == np.float64 else _DIFFERENCE_32
    if known_here:
        jacobian = state.jacobian
    else:
        finer = _FINER
        if tolerance is not None:
            finer = min(max(min(_FINER, _FINE / tolerance), _FINEST / tolerance), 1.0)
        refined = capabilities.refined(problem.model, finer)
        problem = dataclasses.replace(problem, model=problem.model if refined is None else refined)
        jacobian = state.jacobian_at(evaluate(state, centre, problem, sample=True))
    norms = jacobian.norms()
    takes_part = np.zeros(problem.size, bool)
    takes_part[statistics.alive] = True
    takes_part[list(statistics.bounds)] = False
    # Beyond a bound there is nothing to take a difference with.
    first, last = problem.bijector.ends()
    # Of few runs, one that hardly responds to a parameter says nothing of its derivative.
    told = norms > _TOLD * state.jacobian.norms()
    takes_part &= told & (centre - first > offset) & (np.asarray(last) - centre > offset)
    if not np.any(takes_part):
        return None
    weakest = np.min(norms[takes_part])
    # The strongest response gets the smallest offset; the weakest parameter moves by the step.
    direction = np.divide(weakest, norms, out=np.zeros_like(norms), where=takes_part)

    def at(shift: float) -> np.ndarray:
        return residuals_at(state, centre + shift * direction, problem, sample=not known_here)

    if known_here and centre.dtype == np.float64:
        by_difference = (at(offset) - np.asarray(state.inner.residual)) / offset
    else:
        by_difference = (at(offset) - at(-offset)) / (2 * offset)
    by_autodiff = jacobian.times(direction)
    relative = np.linalg.norm(by_autodiff - by_difference) / np.linalg.norm(by_autodiff)
    if not np.isfinite(relative):
        return None
    known = statistics.labels[: problem.shared]
    # The same program differentiates by the value that a parameter has in other runs.
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
    """How far the optimum moves, to first order, with a finer solver tolerance.

    A hundredth of it, or a tenth for recordings with many rows; of a model that has no tolerance,
    but steps of its own, half of those. None where nothing is determined, or nothing finer
    succeeds.
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
