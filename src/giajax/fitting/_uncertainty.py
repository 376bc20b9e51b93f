"""Residuals of a fit, their noise, the verdict on them, and standard errors."""

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..noise import (
    OUTLIER,
    Cells,
    Reason,
    Restricted,
    Series,
    Verdict,
    estimate,
    judge,
    outlier_weights,
    robust_deviation,
    score_covariance,
    small_sample,
    white_deviation,
)
from ..recordings import Run
from ..runtime.arrays import Float
from ._linearise import BlockJacobian
from ._losses import AbstractLoss, untransformed
from ._problem import predictions_by_run
from ._records import Status
from ._steps import FitState
from ._weights import Noise

# Residuals of a fit by cell, the noise that they show, and the verdict on the fit.


def residual_cells(state: FitState, *, together: bool = False) -> dict[tuple[int, str], Cells]:
    """Return the residuals and their derivatives in SI units, by position of the run and channel.

    They are neither weighted nor whitened. Held coordinates have no columns. Coordinates that
    affect only one run are its own columns. With `together`, every coordinate is a shared column,
    including the held ones.
    """
    jacobian, active = state.jacobian, np.asarray(state.active)
    if together:
        common, mine = list(range(state.problem.size)), set[int]()
    else:
        common, mine = shared_and_own(state)
    cells = {}
    at_block = iter(zip(jacobian.blocks, jacobian.columns, strict=True))
    for batch, tables in zip(state.problem.batches, state.inner.aux.channels, strict=True):
        for row, member in enumerate(batch.members):
            block, columns = next(at_block)
            weight = np.asarray(batch.weight, dtype=float)[row]
            predicted = np.asarray(tables, dtype=float)[row]
            difference = predicted - np.asarray(batch.observed)[row]
            if batch.whitening is not None:
                block = batch.whitening.of_run(row).undone(block)
            slope = state.problem.loss.scores((difference * weight).ravel()).slope
            block = untransformed(block, (slope * weight.ravel())[:, None])
            block = block.reshape(*weight.shape, -1)
            where = {int(column): position for position, column in enumerate(columns)}
            own = [where[c] for c in sorted(mine & set(where)) if active[c]]
            shared = [where.get(c, -1) for c in common]
            run = state.setup.runs[member]
            for at, name in enumerate(batch.channels):
                measured = weight[:, at] > 0
                # A last column of zeros represents coordinates that do not affect the run.
                columns_at = np.pad(block[measured, at], ((0, 0), (0, 1)))
                cells[member, name] = Cells(
                    key=state.noise.keys[member][name],
                    run=member,
                    times=None if run.times is None else run.times[measured[: len(run.times)]],
                    weights=np.ones(len(columns_at)),
                    residual=difference[measured, at],
                    shared=columns_at[:, shared],
                    own=columns_at[:, own],
                )
    return cells


def prior_gram(state: FitState) -> np.ndarray:
    """Return X^T X of the rows of priors, for the shared columns and the residual."""
    common, _ = shared_and_own(state)
    count, columns = len(state.problem.priors.columns), state.problem.priors.columns
    rows = np.zeros((count, len(common) + 1))
    if count:
        slopes = np.diag(state.jacobian.blocks[-1])
        residual = np.asarray(state.inner.residual)[-count:]
        for row, column, slope, value in zip(rows, columns, slopes, residual, strict=True):
            # The residual of a held parameter does not depend on the others.
            if column in common:
                row[common.index(column)], row[-1] = slope, value
    return np.asarray(rows.T @ rows)


def shared_and_own(state: FitState) -> tuple[list[int], set[int]]:
    """Return the positions of the shared active coordinates and of those of single runs.

    A coordinate of a single run with a prior is shared.
    """
    active = np.asarray(state.active)
    count = Counter(int(c) for columns in state.jacobian.columns for c in columns)
    several = len(state.setup.runs) > 1
    mine = {column for column, uses in count.items() if several and uses == 1}
    return [c for c in range(state.problem.size) if active[c] and c not in mine], mine


