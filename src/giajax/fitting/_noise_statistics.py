"""What estimated and correlated noise make of standard errors."""

import dataclasses
from typing import NamedTuple

import numpy as np

from .._typing import Float
from ..noise import Cells, Restricted, score_covariance, small_sample
from ._reestimate import OUTLIER
from ._residual_cells import residual_cells
from ._state import FitState
from ._uncertainty import Uncertainty, inverse_gram

# With more parameters than this (the initial states of many windows) the noise is known well, and
# what its errors add is not worth the time.
_MANY = 120


class NoiseStatistics(NamedTuple):
    """What the noise makes of the errors of the parameters that respond.

    Attributes:
        covariance: with what the errors of the noise add.
        freedom: of Student's t, shape (parameter,).
        sandwich: standard errors that hold whatever the noise model leaves out.
        widening: standard errors over those of white noise of the same size.
    """

    covariance: Float[np.ndarray, "parameter parameter"]
    freedom: Float[np.ndarray, " parameter"]
    sandwich: Float[np.ndarray, " parameter"] | None
    widening: Float[np.ndarray, " parameter"] | None


def noise_statistics(state: FitState, alive: np.ndarray, spread: Uncertainty) -> NoiseStatistics:
    """The statistics of a fit whose noise was estimated, or is correlated.

    Arguments:
        state: the last one.
        alive: positions of the parameters that respond.
        spread: their covariance, as if the noise were known.

    Returns:
        Them; a covariance of the same shape.
    """
    infinite = np.full(len(alive), np.inf)
    if state.problem.loss != "linear" or not 0 < len(alive) <= _MANY:
        return NoiseStatistics(spread.covariance, infinite, None, None)
    covariance = spread.as_stated
    noise = state.noise
    by_key, stated = noise.by_key(), noise.stated_by_key()
    slope = state.problem.bijector.slope(np.asarray(state.coordinate))
    dense = [
        dense_cells(weighted_cells(state, at, each), alive, slope)
        for at, each in residual_cells(state, together=True).items()
    ]
    # Outliers have no part in what is known of the noise.
    inliers = [each.where(each.weights > OUTLIER) for each in dense]
    prior, off = prior_rows(state, alive)
    known = np.column_stack([prior, off])
    problem = Restricted.of(inliers, by_key, known.T @ known)
    small = small_sample(problem, inliers, covariance, stated)
    with np.errstate(divide="ignore", invalid="ignore"):
        wider = np.sqrt(np.diag(small.covariance) / np.diag(covariance))
    larger = spread.covariance * np.outer(wider, wider)
    # What a prior says has the variance that it states, whatever the noise is.
    scores = score_covariance(dense, by_key, covariance)
    sandwich = np.sqrt(np.diag(scores + covariance @ prior.T @ prior @ covariance))
    if noise.is_white:
        return NoiseStatistics(larger, small.freedom, sandwich, None)
    rows = [each.shared / by_key[each.key].deviation for each in dense]
    triangle = np.asarray(np.linalg.qr(np.concatenate([*rows, prior]), mode="r"))
    white = np.sqrt(np.diag(inverse_gram(triangle)))
    with np.errstate(divide="ignore", invalid="ignore"):
        widening = np.sqrt(np.diag(larger)) / white
    return NoiseStatistics(larger, small.freedom, sandwich, widening)


def prior_rows(
    state: FitState, alive: np.ndarray
) -> tuple[Float[np.ndarray, "prior parameter"], Float[np.ndarray, " prior"]]:
    """The rows that are those of priors, by the parameters that respond, and their residuals."""
    count, columns = len(state.problem.priors), list(state.problem.priors.columns)
    rows = np.zeros((count, state.problem.size))
    if count:
        rows[:, columns] = state.natural_jacobian().blocks[-1]
    return rows[:, alive], np.asarray(state.inner.residual)[len(state.inner.residual) - count :]


def weighted_cells(state: FitState, at: tuple[int, str], cells: Cells) -> Cells:
    """Cells with the weights that robust statistics left them."""
    if state.noise.weights is None:
        return cells
    run, name = at
    weights = state.noise.weights[run][name]
    # As in `residual_cells`: a problem may leave out what its runs recorded.
    group = next(group for group in state.problem.groups if run in group.members)
    row, column = group.members.index(run), group.channels.index(name)
    counts = np.asarray(group.weight)[row, : len(weights), column] > 0
    return dataclasses.replace(cells, weights=weights[counts])


def dense_cells(cells: Cells, alive: np.ndarray, slope: np.ndarray) -> Cells:
    """With the columns of the parameters that respond, by the parameters themselves."""
    columns = cells.shared[:, alive] / np.maximum(slope[alive], 1e-300)
    return dataclasses.replace(cells, shared=columns)
