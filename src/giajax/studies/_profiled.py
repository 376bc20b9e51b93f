"""Profiled quantity: a free parameter or a derived quantity, and fits with it held."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ..fitting import BlockJacobian, FitResult, Optimum, Point, student_reach
from ..runtime.records import finite_or_none
from ..runtime.text import InputError, one_of

# Singular values of the normalised Jacobian below this fraction of the largest are rounding errors.
# The corresponding directions do not change the cost, but must not diverge.
_LEAST = 1e-7


def weights(jacobian: BlockJacobian, movable: np.ndarray) -> np.ndarray:
    """Return the inverse of J^T J for the columns that may move; zero elsewhere.

    Directions that leave all residuals unchanged receive a large but finite value.
    """
    norms = jacobian.norms()
    columns = np.flatnonzero(movable & (norms > 0))
    inverse = np.zeros((jacobian.size, jacobian.size))
    if not len(columns):
        return inverse
    root = jacobian.reduced()[:, columns] / norms[columns]
    _, singular, right = np.linalg.svd(np.linalg.qr(root, mode="r"))
    half = right.T / np.maximum(singular, _LEAST * singular[0]) / norms[columns][:, None]
    inverse[np.ix_(columns, columns)] = half @ half.T
    return inverse


def tangent(
    jacobian: BlockJacobian,
    gradient: np.ndarray,
    values: np.ndarray,
    bounds: tuple[np.ndarray, np.ndarray],
    side: int,
) -> np.ndarray:
    """Return the cheapest change of all parameters that changes a quantity by one.

    `gradient` is the gradient of the quantity. The quantity is to increase (side 1) or decrease
    (-1), and a parameter at a bound does not move beyond it. The result is zero if no parameter
    that may move changes the quantity.
    """
    movable = np.ones(len(values), dtype=bool)
    for _ in range(len(values) + 1):
        steepest = weights(jacobian, movable) @ gradient
        length = float(gradient @ steepest)
        if not length > 0:
            break
        direction = steepest / length
        leaves = movable & beyond(values, bounds, side * direction)
        if not np.any(leaves):
            return direction
        movable &= ~leaves
    return np.zeros(len(values))


def beyond(
    values: np.ndarray, bounds: tuple[np.ndarray, np.ndarray], step: np.ndarray
) -> np.ndarray:
    """Return which parameters are at a bound that a step would violate."""
    lower, upper = bounds
    return ((values <= lower) & (step < 0)) | ((values >= upper) & (step > 0))


# Best fit under the constraint that a quantity of several parameters has a given value.
#
# Levenberg-Marquardt steps with the linearised quantity as an additional equation. After each step
# the parameters are moved along the cheapest direction to where the quantity has its value to
# machine precision. Therefore only the cost has to decrease, and all points satisfy the constraint.

Quantity = Callable[[np.ndarray], tuple[float, np.ndarray]]
"""Function of the values of all free parameters that returns a value and its gradient."""

_MOST = 40

# A smaller predicted decrease of the cost is not worth another step.
_LITTLE = 1e-7
_SHORTEST, _ROUNDING, _CORRECTIONS = 1e-9, 1e-12, 30


class Followed(NamedTuple):
    """A fit with a quantity held: the values of all free parameters, SI, and how it ended.

    If nothing could be evaluated, the cost is infinite and there is no Jacobian of the residuals.
    The reason is one of `Refit`.
    """

    values: np.ndarray
    cost: float
    jacobian: BlockJacobian | None
    reason: str
    converged: bool


def constrained(optimum: Optimum, quantity: Quantity, held: float, start: np.ndarray) -> Followed:
    """Fit with a quantity held at a value, which the start need not satisfy."""
    bounds = optimum.bounds
    alive, bread = optimum.statistics.alive, optimum.statistics.bread
    metric = np.zeros((len(start), len(start)))
    # Parameters of which only a combination is determined may move, too.
    metric[np.ix_(alive, alive)] = bread + 1e-6 * np.diag(np.diag(bread))
    values = _restored(quantity, held, np.clip(start, *bounds), bounds, metric)
    if values is None:
        return Followed(start, np.inf, None, "wall", False)
    point = optimum.at(values)
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
            # No step is left. The cost is not smooth here, or it cannot be evaluated beyond.
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
    """Return the step that preserves the quantity, the metric, and the predicted decrease of cost.

    A parameter that would cross its bound stays on it, and the step of the others is solved for
    again.
    """
    jacobian = point.jacobian
    slope = jacobian.transposed_times(point.residual)
    norms = jacobian.norms()
    root = jacobian.reduced()
    normal = root.T @ root + damping * np.diag(norms**2)
    movable = norms > 0
    for _ in range(len(values) + 1):
        columns = np.flatnonzero(movable)
        metric, step = np.zeros_like(normal), np.zeros(len(values))
        if not len(columns):
            break
        # The matrix is scaled because the magnitudes of parameters differ.
        scaled = normal[np.ix_(columns, columns)] / np.outer(norms[columns], norms[columns])
        inverse = np.linalg.pinv(scaled, rcond=1e-14, hermitian=True)
        metric[np.ix_(columns, columns)] = inverse / np.outer(norms[columns], norms[columns])
        along, across = metric @ gradient, metric @ slope
        length = float(gradient @ along)
        if not length > 0:
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
    """Move the values to where the quantity has the held value; None if this is impossible."""
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


# First step of a quantity without a standard error, as a fraction of its magnitude.
_UNKNOWN = 0.1


@dataclasses.dataclass(frozen=True)
class Profiled:
    """A quantity of a fit, with the results of the fit for it.

    Attributes:
        name: label of a free parameter, or name of a derived quantity.
        unit: SI unit.
        value: estimate of the fit.
        error: standard error; None if it has none.
        freedom: degrees of freedom of Student's t for its interval.
        factor: factor by which the deviance of the cost is divided, so that its parabola has the
            width `error`. It is above 1 if the residuals exceed the noise, or if the noise was
            estimated from them.
        lower, upper: bounds, infinite if there is none.
        size: size of the first step.
        position: index of the free parameter; None for a derived quantity.
        quantity: function that returns the value and its gradient.
        fixed: whether no channel responds to it.
    """

    name: str
    unit: str
    value: float
    error: float | None
    freedom: float
    factor: float
    lower: float
    upper: float
    size: float
    position: int | None
    quantity: Quantity
    fixed: bool

    def reach(self, level: float) -> float:
        """Return the square root of the deviance at which an interval ends."""
        return student_reach(self.freedom, level)

    def linear(self, level: float) -> tuple[float, float] | None:
        """Return the interval of the standard error, within the bounds."""
        if self.error is None:
            return None
        width = self.reach(level) * self.error
        return max(self.value - width, self.lower), min(self.value + width, self.upper)

    def held(self, optimum: Optimum, value: float, start: np.ndarray) -> Followed:
        """Return the best fit with the quantity held, from given values of all free parameters."""
        if self.position is None:
            return constrained(optimum, self.quantity, value, start)
        ended = optimum.refit(held={self.name: value}, start=start)
        known = ended.state.evaluated
        # The Jacobian includes the column of the held parameter, because it gives the direction of
        # the others when the held parameter moves.
        everything = dataclasses.replace(ended.state, active=optimum.state.active)
        return Followed(
            values=ended.values,
            cost=ended.cost if known else np.inf,
            jacobian=everything.natural_jacobian if known else None,
            reason=ended.reason,
            converged=ended.converged,
        )


def quantity_names(result: FitResult, optimum: Optimum, asked: Sequence[str] | None) -> list[str]:
    """Return the names of the quantities to be profiled, as used by `profiled_of`.

    `asked` contains labels, paths (which stand for all values of an array, or of a parameter with
    one value per run) or names of derived quantities. None stands for all free parameters of the
    model that were requested.
    """
    shared = optimum.labels[: optimum.state.problem.shared]
    names: list[str] = []
    by_default = [label for label in shared if label not in result.nuisances]
    for path in by_default if asked is None else asked:
        found = (
            [path]
            if path in result.derived
            else [
                label
                for label in optimum.labels
                if path in (label, label.partition(" of ")[0], label.partition("[")[0])
            ]
        )
        if not found:
            known = one_of([*shared, *result.derived])
            raise InputError(
                f"'{path}' was neither free in this fit nor derived from free parameters: use one "
                f"of {known}"
            )
        names += found
    return list(dict.fromkeys(names))


def profiled_of(result: FitResult, optimum: Optimum, name: str) -> Profiled:
    """Return a quantity by its name, which is one of `quantity_names`."""
    statistics, position = optimum.statistics, None
    quantity: Quantity
    if (estimate := result.derived.get(name)) is not None:
        quantity = optimum.derived(name)
        value, gradient = quantity(optimum.values)
        error, unit, size = estimate.standard_error, estimate.unit, abs(value) or 1.0
        lower = -np.inf if estimate.lower is None else estimate.lower
        upper = np.inf if estimate.upper is None else estimate.upper
    else:
        position = index = optimum.position(name)
        value, gradient = float(optimum.values[index]), np.eye(len(optimum.labels))[index]
        error = finite_or_none(statistics.standard_errors.get(index))
        lower, upper = (float(bound[index]) for bound in optimum.bounds)
        path, size = name.partition(" of ")[0], float(optimum.state.sizes[index])
        unit = result.parameters[path].unit if path in result.parameters else "SI"

        def quantity(values: np.ndarray) -> tuple[float, np.ndarray]:
            return float(values[index]), gradient

    slope, factor = gradient[statistics.alive], statistics.scale
    if error is not None:
        # Ratio of the standard error to the standard error from the cost alone, squared.
        factor = (error / float(np.sqrt(slope @ statistics.bread @ slope))) ** 2
    # The smallest degrees of freedom of the parameters on which it depends.
    known = [statistics.degrees_of_freedom.get(int(i), np.inf) for i in np.flatnonzero(gradient)]
    return Profiled(
        name=name,
        unit=unit,
        value=value,
        error=error,
        freedom=min(known, default=np.inf),
        factor=factor,
        lower=lower,
        upper=upper,
        size=_UNKNOWN * size if error is None else error,
        position=position,
        quantity=quantity,
        fixed=not np.any(slope),
    )
