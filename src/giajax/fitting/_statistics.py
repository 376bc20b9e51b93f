"""Parameters and combinations of parameters that the data determine, and their statistics."""

import dataclasses
from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from ..runtime.text import format_estimate
from ._linearise import BlockJacobian
from ._steps import FitState, labels
from ._uncertainty import (
    COLLINEAR,
    correlation_matrix,
    inverse_gram,
    noise_statistics,
    reduced_chi_square,
    responds,
    sources,
    uncertainty,
    undetermined_groups,
)
from ._weights import Priors

_AT_BOUND = 0.1  # distance from a bound, in standard errors, of a parameter that is at the bound

# The same distance in units of the size of the parameter. An undetermined parameter may end
# anywhere and is not at a bound.
_NEAR = 0.05


@dataclasses.dataclass(frozen=True)
class Statistics:
    """Statistics of the free parameters at the end of a fit, by position.

    Attributes:
        labels: names of all free parameters. Those of single runs include the name of the run.
        values: values of all free parameters, shape (parameter,).
        alive: positions of the parameters that affect the residuals.
        together: groups of parameters of which only a combination is determined.
        determined: positions of the parameters with individual standard errors.
        standard_errors: standard error of each determined parameter.
        degrees_of_freedom: degrees of freedom of Student's t for the interval of each.
        sandwich: standard error of each without assuming the noise model. Empty if there is none.
        widening: standard error of each, relative to that for white noise of the same size. Empty
            if the noise is white.
        correlation: correlations of the determined parameters, in their order.
        root: R of the QR factorisation of the Jacobian, columns of `alive`.
        covariance: covariance of the parameters in `alive`.
        reduced_chi_square: sum of squared weighted residuals per degree of freedom.
        scale: factor on the covariance, 1 unless the residuals exceed the noise.
        bounds: "lower" or "upper" for each parameter that ended at a bound.
        prior_degrees_of_freedom: degrees of freedom of the parameters that the priors determine.
            The measured values lose only the rest, the trace of the hat matrix.
        prior_shares: share of the prior in the information on a parameter: variance of the estimate
            for the specified noise, divided by the variance of the prior.
        sources: contribution of each recording, by parameter (see `_uncertainty.sources`).
        noise_errors: standard errors if the nuisance parameters were known. Empty without nuisance
            parameters.
        bread: inverse of the second derivative of the cost, columns of `alive`. It follows from the
            cost alone, while `covariance` also depends on the residuals.
    """

    labels: tuple[str, ...]
    values: np.ndarray
    alive: np.ndarray
    together: tuple[tuple[int, ...], ...]
    determined: tuple[int, ...]
    standard_errors: dict[int, float]
    degrees_of_freedom: dict[int, float]
    sandwich: dict[int, float]
    widening: dict[int, float]
    correlation: np.ndarray
    root: np.ndarray
    covariance: np.ndarray
    reduced_chi_square: float
    scale: float
    bounds: dict[int, str]
    prior_degrees_of_freedom: float
    prior_shares: dict[int, float] = dataclasses.field(default_factory=dict)
    sources: dict[int, dict[str, float | None]] = dataclasses.field(default_factory=dict)
    bread: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    noise_errors: dict[int, float] = dataclasses.field(default_factory=dict)


def statistics(state: FitState) -> Statistics:
    """Return the statistics at the end of a fit."""
    problem = state.problem
    jacobian = state.natural_jacobian
    moves = responds(jacobian.norms(), state.sizes)
    alive = np.flatnonzero(np.asarray(state.active) & moves)
    root = jacobian.reduced()[:, alive]
    together = tuple(tuple(int(alive[i]) for i in group) for group in undetermined_groups(root))
    loose = {index for group in together for index in group}
    determined = tuple(int(i) for i in alive if i not in loose)
    residuals, measured = weighted_residuals(state)
    cells = len(residuals) - len(problem.priors.columns)
    shares = _prior_shares(problem.priors, jacobian, alive, root)
    known = sum(shares.values())
    white = np.asarray(state.inner.residual) if problem.loss.is_linear else residuals
    spread = uncertainty(
        white,
        jacobian,
        loss=problem.loss,
        measured=measured,
        columns=alive,
        priors=len(problem.priors.columns),
        known=known,
        scaled=state.noise.weights is None,
    )
    by_noise = noise_statistics(state, alive, spread)
    rows = [int(np.flatnonzero(alive == i)[0]) for i in determined]
    covariance = by_noise.covariance[np.ix_(rows, rows)]
    errors = np.sqrt(np.diag(covariance))
    standard_errors = {i: float(error) for i, error in zip(determined, errors, strict=True)}
    names = tuple(labels(problem, state.setup.runs))
    return Statistics(
        labels=names,
        values=state.values(),
        alive=alive,
        together=together,
        determined=determined,
        standard_errors=standard_errors,
        degrees_of_freedom=_of_each(determined, rows, by_noise.degrees_of_freedom),
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
        prior_degrees_of_freedom=known,
        prior_shares=shares,
        sources=sources(state, jacobian, alive),
        bread=spread.bread,
        noise_errors=_noise_errors(names, determined, covariance, state.setup.nuisances),
    )


