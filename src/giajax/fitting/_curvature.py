"""Whether a standard error says how far the data let a parameter go: second derivatives.

A standard error takes the residuals to be straight in the parameters. Along the direction in which
a parameter moves by one standard error and all others follow it, the second derivative r'' of the
residuals r says how wrong that is: r . r'' is what Gauss-Newton leaves out of the Hessian, and
(r') . r'' makes the two sides unequal (Bates and Watts, "Nonlinear Regression Analysis", 1988,
chapter 7). Both are relative to |r'|^2. The third derivative is left out: it counts only where the
residuals are as large as what the parameter changes.
"""

from typing import NamedTuple

import numpy as np

from ._state import FitState
from ._statistics import Statistics
from ._transitions import evaluate, has_many_rows, residuals_at
from ._uncertainty import inverse_gram

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

    Arguments:
        state: the last one.
        statistics: of the fit.

    Returns:
        Without those at a bound, those that are known well, and those beside which the model
        cannot be evaluated.
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
    here = state.natural_jacobian().times(direction)
    residual = np.asarray(state.inner.residual, dtype=float)
    if bends:
        # Without derivatives, which take most of the time.
        second = 2 * (residuals_at(state, there) - residual - step * here) / step**2
    else:
        slopes = np.maximum(bijector.slope(there), 1e-300)
        ahead = state.jacobian(evaluate(state, there)).scaled(1 / slopes).times(direction)
        second = (ahead - here) / step
    length = float(here @ here)
    if length == 0 or not np.all(np.isfinite(second)):
        return None
    return Curvature(float(residual @ second) / length, float(here @ second) / length)
