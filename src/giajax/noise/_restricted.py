"""Restricted likelihood of the noise, given the residuals of a fit and its Jacobian.

Fitted parameters absorb a part of the noise, in particular slow noise, so the plain likelihood
underestimates slow noise. The restricted likelihood (Patterson and Thompson 1971) is the likelihood
of all combinations of cells that no parameter changes. To first order in the parameters, with V the
covariance of the cells, J the Jacobian and e the residuals,

    -2 log L = log|V| + log|J^T V^-1 J| + min_d (e + J d)^T V^-1 (e + J d).

A prior of a parameter is an additional row of the residual with unit variance, which contributes to
both J^T V^-1 J and the minimum. The function is then the likelihood of all cells with the parameter
drawn from its prior. For a parameter that is known accurately, it is the plain likelihood.

Runs share some columns of J and have others of their own, which are eliminated in each run.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np
from scipy.linalg.lapack import dpttrf, dpttrs

from ..runtime.arrays import Bool, Float
from ._model import ChannelNoise, Stated, whitened

# The covariance of consecutive samples of a channel, whose inverse requires one pass over them.
#
# The precision matrix of an Ornstein-Uhlenbeck process at any instants is tridiagonal (Rue and
# Held, "Gaussian Markov Random Fields", 2005, section 1.2.1). Let T be that matrix for unit
# variance. The covariance of white noise with standard deviations w and a correlated part of
# variance c is V = diag(w^2) + c T^-1, and
#
#     V^-1 = (c + w^2 T)^-1 T,    log|V| = log|c + w^2 T| - log|T|.

# Smallest distance between neighbours, as a fraction of the correlation time.
_CLOSEST = 1e-9


def solve(
    noise: ChannelNoise,
    times: Float[np.ndarray, " sample"] | None,
    weights: Float[np.ndarray, " sample"],
    columns: Float[np.ndarray, "sample column"],
) -> tuple[Float[np.ndarray, "sample column"], float]:
    """Return V^-1 X and log|V| for the noise of measured cells at increasing instants, s.

    Noise without times is white. The white variance of a cell is divided by its weight, 0 to 1.
    """
    variance = noise.white**2 / weights
    # A single cell has no neighbour, and LAPACK requires an off-diagonal.
    if times is None or not noise.correlated or len(times) < 2:
        total = variance + noise.correlated**2
        return columns / total[:, None], float(np.sum(np.log(total)))
    diagonal, off, log_t = precision(times, noise.time_s)
    # With the square roots of the weights on both sides the matrix is symmetric, so the LAPACK
    # factorisation of a tridiagonal matrix applies. For a few hundred samples, the overhead of
    # SciPy functions would dominate.
    root = np.sqrt(weights)
    diagonal, off = diagonal / weights, off / (root[:-1] * root[1:])
    # One row for each column of X, so that neighbours in time are neighbours in memory.
    rows = np.ascontiguousarray(columns.T) * root
    along = diagonal * rows
    along[:, 1:] += off * rows[:, :-1]
    along[:, :-1] += off * rows[:, 1:]
    pivots, factors, _ = dpttrf(
        noise.correlated**2 + noise.white**2 * diagonal, noise.white**2 * off, 1, 1
    )
    solved, _ = dpttrs(pivots, factors, along.T, 1)
    return solved * root[:, None], float(np.sum(np.log(pivots))) - log_t


def precision(
    times: Float[np.ndarray, " sample"], time_s: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return the precision matrix T of an Ornstein-Uhlenbeck process with unit variance.

    Returns:
        The diagonal and the first off-diagonal of T, and log|T|.
    """
    apart = np.maximum(np.diff(times) / time_s, _CLOSEST)
    decay = np.exp(-apart)
    fresh = -np.expm1(-2 * apart)
    diagonal = np.ones(len(times))
    diagonal[:-1] += decay**2 / fresh
    diagonal[1:] += decay**2 / fresh
    return diagonal, -decay / fresh, -float(np.sum(np.log(fresh)))


_TOGETHER = 2**17  # most numbers that are processed together, limited by the processor cache