def _noise_errors(
    names: Sequence[str],
    determined: tuple[int, ...],
    covariance: np.ndarray,
    nuisances: Sequence[str],
) -> dict[int, float]:
    """Return the standard errors of the requested parameters if the nuisances were known."""
    known = np.array([names[index] in nuisances for index in determined], dtype=bool)
    if not np.any(known) or np.all(known):
        return {}
    correlation = correlation_matrix(covariance)
    across = correlation[np.ix_(known, ~known)]
    inner = np.linalg.pinv(correlation[np.ix_(known, known)], rcond=1e-12, hermitian=True)
    alone = np.diag(covariance)[~known] * (1 - np.sum(across * (inner @ across), axis=0))
    asked = np.asarray(determined)[~known].tolist()
    return dict(zip(asked, np.sqrt(np.maximum(alone, 0.0)).tolist(), strict=True))


def _of_each(
    determined: tuple[int, ...], rows: list[int], values: np.ndarray | None
) -> dict[int, float]:
    if values is None:
        return {}
    return {index: float(values[row]) for index, row in zip(determined, rows, strict=True)}


def _against_stated(state: FitState) -> np.ndarray:
    """Return the ratio of the standard deviation in use to the specified one, shape (residual,).

    The ratio is 1 if none is specified.
    """
    noise = state.noise
    parts = []
    for batch in state.problem.batches:
        for member in batch.members:
            ratios = [
                noise.values[member][name].deviation / stated
                if (stated := noise.stated[member][name].deviation) is not None
                else 1.0
                for name in batch.channels
            ]
            parts.append(np.tile(ratios, batch.observed.shape[1]))
    return np.concatenate([*parts, np.ones(len(state.problem.priors.columns))])


