"""Score tests: the decrease of chi-square of a fit due to one more column of the Jacobian.

The weighted residuals of a fit are r, its Jacobian is J, and z is the column of a fixed parameter.
Then z_perp = z - J (J^+ z) is the part of z that the fitted parameters cannot reproduce. A step of
-z_perp.r / z_perp.z_perp along it lowers the sum of squares by (z_perp.r)^2 / z_perp.z_perp (Rao's
score test; Cook & Weisberg 1982, sec. 2.2). The step ends at a bound.
"""

import dataclasses
from collections.abc import Sequence
from typing import Self

import numpy as np
from scipy.linalg import solve_banded
from scipy.special import fdtrc, stdtr

from ..fitting import (
    Direction,
    FitResult,
    Noise,
    Response,
    checked_priors,
    layout_of,
    prior_of,
    prior_row,
    resolved_ties,
    responses,
    tied,
)
from ..models import AbstractModel, capabilities
from ..noise import (
    Cells,
    ChannelNoise,
    Restricted,
    beyond_mixture,
    estimate,
    small_sample,
    tail,
    white_deviation,
    whitened,
)
from ..recordings import Run
from ..schema.parameters import declared, get, replace

Array = np.ndarray


def varied_values(result: FitResult) -> list[dict[str, float]]:
    """Return, for each run, the model parameters that not all runs share, by path."""
    known = declared(result.model)
    return [
        {
            path: estimate.value
            for path, estimate in record.parameters.items()
            if path in result.free and path.partition("[")[0] in known
        }
        for record in result.runs
    ]


def models_of_runs(result: FitResult) -> list[AbstractModel]:
    """Return the fitted model for each run."""
    ties = resolved_ties(result.model, result.config.get("ties", {}))
    return [
        tied(replace(result.model, values), ties) if values else result.model
        for values in varied_values(result)
    ]


def as_begun(result: FitResult) -> FitResult | None:
    """Return the result as if it had ended at its initial guess; None if that is unknown.

    It is unknown if runs have values of their own, because the history does not contain their
    initial guesses.
    """
    if not result.history or any(record.parameters for record in result.runs):
        return None
    values = {
        path: value for path, value in result.history[0].parameters.items() if path in result.free
    }
    model = replace(result.model, values)
    parameters = {
        path: dataclasses.replace(estimate, value=values.get(path, estimate.value))
        for path, estimate in result.parameters.items()
    }
    ties = resolved_ties(model, result.config.get("ties", {}))
    return dataclasses.replace(result, model=tied(model, ties), parameters=parameters)


def responses_of(
    result: FitResult,
    runs: Sequence[Run],
    model: AbstractModel,
    directions: Sequence[Direction] = (),
    *,
    variant: str | None = None,
) -> list[Response]:
    """Return the responses of each run at the end of a fit; tied parameters follow their ties.

    The model is the fitted one, with further parts or another choice. For another choice, `variant`
    is its name, and the values that not all runs share are taken from it. An `InputError` is raised
    if the model cannot be evaluated there or lacks a parameter that a tie requires.
    """
    values = varied_values(result)
    if variant is not None and any(values):
        others = [capabilities.variants(of_run)[variant] for of_run in models_of_runs(result)]
        values = [
            {path: float(get(other, path)) for path in of_run}
            for other, of_run in zip(others, values, strict=True)
        ]
    own = [
        {label: estimate.value for label, estimate in record.parameters.items()}
        for record in result.runs
    ]
    ties = resolved_ties(model, result.config.get("ties", {}))
    return responses(model, runs, directions, own, values=values, ties=ties)