@dataclasses.dataclass(frozen=True)
class Cells:
    """Measured cells of one channel of one run.

    Attributes:
        key: key of their noise. Cells with the same key have the same noise.
        run: number of the run.
        times: times, s, increasing, shape (cell,), or None for a run without times.
        weights: weights of the cells, less than 1 for outliers (`ChannelNoise.white` is divided by
            their square root).
        residual: predicted minus recorded values, SI units, shape (cell,).
        shared: derivatives of the residual with respect to the parameters that runs share, shape
            (cell, shared).
        own: derivatives with respect to the parameters of the run, shape (cell, own).
    """

    key: str
    run: int
    times: Float[np.ndarray, " cell"] | None
    weights: Float[np.ndarray, " cell"]
    residual: Float[np.ndarray, " cell"]
    shared: Float[np.ndarray, "cell shared"]
    own: Float[np.ndarray, "cell own"]

    def where(self, kept: Bool[np.ndarray, " cell"]) -> Self:
        """Return some of the cells."""
        return dataclasses.replace(
            self,
            times=None if self.times is None else self.times[kept],
            weights=self.weights[kept],
            residual=self.residual[kept],
            shared=self.shared[kept],
            own=self.own[kept],
        )

    def gram(self, noise: ChannelNoise) -> tuple[np.ndarray, float]:
        """Return X^T V^-1 X and log|V|. X contains own columns, shared columns and the residual."""
        solved, log_determinant = solve(noise, self.times, self.weights, self._columns)
        return self._columns.T @ solved, log_determinant

    @functools.cached_property
    def _columns(self) -> np.ndarray:
        """Own columns, shared columns and residual, with each column contiguous in memory."""
        return np.asfortranarray(np.column_stack([self.own, self.shared, self.residual]))

    @functools.cached_property
    def instants(self) -> tuple[bytes, bytes]:
        """Times and weights as bytes, which are equal for channels with the same samples."""
        return b"" if self.times is None else self.times.tobytes(), self.weights.tobytes()


def grams(cells: Sequence[Cells], noise: ChannelNoise) -> list[tuple[np.ndarray, float]]:
    """Return `Cells.gram` of each. Cells at the same instants are processed together."""
    results: dict[int, tuple[np.ndarray, float]] = {}
    for at in _batches(cells):
        first = cells[at[0]]
        columns = [cells[i]._columns for i in at]
        solved, log_v = solve(noise, first.times, first.weights, np.hstack(columns))
        ends = np.cumsum([each.shape[1] for each in columns])[:-1]
        for i, of_cells, one in zip(at, columns, np.hsplit(solved, ends), strict=True):
            results[i] = of_cells.T @ one, log_v
    return [results[i] for i in range(len(cells))]


def _batches(cells: Sequence[Cells]) -> list[list[int]]:
    """Return the positions of cells at the same instants, in batches of limited size."""
    batches: list[list[int]] = []
    open_ones: dict[tuple[bytes, bytes], tuple[list[int], int]] = {}
    for i, each in enumerate(cells):
        batch, size = open_ones.get(each.instants, ([], 0))
        # A channel may have no cells.
        if not batch or size + each._columns.size > _TOGETHER:
            batch, size = [], 0
            batches.append(batch)
        batch.append(i)
        open_ones[each.instants] = batch, size + each._columns.size
    return batches


# Singular value, for normalised columns, below which a combination is not determined.
_COLLINEAR = 1e-6


def conditioned(
    cells: Sequence[Cells],
    noise: Mapping[str, ChannelNoise],
    prior: Float[np.ndarray, "column column"],
) -> tuple[tuple[Cells, ...], np.ndarray]:
    """Return cells with columns that are orthonormal for the given noise and prior.

    The columns span the same space. Directions to which neither the cells nor the prior respond are
    omitted, and so are own columns without a response. The prior is returned for the new columns.
    """
    runs = sorted({each.run for each in cells})
    changed = dict(enumerate(cells))
    triangles = []
    for run in runs:
        at = [i for i, each in enumerate(cells) if each.run == run]
        alone = [ChannelNoise(noise[cells[i].key].deviation) for i in at]
        gram = np.sum([cells[i].gram(each)[0] for i, each in zip(at, alone, strict=True)], axis=0)
        width = cells[at[0]].own.shape[1]
        own = orthonormal(gram[:width, :width])
        across = own.T @ gram[:width, width:-1]
        triangles.append(gram[width:-1, width:-1] - across.T @ across)
        for i in at:
            basis = cells[i].own @ own
            changed[i] = dataclasses.replace(
                cells[i], own=basis, shared=cells[i].shared - basis @ across
            )
    shared = orthonormal(np.sum(triangles, axis=0) + prior[:-1, :-1])
    across = shared.T @ prior[:-1, -1:]
    known = np.block([[shared.T @ prior[:-1, :-1] @ shared, across], [across.T, prior[-1:, -1:]]])
    those = (dataclasses.replace(each, shared=each.shared @ shared) for each in changed.values())
    return tuple(those), known


