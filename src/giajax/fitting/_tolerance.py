"""The tolerance of the integrator: chosen by what it moves the estimates by, in standard errors.

That a residual is off by a small part of the noise says little: what counts is how much of the
error the parameters can imitate, because by that the optimum moves. To first order it is
R^-1 Q^T dr, of the factors of the Jacobian and the change dr of the residuals with a far finer
tolerance; in standard errors, along all directions that the data determine, it is Q^T dr.
"""

import dataclasses

import numpy as np

from .._typing import Float
from ._state import FitState
from ._transitions import (
    at_tolerance,
    has_many_rows,
    move,
    residuals_at,
    step,
    tolerance_of,
)

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
# Against a finer one there is nothing but rounding to compare with.
_FINEST = 1e-10

# A coordinate to which the residuals respond by less, in units of the noise, is no direction, ...
_RESPONSE = 1e-2
# ... nor is a combination that the data tell from the others by less than this.
_SINGULAR = 1e-8

# A cost that is rough by more than this part of what a step promises may hide what it gains.
_ROUGH = 0.01


def resolved(state: FitState) -> FitState:
    """The same point with a tolerance that moves nothing by more than the data tell.

    Arguments:
        state: evaluated; where the tolerance is stated, it is returned as it is.

    Returns:
        The same state, where its tolerance will do; else the point with the coarsest that does,
        in steps of ten or of its root, evaluated anew.
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
        before = np.asarray(state.inner.residual) + state.jacobian().times(went)
        left = change + before - np.asarray(tighter.inner.residual)
        if np.linalg.norm(_explained(tighter, left)) <= _ENOUGH * _allowed(tighter):
            return tighter
        state = dataclasses.replace(tighter, converged=state.converged)
    return state


def smoothed(state: FitState, *, surely: bool = False) -> FitState | None:
    """The point at which no step lowers the cost, where that may be the tolerance's fault.

    Steps of the integrator come and go as the parameters change, by which residuals jump. Near the
    optimum the jumps of the cost are larger than what a step could gain.

    Arguments:
        state: evaluated, at which no step is left.
        surely: that it is the tolerance's fault is known, and the cost is not asked.

    Returns:
        The point evaluated with a finer tolerance; None where the tolerance is stated or as fine
        as may be, or where the cost is smooth enough for a step to be seen.
    """
    if not state.setup.chooses_tolerance:
        return None
    if surely:
        return _tightened(state)
    residuals = np.asarray(state.inner.residual)
    change = residual_change(state)
    roughness = abs(residuals @ change + change @ change / 2)
    return _tightened(state) if roughness > _ROUGH * state.promised() else None


def is_promising(state: FitState) -> bool:
    """Whether a step from an optimum would move it by more than the tolerance may.

    A fit that chooses its tolerance ends as near to the optimum as that asks for, unless the last
    step was refused.
    """
    if not (state.setup.chooses_tolerance and bool(state.inner.accepted)):
        return False
    return bool(np.sqrt(2 * state.promised()) > _allowed(state))


def finer_factor(state: FitState) -> float:
    """What a tolerance, or what the model has in its place, is multiplied by to be compared."""
    if tolerance_of(state) is None:
        return 0.5
    return _FINER_OF_MANY if has_many_rows(state) else FINER


def residual_change(state: FitState) -> Float[np.ndarray, " residual"]:
    """What a finer tolerance changes of the residuals; NaN where the finer simulation fails."""
    if state.finer is not None:
        return state.finer
    model = state.problem.model.refined(finer_factor(state))
    problem = dataclasses.replace(state.problem, model=model)
    return residuals_at(state, state.coordinate, problem) - np.asarray(state.inner.residual)


def _tightened(
    state: FitState, factor: float = _TIGHTER, shift: np.ndarray | float = 0.0
) -> FitState | None:
    """The point, shifted within its bounds, evaluated with a finer tolerance."""
    tolerance = tolerance_of(state)
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
    return _ALLOWED * max(1.0, state.shown_noise())


def _explained(state: FitState, row: np.ndarray) -> Float[np.ndarray, " direction"]:
    """The part of a row of residuals that parameters can explain: Q^T of it, but for a rotation."""
    singular, directions = _told(state)
    return directions @ state.jacobian().transposed_times(row) / singular


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
    gradient = state.jacobian().transposed_times(np.asarray(state.inner.residual) + row)
    moved = directions @ gradient / singular
    return -(moved / singular) @ directions if np.linalg.norm(moved) < _NEAR else stays


def _told(state: FitState, free: np.ndarray | bool = True) -> tuple[np.ndarray, np.ndarray]:
    """How much the residuals change along each direction that the data tell, and the directions.

    Arguments:
        state: evaluated.
        free: which coordinates directions may have, shape (parameter,).

    Returns:
        Arrays of shape (direction,) and (direction, parameter), the latter in coordinates.
    """
    jacobian = state.jacobian()
    norms = jacobian.norms()
    has_size = (norms > _RESPONSE) & free
    sizes = np.divide(1, norms, out=np.zeros_like(norms), where=has_size)
    _, singular, directions = np.linalg.svd(jacobian.scaled(sizes).reduced(), full_matrices=False)
    told = singular > _SINGULAR * np.max(singular, initial=0.0)
    return singular[told], directions[told] * sizes
