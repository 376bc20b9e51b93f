"""Standard errors and correlations of what was fitted, and which of it the data determine."""

import dataclasses

import numpy as np

from ._identifiability import responds, undetermined_groups
from ._jacobian import BlockJacobian
from ._labels import labels
from ._noise_statistics import noise_statistics
from ._priors import Priors
from ._sources import sources
from ._state import FitState
from ._uncertainty import correlation_matrix, inverse_gram, reduced_chi_square, uncertainty

# A parameter this close to its bound, in standard errors, is at it.
_AT_BOUND = 0.1

# And this close in its own size: what is undetermined ends anywhere, and is at no bound.
_NEAR = 0.05


@dataclasses.dataclass(frozen=True)
class Statistics:
    """What the residuals and the Jacobian at the end say of the free parameters, by position.

    Attributes:
        labels: names of all free parameters, those of single runs with the run.
        values: of all of them, shape (parameter,).
        alive: those that the residuals respond to.
        together: groups of which only a combination is determined.
        determined: those that have a standard error of their own.
        standard_errors: of each determined one.
        freedom: degrees of freedom of Student's t for its interval, likewise.
        sandwich: standard error that does not trust the noise model, likewise; empty where none.
        widening: its error over that with white noise of the same size; empty where it is white.
        correlation: of the determined ones, in their order.
        root: R of the QR factorisation of the Jacobian, columns of `alive`.
        covariance: of `alive`.
        reduced_chi_square: sum of squared weighted residuals per degree of freedom.
        scale: factor on the covariance, 1 unless the residuals exceed the noise.
        bounds: of the parameters that ended at one: "lower" or "upper".
        prior_freedom: how many degrees of freedom of the parameters their priors know, and the
            measured values do not lose: they lose the trace of the hat matrix.
        prior_shares: how much of what is known of a parameter is its prior's: the variance of the
            estimate, were the noise as stated, over that of the prior.
        sources: what each recording is worth, by parameter; see `_sources`.
        bread: inverse of the second derivative of the cost, columns of `alive`: what the cost says
            of the parameters, where `covariance` is what the residuals say.
    """

    labels: tuple[str, ...]
    values: np.ndarray
    alive: np.ndarray
    together: tuple[tuple[int, ...], ...]
    determined: tuple[int, ...]
    standard_errors: dict[int, float]
    freedom: dict[int, float]
    sandwich: dict[int, float]
    widening: dict[int, float]
    correlation: np.ndarray
    root: np.ndarray
    covariance: np.ndarray
    reduced_chi_square: float
    scale: float
    bounds: dict[int, str]
    prior_freedom: float
    prior_shares: dict[int, float] = dataclasses.field(default_factory=dict)
    sources: dict[int, dict[str, float | None]] = dataclasses.field(default_factory=dict)
    bread: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