def orthonormal(gram: np.ndarray) -> np.ndarray:
    """Return B with B^T gram B = 1 for the significant directions, shape (column, rank).

    The columns X, with gram = X^T X, may have any size.
    """
    if not len(gram):
        return gram
    norms = np.sqrt(np.maximum(np.diag(gram), 0))
    norms = np.where(norms > 0, norms, np.inf)
    values, vectors = np.linalg.eigh(gram / np.outer(norms, norms))
    kept = values > max(_COLLINEAR**2, 1e-12) * max(values[-1], 1e-300)
    return vectors[:, kept] / np.sqrt(values[kept]) / norms[:, None]


ByScale = Callable[[Float[np.ndarray, "noise scale"]], Float[np.ndarray, "noise scale"]]
"""-2 log L as a function of the logarithms of the factors of several noises of one key."""


class _Others(NamedTuple):
    """Parts of the likelihood that do not depend on the cells of one key.

    Attributes:
        runs: for each run with cells of the key, the Gram matrix without these cells, and the
            number of its own columns.
        shared: Gram matrix of the other runs and the prior, without their own columns.
        known: log|V| of the cells, and log-determinants of the eliminated columns.
    """

    runs: dict[int, tuple[np.ndarray, int]]
    shared: np.ndarray
    known: float