# Noise estimated from the residuals of a fit, if no sidecar specifies it.

# Residuals below this fraction of the largest recorded value are due to the solver tolerance.
TOLERANCE = 1e-5

_SETTLED = 0.1  # twice the gain in log-likelihood below which the noise has not changed

# Smallest change of the logarithm of a robust deviation, and smallest mean change of the weights,
# that count as a change.
_SAME_DEVIATION = 0.05
_SAME_WEIGHT = 0.01


def reestimate(state: FitState) -> Noise:
    """Return the noise for the next fit, unchanged if no channel changes noticeably."""
    noise = state.noise
    if noise.complete and not noise.correlated:
        return noise
    cells = residual_cells(state)
    perfect, robust = _perfect(cells, state.setup.runs), not state.setup.loss.is_linear
    if perfect and (noise.estimated or robust):
        # Rounding errors have no size to be estimated again.
        return dataclasses.replace(noise, estimated=not noise.complete)
    if robust:
        return _among_outliers(noise, cells, state.setup.runs, state.setup.loss)
    # The priors are omitted, because a wrong prior would look like noise with a long correlation
    # time.
    before = Restricted.of(list(cells.values()), noise.by_key())
    after = estimate(before, noise.stated_by_key(), correlated=noise.correlated and not perfect)
    if _gain(before, after) < _SETTLED:
        return dataclasses.replace(noise, estimated=not noise.complete)
    return noise.with_values(after.noise)


def _perfect(cells: dict[tuple[int, str], Cells], runs: Sequence[Run]) -> bool:
    """Return whether all residuals are within the tolerance of the solver."""
    return all(
        np.max(np.abs(each.residual), initial=0.0)
        <= TOLERANCE * np.nanmax(np.abs(runs[run].observations[name]))
        for (run, name), each in cells.items()
    )


def _gain(before: Restricted, after: Restricted) -> float:
    key = next(iter(before.noise))
    return before.value(key, before.noise[key]) - after.value(key, after.noise[key])


def _among_outliers(
    noise: Noise, cells: dict[tuple[int, str], Cells], runs: Sequence[Run], loss: AbstractLoss
) -> Noise:
    """Return the noise by robust statistics, with a weight for each cell if it is correlated."""
    stated, old = noise.stated_by_key(), noise.by_key()
    sizes = {
        key: each.times(robust_deviation(np.concatenate(residuals)) / each.deviation)
        if each.is_white and stated[key].deviation is None
        else each
        for key, each in old.items()
        for residuals in [[c.residual for c in cells.values() if c.key == key]]
    }
    if noise.correlated:
        weights = {
            at: outlier_weights(each, sizes[each.key], loss.weights) for at, each in cells.items()
        }
        # An outlier is not noise. It does not affect its size, and has little effect on the fit.
        least = loss.outlier_weight
        inliers = [each.where(weights[at] > least) for at, each in cells.items()]
        before = Restricted.of(inliers, sizes)
        after = estimate(before, stated, correlated=True)
        if not all(each.is_white for each in after.noise.values()):
            return _weighted(noise, weights, runs, _gain(before, after), after)
    change = max(abs(np.log(sizes[key].deviation / old[key].deviation)) for key in old)
    if change < _SAME_DEVIATION:
        return dataclasses.replace(noise, estimated=not noise.complete)
    return noise.with_values(sizes)


def _weighted(
    noise: Noise,
    weights: dict[tuple[int, str], np.ndarray],
    runs: Sequence[Run],
    gain: float,
    after: Restricted,
) -> Noise:
    """Return correlated noise, with the weight of each cell at its sample."""
    placed: list[dict[str, np.ndarray]] = [{} for _ in noise.keys]
    changes = []
    for (run, name), of_cells in weights.items():
        measured = ~np.isnan(runs[run].observations[name])
        placed[run][name] = np.ones(len(measured))
        placed[run][name][measured] = of_cells
        before = np.ones(1) if noise.weights is None else noise.weights[run][name][measured]
        changes.append(np.mean(np.abs(of_cells - before)))
    if noise.weights is not None and gain < _SETTLED and max(changes) < _SAME_WEIGHT:
        return noise
    return noise.with_values(after.noise, tuple(placed))