@dataclasses.dataclass(frozen=True)
class Coordinates:
    """Coordinates of a fit: shared by several runs, or belonging to single runs.

    Attributes:
        places: for each run, the index of each free parameter among the shared coordinates; -1 if
            no other run has the parameter.
        shared: index of the free parameter of each shared coordinate.
        known: rows of the residual for the priors of shared coordinates, and their derivatives,
            shape (prior, 1 + shared).
        known_of_runs: for each run, the same for the coordinates that only this run has, shape
            (prior, 1 + own).
    """

    places: tuple[tuple[int, ...], ...]
    shared: tuple[int, ...]
    known: Array
    known_of_runs: tuple[Array, ...]

    @classmethod
    def of(cls, result: FitResult) -> Self:
        """Return the coordinates of a fit and their priors."""
        paths = list(result.free)
        layout = layout_of(result.runs, paths, result.config.get("groups", {}))
        order = [
            place
            for place in range(layout.size)
            if len(result.runs) < 2 or sum(place in of_run for of_run in layout.of_runs) != 1
        ]
        position = {place: index for index, place in enumerate(order)}
        places = tuple(
            tuple(position.get(place, -1) for place in of_run) for of_run in layout.of_runs
        )
        owners = {place: index for index, of in enumerate(layout.places) for place in of}
        shared = tuple(owners[place] for place in order)
        varied = varied_values(result)
        priors = checked_priors(result.config.get("priors", {}))

        def rows(named: Sequence[tuple[str, float]]) -> Array:
            """Return the rows of the priors of some coordinates, given their paths and values."""
            known = []
            for column, (path, value) in enumerate(named):
                if (prior := prior_of(priors, path)) is not None:
                    row = np.zeros(1 + len(named))
                    row[0], row[1 + column] = prior_row(prior, value)
                    known.append(row)
            return np.stack(known) if known else np.zeros((0, 1 + len(named)))

        def value_at(place: int) -> float:
            path = paths[owners[place]]
            of_run = next(run for run, there in enumerate(layout.of_runs) if place in there)
            return varied[of_run].get(path, float(result.free[path].value))

        of_runs = []
        for record, of_run, values in zip(result.runs, places, varied, strict=True):
            mine = [(paths[i], values[paths[i]]) for i, place in enumerate(of_run) if place < 0]
            mine += [
                (label, estimate.value)
                for label, estimate in record.parameters.items()
                if label not in values
            ]
            of_runs.append(rows(mine))
        return cls(
            places=places,
            shared=shared,
            known=rows([(paths[owners[place]], value_at(place)) for place in order]),
            known_of_runs=tuple(of_runs),
        )

    def split(self, run: int, columns: Array, own: Array) -> tuple[Array, Array]:
        """Split columns of the free parameters into shared coordinates and coordinates of a run.

        All arrays have the shape (sample, channel, column). The columns of the run come before its
        `own` columns, which belong to its initial state.
        """
        places = np.asarray(self.places[run], dtype=int)
        shared = np.zeros((*columns.shape[:2], len(self.shared)))
        shared[..., places[places >= 0]] = columns[..., places >= 0]
        return shared, np.concatenate([columns[..., places < 0], own], axis=-1)

    @property
    def size(self) -> int:
        """Number of coordinates."""
        return len(self.shared) + sum(rows.shape[1] - 1 for rows in self.known_of_runs)

    @property
    def squares(self) -> float:
        """Contribution of the priors to chi-square; each prior counts as a measurement."""
        rows = [self.known, *self.known_of_runs]
        return float(sum(np.sum(each[:, 0] ** 2) for each in rows))


# Relative tolerance for the rank of the columns of a fit.
_RANK = 1e-9


@dataclasses.dataclass(frozen=True)
class Table:
    """Weighted data of one run: each row is divided by its noise; cells without a value are 0.

    Attributes:
        residual: predicted minus recorded values, shape (sample, channel).
        measured: mask of the cells that are used, same shape.
        fitted: columns of the fitted parameters, shape (sample, channel, parameter).
        own: columns of the parameters that are free in this run alone, shape (sample, channel,
            own).
        asked: columns to be tested, shape (sample, channel, test).
        timed: whether the samples are a time series.
        known: rows of the residual for priors of the parameters that are free in this run alone,
            and their derivatives, shape (prior, 1 + own).
    """

    residual: np.ndarray
    measured: np.ndarray
    fitted: np.ndarray
    own: np.ndarray
    asked: np.ndarray
    timed: bool
    known: np.ndarray | None = None


@dataclasses.dataclass(frozen=True)
class Projected:
    """Residuals and tested columns without the part that the fitted parameters can reproduce.

    Attributes:
        residual: residuals of all cells, run by run, and of the priors, shape (row,).
        columns: tested columns, shape (row, test).
        norms: norms of the columns before the projection, shape (test,).
        parameters: number of fitted parameters, including those of single runs.
        lost: degrees of freedom that the parameters take from the measured values: their number
            minus the information from their priors.
        series: for each run and channel, the indices of its cells among the rows; -1 where nothing
            was measured. A series that is not timed contains only measured cells.
        timed: whether each series is a time series.
        known: indices of the rows that are priors.
    """

    residual: Array
    columns: Array
    norms: Array
    parameters: int
    lost: float
    series: tuple[Array, ...]
    timed: tuple[bool, ...]
    known: Array

    @property
    def values(self) -> int:
        """Number of measured values."""
        return len(self.residual) - len(self.known)

    @property
    def perpendicular(self) -> np.ndarray:
        """Norms of the columns after the projection, shape (test,)."""
        return np.asarray(np.linalg.norm(self.columns, axis=0))


