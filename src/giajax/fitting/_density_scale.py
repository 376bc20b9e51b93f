"""What makes a density of a cost: what it is divided by, and whether it has an integral."""

import numpy as np

from .._errors import InputError
from ._loss import scores
from ._optimum import Optimum
from ._statistics import Statistics, weighted_residuals
from ._uncertainty import inverse_gram

# A prior that says more than this of a parameter has set its standard error.
_MOSTLY = 0.5


def check_proper(statistics: Statistics, lower: np.ndarray, upper: np.ndarray) -> None:
    """Refuse a density whose integral is infinite.

    Arguments:
        statistics: of the fit.
        lower, upper: bounds, infinite where there is none, shape (parameter,).

    Raises:
        InputError: naming what neither data nor bounds limit.
    """
    open_ended = ~(np.isfinite(lower) & np.isfinite(upper))
    loose = [
        statistics.labels[index]
        for index in statistics.alive.tolist()
        if open_ended[index] and not np.isfinite(statistics.standard_errors.get(index, np.inf))
    ]
    if loose:
        raise InputError(
            "there is no posterior, because neither data nor two bounds limit "
            f"{' and '.join(loose)}: hold it, give it a prior or bounds, and fit again"
        )


def cost_scale(optimum: Optimum) -> float:
    """What the cost is divided by, so that its curvature gives the reported standard errors.

    With the usual loss that is the scale on the covariance, and what the errors of estimated noise
    add to it; with a robust one the ratio of its sandwich to the inverse curvature. The geometric
    mean over the parameters that are not mostly known by a prior.
    """
    problem, statistics = optimum.state.problem, optimum.statistics
    jacobian = optimum.state.natural_jacobian()
    weights = None
    if problem.loss != "linear":
        residuals, _ = weighted_residuals(optimum.state)
        _, curvature, slope = scores(problem.loss, residuals)
        data = np.arange(len(residuals)) < len(residuals) - len(problem.priors)
        weights = np.where(data, np.sqrt(np.maximum(curvature, 0.0)) / slope, 1.0)
    alive = statistics.alive
    with np.errstate(all="ignore"):
        known = np.diag(inverse_gram(jacobian.reduced(weights)[:, alive]))
        ratios = np.diag(statistics.covariance) / known
    rows = [
        row
        for row, index in enumerate(alive.tolist())
        if index in statistics.standard_errors
        and statistics.prior_shares.get(index, 0.0) < _MOSTLY
        and np.isfinite(ratios[row])
        and ratios[row] > 0
    ]
    return float(np.exp(np.mean(np.log(ratios[rows])))) if rows else statistics.scale