def verdict(state: FitState, status: Status, prior_degrees_of_freedom: float) -> Verdict:
    """Return whether the model describes the data at the best point of the fit."""
    series = residual_series(state, prior_degrees_of_freedom) if state.evaluated else []
    found = Verdict("adequate")
    if series:
        found = judge(series, robust=not state.setup.loss.is_linear)
    ended = {"not_converged": "did not converge", "interrupted": "was interrupted"}.get(status)
    if ended is None:
        return found
    sentence = f"the fit {ended}: this is the best point so far, not an optimum"
    return found.doubted(Reason("end", sentence, 1.0, 1.0))


def residual_series(state: FitState, prior_degrees_of_freedom: float) -> list[Series]:
    """Return the residuals of each channel of each run, except for perfect descriptions."""
    runs = state.setup.runs
    predictions = predictions_by_run(state.problem, state.inner.aux, runs)
    cells = sum(int(np.sum(~np.isnan(v))) for run in runs for v in run.observations.values())
    lost = float(np.sum(np.asarray(state.active))) - prior_degrees_of_freedom
    share = lost / max(cells, 1)
    series = []
    for number, (run, predicted) in enumerate(zip(runs, predictions, strict=True)):
        for name, recorded in run.observations.items():
            measured = ~np.isnan(recorded)
            difference = (predicted[name] - recorded)[measured]
            largest = float(np.max(np.abs(recorded[measured]), initial=0.0))
            if not len(difference) or np.max(np.abs(difference)) <= TOLERANCE * largest:
                continue
            times = None if run.times is None else run.times[measured]
            lost = share * len(difference)
            series.append(series_of(state, number, name, difference, times, lost=lost))
    return series


def series_of(
    state: FitState,
    number: int,
    name: str,
    residual: np.ndarray,
    times: np.ndarray | None,
    *,
    lost: float,
) -> Series:
    """Return the residuals (SI units) of a channel of a run with their known noise.

    Arguments:
        state: state of the fit.
        number: position of the run.
        name: name of the channel.
        residual: residuals.
        times: times of the residuals, or None.
        lost: number of degrees of freedom that the fit used.
    """
    noise = state.noise
    return Series(
        run=state.setup.runs[number].name,
        channel=name,
        residual=residual,
        times=times,
        stated=noise.stated[number][name].noise,
        key=noise.keys[number][name],
        adopted=noise.values[number][name].deviation,
        lost=lost,
    )


# Smallest response to a change of a parameter by its own size, divided by the noise. Below it, the
# standard error of the parameter alone would exceed a million times its value.
_NO_RESPONSE = 1e-6

# Ratio of the residuals to the noise above which the model does not describe the data. Neither more
# iterations nor a prior can change that.
FAR_OFF = 5.0


# Differences between neighbouring samples underestimate correlated noise, by this factor at a
# correlation of 0.8 between neighbours. With this factor, noise with a correlation of 0.98 does not
# yet count as a failure of the model.
_WITH_MEMORY = 2.5


def times_white_noise(state: FitState) -> float:
    """Return the ratio of the residuals to white noise.

    The noise of the fit may include effects that the model omits. If the noise is not specified,
    the residuals are divided by the largest white noise that a correlation allows. With a robust
    loss, outliers are omitted.
    """
    squares, count, robust = 0.0, 0, not state.setup.loss.is_linear
    for each in residual_series(state, 0.0):
        stated = None if each.stated is None else each.stated.deviation
        in_time = each.times is not None
        white = white_deviation(each.residual, stated, each.adopted, in_time=in_time)
        if stated is None:
            white = min(_WITH_MEMORY * white, max(each.adopted, white))
        rest = each.residual
        if robust and len(rest):
            # Outliers are rare. If most cells are far off, the model omits an effect.
            usual = max(each.adopted, robust_deviation(rest))
            rest = rest[np.abs(rest) <= OUTLIER * usual]
        squares += float(np.sum((rest / white) ** 2))
        count += len(rest)
    return float(np.sqrt(squares / max(count, 1)))