def projected(tables: Sequence[Table], known: np.ndarray | None = None) -> Projected:
    """Project residuals and tested columns of all runs orthogonally to the fitted parameters.

    Parameters that are free in one run alone are first eliminated from that run (Frisch, Waugh and
    Lovell), so no matrix with the parameters of all runs is required. A prior is one more row of
    the residual, to which no tested column responds. It limits how well a fitted parameter can
    reproduce a tested column. `known` contains the priors of the parameters that all runs share,
    shape (prior, 1 + fitted).
    """
    parts, series, timed, priors = [], [], [], []
    first, own, norms, lost = 0, 0, 0.0, 0.0
    for table in tables:
        measured, asked = table.measured, table.asked[table.measured]
        cells = np.column_stack([table.residual[measured], table.fitted[measured], asked])
        norms = norms + np.sum(asked**2, axis=0)
        count, mine = len(cells), table.own[measured]
        if table.known is not None:
            cells = np.concatenate([cells, _rows(table.known[:, :1], cells.shape[1])])
            mine = np.concatenate([mine, table.known[:, 1:]])
        basis = basis_of(mine)
        own += basis.shape[1]
        lost += basis.shape[1] - np.sum(basis[count:] ** 2)
        parts.append(cells - basis @ (basis.T @ cells))
        place = np.full(measured.shape, -1)
        place[measured] = first + np.arange(count)
        priors.append(first + np.arange(count, len(cells)))
        first += len(cells)
        for column in place.T:
            series.append(column if table.timed else column[column >= 0])
            timed.append(table.timed)
    whole = np.concatenate(parts)
    if known is not None:
        priors.append(len(whole) + np.arange(len(known)))
        whole = np.concatenate([whole, _rows(known, whole.shape[1])])
    count = tables[0].fitted.shape[2]
    basis = basis_of(whole[:, 1 : 1 + count])
    of_priors = np.concatenate(priors)
    rest = np.concatenate([whole[:, :1], whole[:, 1 + count :]], axis=1)
    # The projection is repeated because a column that is nearly in the span loses most of its
    # significant digits.
    for _ in range(2):
        rest = rest - basis @ (basis.T @ rest)
    return Projected(
        residual=rest[:, 0],
        columns=rest[:, 1:],
        norms=np.sqrt(norms * np.ones(rest.shape[1] - 1)),
        parameters=basis.shape[1] + own,
        lost=float(lost + basis.shape[1] - np.sum(basis[of_priors] ** 2)),
        series=tuple(series),
        timed=tuple(timed),
        known=of_priors,
    )


def _rows(first: np.ndarray, columns: int) -> np.ndarray:
    """Append zero columns to rows."""
    return np.pad(first, ((0, 0), (0, columns - first.shape[1])))