def statistics(state: FitState) -> Statistics:
    """The statistics of a fit where it ended."""
    problem = state.problem
    jacobian = state.natural_jacobian()
    moves = responds(jacobian.norms(), state.sizes)
    alive = np.flatnonzero(np.asarray(state.active) & moves)
    root = jacobian.reduced()[:, alive]
    together = tuple(tuple(int(alive[i]) for i in group) for group in undetermined_groups(root))
    loose = {index for group in together for index in group}
    determined = tuple(int(i) for i in alive if i not in loose)
    residuals, measured = weighted_residuals(state)
    cells = len(residuals) - len(problem.priors)
    shares = _prior_shares(problem.priors, jacobian, alive, root)
    known = sum(shares.values())
    white = np.asarray(state.inner.residual) if problem.loss == "linear" else residuals
    spread = uncertainty(
        white,
        jacobian,
        loss=problem.loss,
        measured=measured,
        columns=alive,
        priors=len(problem.priors),
        known=known,
        scaled=state.noise.weights is None,
    )
    by_noise = noise_statistics(state, alive, spread)
    rows = [int(np.flatnonzero(alive == i)[0]) for i in determined]
    covariance = by_noise.covariance[np.ix_(rows, rows)]
    errors = np.sqrt(np.diag(covariance))
    standard_errors = {i: float(error) for i, error in zip(determined, errors, strict=True)}
    return Statistics(
        labels=tuple(labels(problem, state.setup.runs)),
        values=state.values(),
        alive=alive,
        together=together,
        determined=determined,
        standard_errors=standard_errors,
        freedom=_of_each(determined, rows, by_noise.freedom),
        sandwich=_of_each(determined, rows, by_noise.sandwich),
        widening=_of_each(determined, rows, by_noise.widening),
        correlation=correlation_matrix(covariance),
        root=root,
        covariance=by_noise.covariance,
        reduced_chi_square=reduced_chi_square(
            (residuals * _against_stated(state))[:cells],
            loss=state.setup.loss,
            measured=measured[:cells],
            parameters=len(alive) - known,
        ),
        scale=spread.scale,
        bounds=_at_bounds(state, standard_errors),
        prior_freedom=known,
        prior_shares=shares,
        sources=sources(state, jacobian, alive),
        bread=spread.bread,
    )


def _of_each(
    determined: tuple[int, ...], rows: list[int], values: np.ndarray | None
) -> dict[int, float]:
    if values is None:
        return {}
    return {index: float(values[row]) for index, row in zip(determined, rows, strict=True)}


def _against_stated(state: FitState) -> np.ndarray:
    """The deviation in use over that which is stated, where one is; shape (residual,)."""
    noise = state.noise
    parts = []
    for group in state.problem.groups:
        for member in group.members:
            ratios = [
                noise.values[member][name].deviation / stated
                if (stated := noise.stated[member][name].deviation) is not None
                else 1.0
                for name in group.channels
            ]
            parts.append(np.tile(ratios, group.observed.shape[1]))
    return np.concatenate([*parts, np.ones(len(state.problem.priors))])


def weighted_residuals(state: FitState) -> tuple[np.ndarray, np.ndarray]:
    """Residuals in units of the noise before the loss transforms them, and which are measured.

    The rows of priors come last, and count as measured.
    """
    groups = state.problem.groups
    weights = np.concatenate([np.asarray(g.weight).ravel() for g in groups])
    observed = np.concatenate([np.asarray(g.observed).ravel() for g in groups])
    predicted = np.concatenate([np.asarray(p).ravel() for p in state.inner.aux.channels])
    measured = weights > 0
    known = np.asarray(state.inner.residual)[len(measured) :]
    rows = np.where(measured, (predicted - observed) * weights, 0.0)
    return np.append(rows, known), np.append(measured, np.ones(len(known), bool))


def _prior_shares(
    priors: Priors, jacobian: BlockJacobian, alive: np.ndarray, root: np.ndarray
) -> dict[int, float]:
    """How much of what is known of each parameter with a prior is the prior's."""
    if not len(priors):
        return {}
    variances = np.diag(inverse_gram(root))
    slopes = dict(zip(priors.columns, np.diag(jacobian.blocks[-1]), strict=True))
    return {
        index: min(float(slopes[index] ** 2 * variance), 1.0)
        for index, variance in zip(alive.tolist(), variances.tolist(), strict=True)
        if index in slopes
    }


def _at_bounds(state: FitState, standard_errors: dict[int, float]) -> dict[int, str]:
    """The determined parameters that ended at a bound, and at which."""
    bijector, values, sizes = state.problem.bijector, state.values(), state.sizes
    return {
        index: name
        for index, error in standard_errors.items()
        for name, bound in (("upper", bijector.upper[index]), ("lower", bijector.lower[index]))
        if np.isfinite(error)
        and abs(values[index] - bound) < min(_AT_BOUND * error, _NEAR * sizes[index])
    }