# Singular value, for normalised columns, below which a combination is not determined.
COLLINEAR = 1e-6


def responds(norms: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return whether any channel responds to each parameter.

    Arguments:
        norms: norms of the columns of the Jacobian with respect to the parameters themselves. The
            free coordinates have different sizes.
        sizes: typical sizes of the parameters.
    """
    return norms * sizes > _NO_RESPONSE


def undetermined_groups(jacobian: np.ndarray) -> list[list[int]]:
    """Return groups of parameters (columns of a Jacobian or its R) with undetermined combinations.

    A right singular vector of the column-normalised Jacobian with a vanishing singular value is a
    direction that leaves every channel unchanged. The parameters in it form a group.
    """
    if jacobian.shape[1] < 2:
        return []
    norms = np.linalg.norm(jacobian, axis=0)
    # A parameter to which no channel responds forms its own group.
    scaled = jacobian / np.where(norms > 0, norms, 1.0)
    _, singular, right = np.linalg.svd(np.linalg.qr(scaled, mode="r"))
    vectors = right[singular <= COLLINEAR * singular[0]]
    return [[i for i, part in enumerate(vector) if abs(part) > 0.01] for vector in vectors]


def largest_correlations(correlation: np.ndarray, limit: float) -> dict[int, tuple[int, float]]:
    """Return the partner with the largest correlation for each parameter, if it exceeds a limit."""
    partners = {}
    off = np.abs(correlation - np.diag(np.diag(correlation)))
    for i in range(len(correlation)):
        j = int(np.argmax(off[i]))
        if off[i, j] > limit:
            partners[i] = (j, float(correlation[i, j]))
    return partners


# If the fraction of residuals within the corner of a robust loss is smaller, its covariance is
# useless.
_FEW = 0.1


class Uncertainty(NamedTuple):
    """Covariance of the parameters and its scale.

    Attributes:
        covariance: covariance of the parameters.
        scale: factor on the covariance, 1 unless the residuals exceed the specified noise.
        as_stated: covariance for the specified noise.
        bread: inverse of the second derivative of the cost, in the Gauss-Newton approximation.
    """

    covariance: np.ndarray
    scale: float
    as_stated: np.ndarray
    bread: np.ndarray


def uncertainty(
    residual: np.ndarray,
    jacobian: BlockJacobian,
    *,
    loss: AbstractLoss,
    measured: np.ndarray,
    columns: np.ndarray,
    priors: int = 0,
    known: float = 0.0,
    scaled: bool = True,
) -> Uncertainty:
    """Return the covariance of least-squares and M-estimates.

    For the linear loss it is (J^T J)^-1, multiplied by the reduced chi-square if that exceeds 1,
    because the specified noise then does not cover the residuals (the scale factor of the Particle
    Data Group). For robust losses it is the sandwich A^-1 B A^-1 with A = sum psi' j j^T and B =
    sum psi^2 j j^T (Huber 1981, ch. 6), which needs no further scale. The residuals do not change
    the variance of a prior: in both cases, the rows of priors keep their specified variance.

    Arguments:
        residual: weighted, whitened residuals before the loss, shape (residual,).
        jacobian: derivative of the transformed residuals with respect to the parameters.
        loss: loss function.
        measured: which residuals belong to a measured cell, shape (residual,).
        columns: parameters for which the covariance is computed.
        priors: number of last rows that belong to priors, which no loss transforms.
        known: number of degrees of freedom of the parameters that the priors determine.
        scaled: whether residuals that exceed the noise scale the covariance. It must be false if
            cells have weights, because the residuals still include outliers.
    """
    data = np.arange(len(residual)) < len(residual) - priors
    count, size = int(np.sum(measured & data)), len(columns)
    # The residual of a prior contains no information on the noise.
    degrees_of_freedom = max(count - (size - known), 1)
    reduced = float(np.sum(residual[measured & data] ** 2) / degrees_of_freedom)
    _, psi, curvature, slope = loss.scores(residual)

    def root_of_gram(weights: np.ndarray | float) -> np.ndarray:
        # Unmeasured cells have zero rows. Their slope is that of a zero residual.
        return jacobian.reduced(np.where(data, untransformed(weights, slope), 1.0))[:, columns]

    plain = root_of_gram(1.0)
    mean_curvature = float(np.mean(curvature[measured & data])) if count else 1.0
    if loss.is_linear or mean_curvature < _FEW:
        # With a robust loss, almost every residual is an outlier, so the inverse curvature is
        # undefined.
        scale = max(1.0, reduced) if scaled else 1.0
        bread = inverse_gram(plain)
        if not priors or scale == 1:
            return Uncertainty(bread * scale, scale, bread, bread)
        root = root_of_gram(np.sqrt(scale))
        return Uncertainty(bread @ (root.T @ root) @ bread, scale, bread, bread)
    # A residual beyond the corner of the loss has no curvature. The mean keeps A positive.
    bread = inverse_gram(root_of_gram(np.sqrt(mean_curvature)))
    root = root_of_gram(psi * np.sqrt(count / degrees_of_freedom))
    covariance = bread @ (root.T @ root) @ bread
    return Uncertainty(covariance, 1.0, covariance, bread)


def reduced_chi_square(
    residual: np.ndarray, *, loss: AbstractLoss, measured: np.ndarray, parameters: float
) -> float:
    """Return the sum of squared residuals, divided by the noise variance, per degree of freedom.

    For a robust loss psi replaces the residual. Its mean square for normal noise is scaled to 1, so
    that a few outliers do not count as larger noise (Huber 1981, section 7.6). `parameters` is the
    number of fitted parameters, minus the part that priors determine.
    """
    psi = loss.scores(residual[measured]).psi
    degrees_of_freedom = max(int(np.sum(measured)) - parameters, 1)
    return float(np.sum(psi**2) / degrees_of_freedom / loss.mean_square)


def correlation_matrix(covariance: np.ndarray) -> np.ndarray:
    """Return the correlations of a covariance, NaN where a variance is not finite."""
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(all="ignore"):
        correlation = covariance / np.outer(deviations, deviations)
    return np.clip(correlation, -1, 1)


def inverse_gram(jacobian: np.ndarray) -> np.ndarray:
    """Return (J^T J)^-1 of a matrix J, or of its R, by QR with scaled columns.

    This does not square the condition number. Directions that leave the residuals unchanged are
    omitted. Parameters outside these directions keep their variance, and the variances of the
    others are meaningless.
    """
    if jacobian.shape[1] == 0:
        return np.zeros((0, 0))
    norms = np.linalg.norm(jacobian, axis=0)
    _, singular, right = np.linalg.svd(np.linalg.qr(jacobian / norms, mode="r"))
    kept = singular > COLLINEAR * singular[0]
    inverse = right[kept].T / singular[kept] / norms[:, None]
    return inverse @ inverse.T


# Effect of estimated and correlated noise on standard errors.

# With more parameters (such as initial states of many windows) the noise is known well, and its
# uncertainty is not worth the computing time.
_MANY = 120


class NoiseStatistics(NamedTuple):
    """Effect of the noise on the errors of the parameters to which channels respond.

    Attributes:
        covariance: covariance including the uncertainty of the noise.
        degrees_of_freedom: degrees of freedom of Student's t.
        sandwich: standard errors that remain valid if the noise model is wrong.
        widening: standard errors divided by those for white noise of the same size.
    """

    covariance: Float[np.ndarray, "parameter parameter"]
    degrees_of_freedom: Float[np.ndarray, " parameter"]
    sandwich: Float[np.ndarray, " parameter"] | None
    widening: Float[np.ndarray, " parameter"] | None


def noise_statistics(state: FitState, alive: np.ndarray, spread: Uncertainty) -> NoiseStatistics:
    """Return the statistics of a fit whose noise was estimated or is correlated."""
    infinite = np.full(len(alive), np.inf)
    if not state.problem.loss.is_linear or not 0 < len(alive) <= _MANY:
        return NoiseStatistics(spread.covariance, infinite, None, None)
    covariance = spread.as_stated
    noise = state.noise
    by_key, stated = noise.by_key(), noise.stated_by_key()
    slope = state.problem.bijector.slope(np.asarray(state.coordinate))
    dense = [
        dense_cells(weighted_cells(state, at, each), alive, slope)
        for at, each in residual_cells(state, together=True).items()
    ]
    # Outliers do not contribute to the information on the noise.
    least = state.setup.loss.outlier_weight
    inliers = [each.where(each.weights > least) for each in dense]
    prior, off = prior_rows(state, alive)
    known = np.column_stack([prior, off])
    problem = Restricted.of(inliers, by_key, known.T @ known)
    small = small_sample(problem, inliers, covariance, stated)
    with np.errstate(divide="ignore", invalid="ignore"):
        wider = np.sqrt(np.diag(small.covariance) / np.diag(covariance))
    larger = spread.covariance * np.outer(wider, wider)
    # Priors have their specified variance, independent of the noise.
    scores = score_covariance(dense, by_key, covariance)
    sandwich = np.sqrt(np.diag(scores + covariance @ prior.T @ prior @ covariance))
    if noise.is_white:
        return NoiseStatistics(larger, small.degrees_of_freedom, sandwich, None)
    rows = [each.shared / by_key[each.key].deviation for each in dense]
    triangle = np.asarray(np.linalg.qr(np.concatenate([*rows, prior]), mode="r"))
    white = np.sqrt(np.diag(inverse_gram(triangle)))
    with np.errstate(divide="ignore", invalid="ignore"):
        widening = np.sqrt(np.diag(larger)) / white
        if trends(state):
            shrunk = np.maximum(1 / widening, 1.0)
            larger, widening = larger * np.outer(shrunk, shrunk), widening * shrunk
    return NoiseStatistics(larger, small.degrees_of_freedom, sandwich, widening)


# Fraction of a record. Noise with a longer correlation time cannot be distinguished from a drift
# between model and data.
_TREND = 0.5


def trends(state: FitState) -> list[str]:
    """Return the channels whose estimated noise is a trend: its correlation time is long.

    A trend does not reduce a standard error, because the missing effect may not stay constant.
    """
    found: dict[str, None] = {}
    for run, values, stated in zip(
        state.setup.runs, state.noise.values, state.noise.stated, strict=True
    ):
        if run.times is None:
            continue
        for name, noise in values.items():
            known = stated[name].correlated is not None
            if not (known or noise.is_white) and noise.time_s >= _TREND * np.ptp(run.times):
                found[name] = None
    return list(found)


def prior_rows(
    state: FitState, alive: np.ndarray
) -> tuple[Float[np.ndarray, "prior parameter"], Float[np.ndarray, " prior"]]:
    """Return the rows of the priors, for the parameters with a response, and their residuals."""
    count, columns = len(state.problem.priors.columns), list(state.problem.priors.columns)
    rows = np.zeros((count, state.problem.size))
    if count:
        rows[:, columns] = state.natural_jacobian.blocks[-1]
    return rows[:, alive], np.asarray(state.inner.residual)[len(state.inner.residual) - count :]


def weighted_cells(state: FitState, at: tuple[int, str], cells: Cells) -> Cells:
    """Return cells with their weights from robust statistics."""
    if state.noise.weights is None:
        return cells
    run, name = at
    weights = state.noise.weights[run][name]
    # As in `residual_cells`, a problem may omit recorded cells of its runs.
    batch = next(each for each in state.problem.batches if run in each.members)
    row, column = batch.members.index(run), batch.channels.index(name)
    counts = np.asarray(batch.weight)[row, : len(weights), column] > 0
    return dataclasses.replace(cells, weights=weights[counts])


def dense_cells(cells: Cells, alive: np.ndarray, slope: np.ndarray) -> Cells:
    """Return cells with derivatives with respect to the parameters with a response."""
    columns = cells.shared[:, alive] / np.maximum(slope[alive], 1e-300)
    return dataclasses.replace(cells, shared=columns)


Sources = Mapping[str, float | None]
"""Factor by which a standard error increases without each recording; None if unknown."""


def sources(
    state: FitState, jacobian: BlockJacobian, alive: np.ndarray
) -> dict[int, dict[str, float | None]]:
    """Return the contribution of each recording to the parameters that several determine together.

    The result is a mapping by position of the parameter and by recording, as in `Sources`. It is
    computed to first order at the optimum with the noise unchanged, without another fit. It is
    empty for a fit of one recording.
    """
    problem = state.problem
    members = [member for batch in problem.batches for member in batch.members]
    names = _names([state.setup.runs[member] for member in members])
    if len(set(names)) < 2:
        return {}
    common, own = alive[alive < problem.shared], alive[alive >= problem.shared]
    triangles = [
        _of_shared(block, columns, common, own)
        for block, columns in zip(jacobian.blocks, jacobian.columns, strict=True)
    ]
    whole = _triangle(triangles)
    norms = np.linalg.norm(whole, axis=0)
    known = _variances(whole, norms)
    found: dict[int, dict[str, float | None]] = {int(index): {} for index in common}
    for name in dict.fromkeys(names):
        # The rows of the priors come last, and are always included.
        rest = [t for i, t in enumerate(triangles) if i >= len(names) or names[i] != name]
        left = _variances(_triangle(rest), norms)
        for column, index in enumerate(common.tolist()):
            if column in known:
                ratio = left[column] / known[column] if column in left else None
                found[index][name] = None if ratio is None else float(np.sqrt(ratio))
    return found


def _names(runs: Sequence[Run]) -> list[str]:
    """Return the name of the recording of each run, or its path if files have the same name."""
    paths: dict[str, set[str]] = {}
    for run in runs:
        paths.setdefault(run.recording, set()).add(str(run.path))
    return [run.recording if len(paths[run.recording]) == 1 else str(run.path) for run in runs]


def _of_shared(
    block: np.ndarray, columns: np.ndarray, common: np.ndarray, own: np.ndarray
) -> np.ndarray:
    """Return the rows of a run on the common parameters after elimination of its own parameters."""
    alone, shared = np.isin(columns, own), np.isin(columns, common)
    triangle = _triangle([block[:, alone], block[:, shared]], axis=1)
    left = triangle[int(alone.sum()) :, int(alone.sum()) :]
    placed = np.zeros((len(left), len(common)))
    placed[:, np.searchsorted(common, columns[shared])] = left
    return placed


def _triangle(parts: Sequence[np.ndarray], axis: int = 0) -> np.ndarray:
    """Return R of the QR factorisation, square even if there are fewer rows."""
    triangle = np.asarray(np.linalg.qr(np.concatenate(parts, axis=axis), mode="r"))
    return np.pad(triangle, ((0, triangle.shape[1] - len(triangle)), (0, 0)))


def _variances(root: np.ndarray, norms: np.ndarray) -> dict[int, float]:
    """Return the variances that R determines, by column. `norms` are those of all rows."""
    moves = np.flatnonzero(np.linalg.norm(root, axis=0) > COLLINEAR * norms)
    loose = {i for group in undetermined_groups(root[:, moves]) for i in group}
    variances = np.diag(inverse_gram(root[:, moves]))
    return {int(column): float(variances[i]) for i, column in enumerate(moves) if i not in loose}