def basis_of(columns: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the span of columns, shape (row, rank)."""
    norms = np.linalg.norm(columns, axis=0)
    kept = columns[:, norms > 0] / norms[norms > 0]
    if kept.shape[1] == 0:
        return np.zeros((len(columns), 0))
    left, singular, _ = np.linalg.svd(kept, full_matrices=False)
    return np.asarray(left[:, singular > _RANK * singular[0]])


def fitted_noise(result: FitResult, runs: Sequence[Run]) -> list[dict[str, float]]:
    """Return the standard deviations (SI) with which each run was weighted, by channel."""
    return [
        {
            name: float(run.channels[name].to_si(channel.noise))
            for name, channel in record.channels.items()
        }
        for run, record in zip(runs, result.runs, strict=True)
    ]


def white_noise(
    result: FitResult, runs: Sequence[Run], at: Sequence[Response]
) -> list[dict[str, float]]:
    """Return the standard deviations (SI) of white noise, by channel, from `white_deviation`."""
    deviations = []
    for run, response, weighted in zip(runs, at, fitted_noise(result, runs), strict=True):
        rest = response.predicted - response.observed
        each = {}
        for index, name in enumerate(response.channels):
            stated, in_time = run.noise(name), run.times is not None
            each[name] = white_deviation(rest[:, index], stated, weighted[name], in_time=in_time)
        deviations.append(each)
    return deviations


def cell_factors(result: FitResult, runs: Sequence[Run], at: Sequence[Response]) -> list[Array]:
    """Return the weights of the cells of each run, (sample, channel); 0 without a measurement.

    The weight is the inverse of the white noise of the channel, times the square root of the weight
    of the loss.
    """
    factors = []
    several = zip(at, white_noise(result, runs, at), fitted_noise(result, runs), strict=True)
    for response, *deviations in several:
        white, fitted = (np.asarray([of[n] for n in response.channels]) for of in deviations)
        rest = np.nan_to_num((response.predicted - response.observed) / fitted)
        psi = result.loss.scores(rest).psi
        weight = np.sqrt(np.where(rest == 0, 1.0, psi / np.where(rest == 0, 1.0, rest)))
        factors.append(np.where(np.isnan(response.observed), 0.0, weight / white))
    return factors


def weighted_rest(response: Response, predicted: Array, factor: Array) -> Array:
    """Return weighted predictions minus observations; 0 where nothing was observed."""
    rest = np.where(factor > 0, predicted - np.nan_to_num(response.observed), 0.0)
    return np.asarray(rest * factor)


def tables(
    at: Sequence[Response],
    runs: Sequence[Run],
    factors: Sequence[Array],
    coordinates: Coordinates,
) -> list[Table]:
    """Return the weighted residuals and columns of each run; fitted parameters come first."""
    weighted = []
    count = len(coordinates.places[0])
    for index, (response, run, factor) in enumerate(zip(at, runs, factors, strict=True)):
        each = factor[..., None]
        fitted, own = coordinates.split(index, response.columns[..., :count], response.own)
        weighted.append(
            Table(
                residual=weighted_rest(response, response.predicted, factor),
                measured=~np.isnan(response.observed),
                fitted=fitted * each,
                own=own * each,
                asked=response.columns[..., count:] * each,
                timed=run.times is not None,
                known=coordinates.known_of_runs[index],
            )
        )
    return weighted


# A column is not testable if the fitted parameters can reproduce all but this fraction, because
# only a ratio is identifiable.
IMITATED = 1e-4


@dataclasses.dataclass(frozen=True)
class Score:
    """Result of the test of one column, or of several columns together.

    Attributes:
        step: step from the fixed value, within the bounds, shape (column,).
        error: standard errors of the step, shape (column,).
        drop: decrease of the sum of squares.
        p_value: p-value, not corrected for the number of tests.
    """

    step: np.ndarray
    error: np.ndarray
    drop: float
    p_value: float


def score(
    rest: Projected, tests: Sequence[int], lower: Sequence[float], upper: Sequence[float]
) -> Score:
    """Test one column, or several columns together.

    The p-value refers to the whole step. The noise is estimated from the residuals after the step:
    white noise of at least the stated size, with the correlation of neighbouring samples along each
    channel of a run. The noise is estimated after the step because a missing effect itself causes
    correlated residuals.

    The lower bounds of the step must not be above 0 and the upper bounds not below 0. A bound of 0
    makes the test of a single column one-sided.
    """
    columns = rest.columns[:, list(tests)]
    gram = columns.T @ columns
    gradient = columns.T @ rest.residual
    inverse = np.linalg.pinv(gram, rcond=1e-10, hermitian=True)
    step = np.clip(-inverse @ gradient, lower, upper)
    # The sum of squares is a quadratic function of the step, evaluated at the clipped step.
    drop = max(float(-2 * gradient @ step - step @ gram @ step), 0.0)
    left = rest.residual + columns @ step
    spread, effective = _spread(rest, left, columns, len(tests))
    errors = np.sqrt(np.diag(inverse @ spread @ inverse))
    if len(tests) == 1:
        ratio = float(np.sqrt(drop * gram[0, 0] / spread[0, 0]))
        one_sided = lower[0] == 0 or upper[0] == 0
        p_value = float(stdtr(effective, -ratio)) * (1 if one_sided else 2)
        if one_sided and step[0] == 0:
            p_value = 1.0
    else:
        count = int(np.linalg.matrix_rank(gram, tol=1e-10 * float(np.max(np.abs(gram)))))
        wald = float(gradient @ np.linalg.pinv(spread, rcond=1e-10, hermitian=True) @ gradient)
        whole = float(gradient @ inverse @ gradient)
        wald *= drop / whole if whole > 0 else 0.0
        p_value = float(fdtrc(count, effective, wald / count))
    return Score(step, errors, drop, p_value)


def scatter(rest: Projected, tests: Sequence[int]) -> Score:
    """Test whether the amounts of some columns scatter with a common variance.

    The amounts are assumed to be normally distributed. U = |Z^T r|^2 of the columns Z is larger
    than without such a scatter, for which U is distributed as a sum of chi-square variables
    weighted with the eigenvalues of the covariance of the score (Lin 1997). The step is the common
    standard deviation, by the method of moments. The drop is the decrease of the sum of squares due
    to the best linear unbiased predictions of the amounts.
    """
    columns = rest.columns[:, list(tests)]
    gram, gradient = columns.T @ columns, columns.T @ rest.residual
    best = np.linalg.pinv(gram, rcond=1e-10, hermitian=True) @ gradient
    spread, _ = _spread(rest, rest.residual - columns @ best, columns, len(tests))
    statistic = float(gradient @ gradient)
    squares = float(np.sum(gram**2))
    variance = max((statistic - float(np.trace(spread))) / squares, 0.0)
    # The error follows from two moments of U if there is no scatter, and otherwise from the number
    # of amounts that the columns distinguish.
    unsure = float(np.sqrt(2 * np.sum(spread**2))) / squares
    step, told_apart = np.sqrt(variance), float(np.trace(gram)) ** 2 / squares
    amounts = variance * np.linalg.solve(np.eye(len(gram)) + variance * gram, gradient)
    drop = float(2 * amounts @ gradient - amounts @ gram @ amounts)
    error = np.hypot(unsure / (2 * step), step / np.sqrt(2 * told_apart)) if step else unsure**0.5
    p_value = beyond_mixture(np.linalg.eigvalsh(spread), statistic)
    return Score(np.array([step]), np.array([error]), max(drop, 0.0), p_value)


def _spread(
    rest: Projected, left: np.ndarray, columns: np.ndarray, tests: int
) -> tuple[np.ndarray, float]:
    """Return the covariance of the score for the remaining noise, and its degrees of freedom."""
    effective = 0.0
    # A prior has its stated standard deviation and is not correlated with other rows.
    of_priors = columns[rest.known]
    spread = of_priors.T @ of_priors
    share = 1 - (rest.lost + tests) / max(rest.values, 1)
    for place, timed in zip(rest.series, rest.timed, strict=True):
        measured = place >= 0
        if not (count := int(np.sum(measured))):
            continue
        noise = np.where(measured, left[place], 0.0)
        variance = max(float(np.sum(noise**2)) / max(share * count, 1.0), 1.0)
        rho = neighbours(noise, measured) if timed else 0.0
        part = np.where(measured[:, None], columns[place], 0.0)
        # Correlation of each value with all earlier values: y[t] = rho (y[t-1] + x[t-1]).
        bands = np.stack([np.ones(len(part)), np.full(len(part), -rho)])
        before = solve_banded((1, 0), bands, np.pad(rho * part[:-1], ((1, 0), (0, 0))))
        common = part.T @ before
        spread += variance * (part.T @ part + common + common.T)
        effective += count * (1 - rho) / (1 + rho)
    return spread, max(effective - rest.lost - tests, 3.0)


def neighbours(noise: np.ndarray, measured: np.ndarray) -> float:
    """Return the correlation of neighbouring samples, at least 0 (bias: Kendall 1954)."""
    pairs = int(np.sum(measured[1:] & measured[:-1]))
    power = float(np.sum(noise**2))
    if pairs < 8 or power == 0:
        return 0.0
    rho = float(np.sum(noise[1:] * noise[:-1])) / pairs / (power / int(np.sum(measured)))
    return float(np.clip(rho + (1 + 3 * rho) / pairs, 0.0, 0.99))


def alike(rest: Projected, one: Sequence[int], other: Sequence[int]) -> float:
    """Return the cosine of the largest angle between the spans of two sets of columns."""
    if len(one) == len(other) == 1:
        a, b = rest.columns[:, one[0]], rest.columns[:, other[0]]
        return float(abs(a @ b) / (np.linalg.norm(a) * np.linalg.norm(b)))
    a, b = basis_of(rest.columns[:, list(one)]), basis_of(rest.columns[:, list(other)])
    return float(np.min(np.linalg.svd(a.T @ b, compute_uv=False), initial=1.0))


def drop_beyond(rest: Projected, tests: Sequence[int], given: Sequence[int]) -> float:
    """Return the decrease of the sum of squares by some columns beyond that by others.

    It equals lambda^2 (1 - R^2), where R is the multiple correlation of a column with the others.
    """
    before = basis_of(rest.columns[:, list(given)])
    columns = rest.columns[:, list(tests)]
    beyond = basis_of(columns - before @ (before.T @ columns))
    return float(np.sum((beyond.T @ rest.residual) ** 2))


# Weight of a cell that a robust loss ignores. A weight of 0 would mean that there is no
# measurement.
_LEAST_WEIGHT = 1e-12


def slopes_of(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    columns: Sequence[int],
    coordinates: Coordinates,
) -> np.ndarray:
    """Return d(fitted)/d(fixed), shape (fitted, fixed).

    For parameters that not all runs share, the mean over the runs is returned. `columns` contains
    the indices of the fixed parameters among the responses. If the sum of squares is stationary
    with respect to the fitted parameters, d(theta)/dc = -(J^T J)^-1 J^T z, with all columns
    whitened by the weights of the fit.
    """
    fitted, shared = len(result.free), len(coordinates.shared)
    rows, of_runs = [], []
    for number, (response, run) in enumerate(zip(at, runs, strict=True)):
        common, own = coordinates.split(number, response.columns[..., :fitted], response.own)
        several = np.concatenate([common, response.columns[..., list(columns)], own], axis=-1)
        cells = _whitened(result, number, run, response, several)
        cells, own = np.split(cells, [shared + len(columns)], axis=1)
        # A prior is one more row, which does not depend on fixed parameters.
        known = coordinates.known_of_runs[number]
        cells = np.concatenate([cells, np.zeros((len(known), cells.shape[1]))])
        own = np.concatenate([own, known[:, 1:]])
        of_run = _explained(own, cells)
        rows.append(cells - own @ of_run)
        of_runs.append(of_run)
    known = np.pad(coordinates.known[:, 1:], ((0, 0), (0, len(columns))))
    jacobian, held = np.split(np.concatenate([*rows, known]), [shared], axis=1)
    common = -_explained(jacobian, held)
    by_path: list[list[np.ndarray]] = [[] for _ in result.free]
    for index, slope in zip(coordinates.shared, common, strict=True):
        by_path[index].append(slope)
    for places, of_run in zip(coordinates.places, of_runs, strict=True):
        alone = -(of_run[:, shared:] + of_run[:, :shared] @ common)
        # The values of the initial state of a run, which come last, are not parameters of the
        # model.
        mine = [index for index, place in enumerate(places) if place < 0]
        for index, slope in zip(mine, alone, strict=False):
            by_path[index].append(slope)
    means = [np.mean(slopes, axis=0) for slopes in by_path]
    # A fit of initial states alone has no slopes.
    return np.reshape(means, (len(means), len(columns)))


def _explained(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the least-squares solution, shape (column, row); columns may be dependent.

    Columns are normalised first because their magnitudes differ.
    """
    norms = np.linalg.norm(columns, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    coefficients: np.ndarray = np.linalg.lstsq(columns / norms, rows, rcond=_RANK)[0]
    return coefficients / norms[:, None]


def _whitened(
    result: FitResult, number: int, run: Run, response: Response, columns: np.ndarray
) -> np.ndarray:
    """Whiten columns (sample, channel, column) of the measured cells with the fit's weights."""
    loss, record = result.loss, result.runs[number]
    parts = []
    for index, name in enumerate(response.channels):
        measured = ~np.isnan(response.observed[:, index])
        channel, known = run.channels[name], record.channels[name]
        whole, correlated = (float(channel.to_si(one)) for one in (known.noise, known.correlated))
        noise = ChannelNoise.of_cell(whole, correlated, known.correlation_time_s)
        rest = (response.predicted - response.observed)[measured, index] / noise.deviation
        # The weight is the second derivative of the loss, because a residual beyond its threshold
        # exerts no further pull.
        weights = np.maximum(loss.scores(rest).curvature, _LEAST_WEIGHT)
        times = None if run.times is None else run.times[measured]
        parts.append(whitened(noise, times, columns[measured, index], weights))
    return np.concatenate(parts)


# Maximum number of columns for which the correction of Kenward and Roger is computed.
_FEW = 60


def among_memory(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    coordinates: Coordinates,
    columns: Sequence[Array],
    inward: int = 0,
) -> float:
    """Return the joint p-value of columns if correlated noise may explain the residuals instead.

    The noise of each channel is estimated again by restricted maximum likelihood, white or
    correlated, with the columns among the fitted ones. Residuals that correlated noise explains
    better are then not attributed to the columns. The p-value is computed by Wald's test of
    generalised least squares with the degrees of freedom of that noise.

    Arguments:
        result, runs, at, coordinates: the fit, its runs, their responses, and its coordinates.
        columns: columns of each run, shape (sample, channel, column).
        inward: the only permitted sign of the step of a single column; 0 for either.
    """
    fitted, asked = len(result.free), columns[0].shape[-1]
    noise = Noise.of(runs, per_run=bool(result.config.get("noise_per_run")))
    deviations = white_noise(result, runs, at)
    alone = len(runs) == 1
    cells: list[Cells] = []
    begun: dict[str, ChannelNoise] = {}
    for number, (run, response) in enumerate(zip(runs, at, strict=True)):
        common, own = coordinates.split(number, response.columns[..., :fitted], response.own)
        # With a single run, its own parameters are treated like all others.
        parts = [common, *([own] if alone else []), columns[number]]
        shared, own = np.concatenate(parts, axis=-1), own[..., : 0 if alone else None]
        rest = response.predicted - response.observed
        for place, name in enumerate(response.channels):
            kept, key = ~np.isnan(response.observed[:, place]), noise.keys[number][name]
            times, ones = None if run.times is None else run.times[kept], np.ones(int(np.sum(kept)))
            by = (rest[kept, place], shared[kept, place], own[kept, place])
            cells.append(Cells(key, number, times, ones, *by))
            begun.setdefault(key, ChannelNoise(deviations[number][name]))
    known, of_runs = coordinates.known, list(coordinates.known_of_runs)
    if alone:
        (mine,) = of_runs
        width = known.shape[1]
        known = np.concatenate(
            [_rows(known, width + mine.shape[1] - 1), np.insert(mine, [1] * (width - 1), 0, axis=1)]
        )
        of_runs = [np.zeros((0, 1))]

    def squares(rows: Array) -> Array:
        """Return X^T X of rows of priors, with the columns first and the residual last."""
        return np.roll(rows, -1, axis=1).T @ np.roll(rows, -1, axis=1)

    prior = squares(np.column_stack([known, np.zeros((len(known), asked))]))
    stated = noise.stated_by_key()
    found = estimate(Restricted.of(cells, begun, prior), stated, correlated=True)
    gram = prior
    for number, mine in enumerate(of_runs):
        those = [each for each in cells if each.run == number]
        whole = np.sum([each.gram(found.noise[each.key])[0] for each in those], axis=0)
        width, last = mine.shape[1] - 1, whole.shape[0] - 1
        places = [*range(width), last]
        whole[np.ix_(places, places)] += squares(mine)
        across = whole[:width, width:]
        inner = np.linalg.pinv(whole[:width, :width], rcond=1e-12, hermitian=True)
        gram = gram + whole[width:, width:] - across.T @ inner @ across
    norms = np.sqrt(np.diag(gram)[:-1])
    scale = np.outer(*[np.where(norms > 0, norms, 1.0)] * 2)
    covariance = np.linalg.pinv(gram[:-1, :-1] / scale, rcond=1e-12, hermitian=True) / scale
    step, freedom = (covariance @ gram[:-1, -1])[-asked:], np.inf
    if alone and len(covariance) <= _FEW:  # Several runs determine the noise well.
        covariance, degrees_of_freedom = small_sample(found, cells, covariance, stated)
        freedom = float(np.min(degrees_of_freedom[-asked:]))
    inner = np.linalg.pinv(covariance[-asked:, -asked:], rcond=1e-10, hermitian=True)
    p_value = tail(asked, freedom, float(step @ inner @ step) / asked)
    if not inward:
        return p_value
    # The residual is predicted minus recorded, so the best change is minus the step.
    return p_value / 2 if -step[0] * inward > 0 else 1.0