@dataclasses.dataclass(frozen=True)
class Restricted:
    """Minus twice the logarithm of the restricted likelihood, as a function of one key's noise.

    Attributes:
        cells: cells of all channels of all runs. Their columns are independent and of similar size.
        noise: noise of each key.
        grams: Gram matrix of each of `cells` for that noise.
        prior: X^T X of the rows of the priors. The columns of X are the shared columns and, last,
            the residual.
    """

    cells: tuple[Cells, ...]
    noise: Mapping[str, ChannelNoise]
    grams: tuple[tuple[np.ndarray, float], ...]
    prior: Float[np.ndarray, "column column"]

    @classmethod
    def of(
        cls,
        cells: Sequence[Cells],
        noise: Mapping[str, ChannelNoise],
        prior: Float[np.ndarray, "column column"] | None = None,
    ) -> Self:
        """Return the likelihood of the cells of all runs, for an initial noise and a prior."""
        if prior is None:
            prior = np.zeros((cells[0].shared.shape[1] + 1,) * 2)
        those, prior = conditioned(cells, noise, prior)
        return cls(those, noise, tuple(each.gram(noise[each.key]) for each in those), prior)

    def with_noise(self, key: str, noise: ChannelNoise) -> Self:
        """Return the likelihood with different noise of one key."""
        if noise == self.noise[key]:
            return self
        changed = (
            cells.gram(noise) if cells.key == key else before
            for cells, before in zip(self.cells, self.grams, strict=True)
        )
        return dataclasses.replace(self, noise={**self.noise, key: noise}, grams=tuple(changed))

    def of_key(self, key: str) -> tuple[Cells, ...]:
        """Return the cells of a key."""
        return tuple(each for each in self.cells if each.key == key)

    def value(self, key: str, noise: ChannelNoise) -> float:
        """Return -2 log L if the cells of one key have different noise."""
        return float(self.by_scale(key, [noise])(np.zeros((1, 1)))[0, 0])

    def by_scale(self, key: str, noises: Sequence[ChannelNoise]) -> ByScale:
        """Return -2 log L by the logarithms of factors on each of several noises of one key."""
        return self.by_scales([key], noises)[key]

    def by_scales(self, keys: Sequence[str], noises: Sequence[ChannelNoise]) -> dict[str, ByScale]:
        """Return `by_scale` of each of some keys, with the noise of all others unchanged.

        A factor scales a Gram matrix. Therefore one pass over the samples is sufficient for all
        factors, and cells at the same instants are processed together.
        """
        those = [each for each in self.cells if each.key in keys]
        passes = [grams(those, noise) for noise in noises]
        of_keys: dict[str, dict[int, list[tuple[np.ndarray, np.ndarray]]]] = {}
        for at, each in enumerate(those):
            gram, log = map(np.array, zip(*(one[at] for one in passes), strict=True))
            of_keys.setdefault(each.key, {}).setdefault(each.run, []).append((gram, log))
        found = {}
        for key, of_runs in of_keys.items():
            runs = {
                run: np.sum([gram for gram, _ in parts], axis=0) for run, parts in of_runs.items()
            }
            logs = np.sum([log for parts in of_runs.values() for _, log in parts], axis=0)
            found[key] = self._by_scale(key, runs, logs)
        return found

    def _by_scale(
        self,
        key: str,
        of_runs: Mapping[int, Float[np.ndarray, "noise column column"]],
        determinants: Float[np.ndarray, " noise"],
    ) -> ByScale:
        """Return `by_scale` from log|V| and the Gram matrices of the runs with cells of the key."""
        others = self._without(key)
        count = sum(len(each.residual) for each in self.of_key(key))

        def value(logs: Float[np.ndarray, "noise scale"]) -> Float[np.ndarray, "noise scale"]:
            powers = np.exp(-2 * logs)[..., None, None]
            total = others.known + determinants[:, None] + 2 * logs * count
            shared = others.shared
            for run, grams_of_run in of_runs.items():
                before, width = others.runs[run]
                rest, log = _eliminated(before + powers * grams_of_run[:, None], width)
                shared, total = shared + rest, total + log
            rest, log = _eliminated(shared, shared.shape[-1] - 1)
            return total + log + rest[..., 0, 0]

        return value

    def _without(self, key: str) -> _Others:
        """Return the parts that do not depend on the cells of a key."""
        if key not in self._sums:
            mine = {each.run for each in self.of_key(key)}
            runs: dict[int, tuple[np.ndarray, int]] = {}
            known = 0.0
            for each, (gram, log) in zip(self.cells, self.grams, strict=True):
                before, width = runs.get(each.run, (np.zeros_like(gram), each.own.shape[1]))
                if each.key != key:
                    before, known = before + gram, known + log
                runs[each.run] = before, width
            shared = self.prior
            for run in sorted(runs.keys() - mine):
                rest, determinant = _eliminated(*runs[run])
                shared, known = shared + rest, known + float(determinant)
            self._sums[key] = _Others({run: runs[run] for run in mine}, shared, known)
        return self._sums[key]

    @functools.cached_property
    def _sums(self) -> dict[str, _Others]:
        return {}


