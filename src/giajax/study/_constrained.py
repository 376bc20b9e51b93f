"""The best fit on which a quantity of several parameters has a given value.

Marquardt's steps of least squares with one more equation, the quantity to first order; after each,
the parameters go back to where the quantity has its value to the last digit, along the direction
that costs least. So the cost is all that is to fall, and only at points that keep the equation.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ..fitting import BlockJacobian, Optimum, Point
from ._tangent import beyond

Quantity = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""From the values of all free parameters to a value and its gradient."""

_MOST = 40

# Part of a unit of the noise that is not worth another step.
_LITTLE = 1e-7

_SHORTEST, _ROUNDING, _CORRECTIONS = 1e-9, 1e-12, 30


class Followed(NamedTuple):
    """A fit with a quantity held.

    Attributes:
        values: of all free parameters, SI.
        cost: as of `Optimum`; infinite where nothing could be evaluated.
        jacobian: of the residuals by the parameters there; None likewise.
        reason: as of `Refit`.
        converged: whether it is at an optimum of what was free.
    """

    values: np.ndarray
    cost: float
    jacobian: BlockJacobian | None
    reason: str
    converged: bool


def constrained(optimum: Optimum, quantity: Quantity, held: float, start: np.ndarray) -> Followed:
    """Fit with a quantity held.

    Arguments:
        optimum: the fit.
        quantity: what is held.
        held: its value.
        start: of all free parameters, shape (parameter,); the quantity need not have its value.

    Returns:
        Where it ended.
    """
    bounds = optimum.bounds
    alive, bread = optimum.statistics.alive, optimum.statistics.bread
    metric = np.zeros((len(start), len(start)))
    # What only a combination is known of may move, too.
    metric[np.ix_(alive, alive)] = bread + 1e-6 * np.diag(np.diag(bread))
    restored = _restored(quantity, held, np.clip(start, *bounds), bounds, metric)
    if restored is None:
        return Followed(start, np.inf, None, "wall", False)
    values, point = restored, optimum.at(restored)
    if not np.isfinite(point.cost):
        return Followed(values, np.inf, None, "wall", False)
    damping = 1e-6
    for _ in range(_MOST):
        step, metric, promised = _step(point, quantity(values)[1], values, bounds, damping)
        if promised < _LITTLE:
            return Followed(values, point.cost, point.jacobian, "optimum", True)
        moved = _restored(quantity, held, np.clip(values + step, *bounds), bounds, metric)
        tried = None if moved is None else optimum.at(moved)
        if moved is not None and tried is not None and tried.cost < point.cost:
            values, point, damping = moved, tried, max(damping / 10, 1e-12)
        elif damping > 1 / _SHORTEST:
            # No step is left: the cost is not smooth here, or it cannot be evaluated beyond.
            return Followed(values, point.cost, point.jacobian, "rough", promised < 0.01)
        else:
            damping = max(damping, 1e-6) * 10
    return Followed(values, point.cost, point.jacobian, "iterations", False)


def _step(
    point: Point,
    gradient: np.ndarray,
    values: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    damping: float,
) -> tuple[np.ndarray, np.ndarray, float]:
    """The step that leaves the quantity as it is, the metric, and by how much the cost is to fall.

    What would leave its bound stays on it, and the others are solved for again.
    """
    jacobian = point.jacobian
    slope = jacobian.transposed_times(point.residual)
    norms = jacobian.norms()
    root = jacobian.reduced()
    normal = root.T @ root + damping * np.diag(norms**2)
    movable = norms > 0
    metric, step = np.zeros_like(normal), np.zeros(len(values))
    for _ in range(len(values) + 1):
        columns = np.flatnonzero(movable)
        metric, step = np.zeros_like(normal), np.zeros(len(values))
        if not len(columns):
            break
        # Scaled, so that parameters of any size count alike.
        scaled = normal[np.ix_(columns, columns)] / np.outer(norms[columns], norms[columns])
        inverse = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
        metric[np.ix_(columns, columns)] = inverse / np.outer(norms[columns], norms[columns])
        along, across = metric @ gradient, metric @ slope
        length = float(gradient @ along)
        if not length > 0:
            step = np.zeros(len(values))
            break
        step = along * float(gradient @ across) / length - across
        leaves = movable & beyond(values, bounds, step)
        if not np.any(leaves):
            break
        movable &= ~leaves
    promised = -float(slope @ step + 0.5 * step @ (root.T @ (root @ step)))
    return step, metric, promised


def _restored(
    quantity: Quantity,
    held: float,
    values: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    metric: np.ndarray,
) -> np.ndarray | None:
    """The values moved to where the quantity is as it is held; None if there is no such place."""
    for _ in range(_CORRECTIONS):
        value, gradient = quantity(values)
        if not np.isfinite(value):
            return None
        missing = held - value
        if abs(missing) <= _ROUNDING * max(abs(held), abs(value)):
            return values
        along = metric @ gradient
        along = np.where(beyond(values, bounds, missing * along), 0.0, along)
        length = float(gradient @ along)
        if not length > 0:
            return None
        values = np.clip(values + along * missing / length, *bounds)
    return None