def weighted_residuals(state: FitState) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals divided by the noise before the loss, and which of them are measured.

    The rows of the priors come last, and are measured.
    """
    batches = state.problem.batches
    weights = np.concatenate([np.asarray(batch.weight).ravel() for batch in batches])
    observed = np.concatenate([np.asarray(batch.observed).ravel() for batch in batches])
    predicted = np.concatenate([np.asarray(p).ravel() for p in state.inner.aux.channels])
    measured = weights > 0
    known = np.asarray(state.inner.residual)[len(measured) :]
    rows = np.where(measured, (predicted - observed) * weights, 0.0)
    return np.append(rows, known), np.append(measured, np.ones(len(known), bool))


def _prior_shares(
    priors: Priors, jacobian: BlockJacobian, alive: np.ndarray, root: np.ndarray
) -> dict[int, float]:
    """Return the share of the prior in the information on each parameter with a prior."""
    if not len(priors.columns):
        return {}
    variances = np.diag(inverse_gram(root))
    slopes = dict(zip(priors.columns, np.diag(jacobian.blocks[-1]), strict=True))
    return {
        index: min(float(slopes[index] ** 2 * variance), 1.0)
        for index, variance in zip(alive.tolist(), variances.tolist(), strict=True)
        if index in slopes
    }


def _at_bounds(state: FitState, standard_errors: dict[int, float]) -> dict[int, str]:
    """Return the determined parameters that ended at a bound, with the name of the bound."""
    bijector, values, sizes = state.problem.bijector, state.values(), state.sizes
    return {
        index: name
        for index, error in standard_errors.items()
        for name, bound in (("upper", bijector.upper[index]), ("lower", bijector.lower[index]))
        if np.isfinite(error)
        and abs(values[index] - bound) < min(_AT_BOUND * error, _NEAR * sizes[index])
    }


# Combinations of parameters that the data determine although they do not determine each parameter.
#
# A direction that leaves every channel unchanged may consist of a mass, a stiffness and a damping
# that increase by the same factor. Quantities that are constant along it are determined: stiffness
# / mass and damping / mass. The combinations of positive parameters are products of powers, because
# physical laws consist of products. Other combinations are sums, which are valid near the estimate.

# Component of a direction, with normalised columns, below which a parameter is not part of it.
_NOTHING = 0.01

# An exponent this close to a simple fraction equals it. The difference is an integration error.
_CLOSE = 0.02

# Smallest singular value at which parameters can represent directions.
_SOUND = 1e-3


@dataclasses.dataclass(frozen=True)
class Combination:
    """Combination of parameters that is determined, such as `joints.damping / links.mass`."""

    text: str
    members: tuple[int, ...]
    value: float
    standard_error: float

    def __str__(self) -> str:
        value, error = format_estimate(self.value, self.standard_error)
        return f"{self.text} = {value} +- {error}"


def combinations(
    statistics: Statistics, positive: Sequence[bool], usual: Sequence[bool]
) -> list[tuple[tuple[int, ...], list[Combination]]]:
    """Return the groups of undetermined parameters, and their determined combinations.

    A direction in which nothing is determined has no combinations.

    Arguments:
        statistics: statistics of the fit.
        positive: whether each free parameter cannot be negative.
        usual: whether a fit usually holds each parameter. Such a parameter becomes the denominator.
    """
    directions = _directions(statistics.root)
    if not len(directions):
        return []
    alive = statistics.alive.tolist()
    order = sorted(range(len(alive)), key=lambda i: (not usual[alive[i]], i))
    pivots = _pivots(directions, order)
    # Along the k-th row, only the k-th pivot moves.
    rows = np.linalg.solve(directions[:, pivots], directions)
    norms = np.linalg.norm(statistics.root, axis=0)
    groups = []
    for part in _connected(np.abs(rows) > _NOTHING, pivots):
        members = tuple(alive[i] for i in part)
        powers = all(positive[i] and statistics.values[i] > 0 for i in members)
        known = [
            _combination(statistics, i, pivots, rows, norms, powers=powers)
            for i in part
            if i not in pivots
        ]
        groups.append((members, known))
    return groups


def _directions(root: np.ndarray) -> np.ndarray:
    """Return the unit directions, for normalised columns, that leave every residual unchanged."""
    if root.shape[1] < 2:
        return np.zeros((0, root.shape[1]))
    _, singular, right = np.linalg.svd(root / np.linalg.norm(root, axis=0))
    return right[: len(singular)][singular < COLLINEAR * singular[0]]


def _pivots(directions: np.ndarray, order: Sequence[int]) -> list[int]:
    """Return one parameter for each direction, such that holding them leaves no direction."""
    pivots: list[int] = []
    for limit in (_SOUND, 0.0):
        for i in order:
            tried = [*pivots, i]
            least = np.linalg.svd(directions[:, tried], compute_uv=False)[-1]
            if len(pivots) < len(directions) and i not in pivots and least > limit:
                pivots = tried
    return pivots


def _connected(present: np.ndarray, pivots: Sequence[int]) -> list[list[int]]:
    """Return the connected groups of positions, sorted."""
    parts: list[set[int]] = []
    for row in present:
        part = set(np.flatnonzero(row).tolist())
        apart = [other for other in parts if not other & part]
        parts = [*apart, part.union(*(other for other in parts if other & part))]
    return [sorted(part) for part in parts]


def _combination(
    statistics: Statistics,
    index: int,
    pivots: Sequence[int],
    rows: np.ndarray,
    norms: np.ndarray,
    *,
    powers: bool,
) -> Combination:
    """Return the combination of a parameter and the pivots that is constant along the rows."""
    alive, values = statistics.alive.tolist(), statistics.values[statistics.alive]
    moves = {
        pivot: rows[k, index] * norms[pivot] / norms[index]
        for k, pivot in enumerate(pivots)
        if abs(rows[k, index]) > _NOTHING
    }
    gradient = np.zeros(len(alive))
    if powers:
        exponents: dict[int, Fraction | float] = {
            p: _simple(move * values[p] / values[index]) for p, move in moves.items()
        }
        value = values[index] / np.prod([values[p] ** float(e) for p, e in exponents.items()])
        gradient[index] = value / values[index]
        for pivot, exponent in exponents.items():
            gradient[pivot] = -value * float(exponent) / values[pivot]
        text = _product(statistics.labels[alive[index]], exponents, statistics.labels, alive)
    else:
        value = values[index] - sum(move * values[p] for p, move in moves.items())
        gradient[index] = 1.0
        for pivot, move in moves.items():
            gradient[pivot] = -move
        terms = [
            f"{'-' if move > 0 else '+'} {abs(move):.3g} {statistics.labels[alive[p]]}"
            for p, move in moves.items()
        ]
        text = " ".join([statistics.labels[alive[index]], *terms])
    error = float(np.sqrt(gradient @ statistics.covariance @ gradient))
    members = tuple(alive[i] for i in (index, *moves))
    return Combination(text, members, float(value), error)


def _simple(exponent: float) -> Fraction | float:
    near = Fraction(exponent).limit_denominator(4)
    return near if abs(float(near) - exponent) < _CLOSE else round(exponent, 2)


def _product(
    first: str,
    exponents: dict[int, Fraction | float],
    labels: Sequence[str],
    alive: Sequence[int],
) -> str:
    """Return `a / b`, `a * b` or `a / (b * c^2)`. `exponents` are those of the denominator."""

    def power(pivot: int, exponent: Fraction | float) -> str:
        size = exponent if exponent > 0 else -exponent
        name = labels[alive[pivot]]
        if size == 1:
            return name
        return f"{name}^{size}" if float(size).is_integer() else f"{name}^({size})"

    above = [first, *(power(p, e) for p, e in exponents.items() if e < 0)]
    below = [power(p, e) for p, e in exponents.items() if e > 0]
    over = " * ".join(above)
    if not below:
        return over
    return f"{over} / {below[0]}" if len(below) == 1 else f"{over} / ({' * '.join(below)})"