def _eliminated(
    gram: Float[np.ndarray, "... column column"], width: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return Schur complements of the first columns of Gram matrices, and log-determinants."""
    if not width:
        return gram, np.zeros(gram.shape[:-2])
    factor = np.linalg.cholesky(gram[..., :width, :width])
    across = np.linalg.solve(factor, gram[..., :width, width:])
    rest = gram[..., width:, width:] - np.swapaxes(across, -1, -2) @ across
    diagonal = np.diagonal(factor, axis1=-2, axis2=-1)
    return rest, 2 * np.sum(np.log(diagonal), axis=-1)


# Settings of Newton's method for a logarithm: step of the differences for a likelihood of the order
# of thousands, largest change at convergence, longest step, and maximum number of iterations.
_LOG_STEP = 1e-3
_ENOUGH = 3e-4
_LONGEST = 1.0
_ITERATIONS = 20

_FURTHEST = 8.0  # limit of the logarithm if no residual is left and noise may be arbitrarily small


def best_scales(
    by_scale: ByScale, start: Float[np.ndarray, " noise"]
) -> tuple[Float[np.ndarray, " noise"], Float[np.ndarray, " noise"]]:
    """Return the logarithms of the most likely factors of noises, and -2 log L there."""
    logs = start
    for _ in range(_ITERATIONS):
        behind, here, ahead = by_scale(logs[:, None] + _LOG_STEP * np.array([-1.0, 0.0, 1.0])).T
        slope = (ahead - behind) / (2 * _LOG_STEP)
        curvature = (ahead - 2 * here + behind) / _LOG_STEP**2
        # Far above the best factor the likelihood is straight, and Newton's step is undefined.
        straight = np.where(curvature > 0, curvature, np.abs(slope) / _LONGEST + 1e-300)
        step = np.clip(-slope / straight, -_LONGEST, _LONGEST)
        before, logs = logs, np.clip(logs + step, start - _FURTHEST, start + _FURTHEST)
        if np.all(np.abs(logs - before) < _ENOUGH):
            break
    return logs, by_scale(logs[:, None])[:, 0]


def scaled(problem: Restricted, key: str, noise: ChannelNoise) -> ChannelNoise:
    """Return the noise multiplied by its most likely factor."""
    logs, _ = best_scales(problem.by_scale(key, [noise]), np.zeros(1))
    return noise.times(float(np.exp(logs[0])))


# Effect of estimating the noise on standard errors.
#
# The covariance of generalised least squares is (J^T V^-1 J)^-1 for a known V. For an estimated V,
# this covariance and normal quantiles are too small. Kenward and Roger (1997) add the variance that
# the errors of V cause, and replace the normal distribution by Student's t with Satterthwaite's
# degrees of freedom.

_STEP = 0.03  # step of differences in the logarithm of a noise parameter

# White noise below this fraction of the correlated noise is at its bound of zero, where nothing
# depends on it.
_AT_ZERO = 0.15

# Smallest eigenvalue of the information matrix, scaled to a unit diagonal. Directions that the data
# cannot distinguish must not cause infinite variances.
_LEAST = 1e-4


class Spread(NamedTuple):
    """Covariance of estimates, and the degrees of freedom of Student's t for each of them.

    The degrees of freedom are infinite if the noise is known.
    """

    covariance: Float[np.ndarray, "parameter parameter"]
    degrees_of_freedom: Float[np.ndarray, " parameter"]


def small_sample(
    problem: Restricted,
    cells: Sequence[Cells],
    covariance: Float[np.ndarray, "parameter parameter"],
    stated: Mapping[str, Stated],
) -> Spread:
    """Return the covariance and the degrees of freedom of estimates with estimated noise.

    Arguments:
        problem: likelihood with the estimated noise.
        cells: the same cells, with all parameters as `shared` columns and no own columns.
        covariance: covariance of the parameters, as if the noise were known.
        stated: specified noise of each key.
    """
    size = len(covariance)
    added, variances = np.zeros((size, size)), np.zeros(size)
    for key, noise in problem.noise.items():
        known = stated[key]
        if known.noise == noise:
            continue
        family = _Family(noise, fixed=_near(noise, known))
        those = [each for each in cells if each.key == key]

        def gram(
            x: np.ndarray, those: Sequence[Cells] = those, family: _Family = family
        ) -> np.ndarray:
            noise = family.at(x)
            return np.sum([each.gram(noise)[0][:-1, :-1] for each in those], axis=0)

        def target(x: np.ndarray, key: str = key, family: _Family = family) -> np.ndarray:
            return np.asarray(problem.value(key, family.at(x)))

        count = len(family.variances)
        weight = _inverse(_differences(target, count)[1] / 2)
        first, second = _differences(gram, count)
        slopes = np.array([-np.diag(covariance @ each @ covariance) for each in first])
        variances += np.einsum("ia,ij,ja->a", slopes, weight, slopes)
        # Second differences with respect to variances, not their logarithms, because the covariance
        # is linear in the variances.
        second[family.variances, family.variances] -= first[family.variances]
        through = np.einsum("iab,bc,jcd->ijad", first, covariance, first)
        added += np.einsum("ij,ijab->ab", weight, second / 2 - through)
    plain = np.diag(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        degrees_of_freedom = np.where(variances > 0, 2 * plain**2 / variances, np.inf)
        larger = np.diag(covariance + 2 * covariance @ added @ covariance) / plain
    # This correction of second order may widen an interval, but at most double it.
    factor = np.sqrt(np.clip(np.nan_to_num(larger, nan=1.0), 1.0, 4.0))
    return Spread(covariance * np.outer(factor, factor), np.maximum(degrees_of_freedom, 1.0))


class _Family:
    """Noise near an estimate, by the logarithms of its estimated quantities.

    The estimate has zero coordinates. With `fixed`, the variance of a cell is known. `variances`
    specifies which coordinates are variances. The others are correlation times.
    """

    def __init__(self, noise: ChannelNoise, *, fixed: bool) -> None:
        self._noise, self._fixed = noise, fixed
        fresh = 2 * _STEP * noise.correlated**2
        if not noise.correlated:
            names = ["white"]
        elif fixed:
            # With a known sum, differences are not possible if one part is almost the whole.
            names = ["correlated", "time"] if noise.white**2 > fresh else ["time"]
        else:
            names = ["white"] if noise.white > _AT_ZERO * noise.correlated else []
            names += ["correlated", "time"]
        self._names = names
        self.variances = np.array([name != "time" for name in names])

    def at(self, x: Float[np.ndarray, " coordinate"]) -> ChannelNoise:
        """Return the noise at given coordinates."""
        factors = dict(zip(self._names, np.exp(x), strict=True))
        noise = self._noise
        part = noise.correlated**2 * factors.get("correlated", 1.0)
        white = noise.white**2 * factors.get("white", 1.0)
        if self._fixed and noise.correlated:
            white = max(noise.deviation**2 - part, 0.0)
        return ChannelNoise(
            white=float(np.sqrt(white)),
            correlated=float(np.sqrt(part)),
            time_s=float(noise.time_s * factors.get("time", 1.0)),
        )


def _near(noise: ChannelNoise, stated: Stated) -> bool:
    """Return whether the noise of a cell is the specified noise."""
    return stated.deviation is not None and abs(noise.deviation / stated.deviation - 1) < 1e-6


def _inverse(information: Float[np.ndarray, "c c"]) -> Float[np.ndarray, "c c"]:
    """Return the inverse of an information matrix from differences, which may be indefinite."""
    sizes = np.sqrt(np.maximum(np.abs(np.diag(information)), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
    return (vectors / np.maximum(values, _LEAST)) @ vectors.T / np.outer(sizes, sizes)


def _differences(
    function: Callable[[np.ndarray], np.ndarray], count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return central differences about zero.

    Returns:
        First differences, shape (coordinate, ...), and second differences with an additional axis.
    """
    steps = _STEP * np.eye(count)
    centre = function(np.zeros(count))
    sides = [(function(step), function(-step)) for step in steps]
    result = np.zeros((count, count, *centre.shape))
    for i, (up, down) in enumerate(sides):
        result[i, i] = (up - 2 * centre + down) / _STEP**2
        for j in range(i):
            ahead = function(steps[i] + steps[j]) + function(-steps[i] - steps[j])
            across = function(steps[i] - steps[j]) + function(steps[j] - steps[i])
            result[i, j] = result[j, i] = (ahead - across) / (4 * _STEP**2)
    return np.array([(up - down) / (2 * _STEP) for up, down in sides]), result


def score_covariance(
    cells: Sequence[Cells],
    noise: Mapping[str, ChannelNoise],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """Return the covariance of estimates from the scores of the whitened residuals.

    This is the sandwich estimator of Newey and West (1987). Scores of neighbouring cells of a
    channel may be correlated over about 4 (n / 100)^(2/9) cells. If the result differs strongly
    from `covariance`, the noise model is wrong.

    Arguments:
        cells: cells with all parameters as `shared` columns.
        noise: noise of each key.
        covariance: covariance according to the noise model.
    """
    meat = np.zeros_like(covariance)
    count = 0
    for each in cells:
        columns = np.concatenate([each.shared, each.residual[:, None]], axis=1)
        white = whitened(noise[each.key], each.times, columns, each.weights)
        scores = white[:, :-1] * white[:, -1:]
        count += len(scores)
        lags = min(int(4 * (len(scores) / 100) ** (2 / 9)), len(scores) - 1)
        meat += scores.T @ scores
        for lag in range(1, (lags if each.times is not None else 0) + 1):
            across = scores[lag:].T @ scores[:-lag]
            meat += (1 - lag / (lags + 1)) * (across + across.T)
    size = len(covariance)
    return covariance @ meat @ covariance * count / max(count - size, 1)
