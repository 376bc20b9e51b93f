"""What it costs a standard error that the noise was estimated, too.

The covariance of generalised least squares is (J^T V^-1 J)^-1 for a V that is known. With an
estimated one it is too small, and normal quantiles are: Kenward and Roger (1997) add the variance
that V's errors give the estimates, and Student's t with Satterthwaite's degrees of freedom takes
the place of the normal distribution.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from ..runtime.arrays import Float
from ._model import ChannelNoise, Stated, whitened
from ._restricted import Cells, Restricted

# Of differences, in the logarithm of a parameter of the noise.
_STEP = 0.03

# White noise of less than this part of the correlated noise is at its bound of zero, and nothing
# varies with it.
_AT_ZERO = 0.15

# Least eigenvalue of the information, its diagonal scaled to one: what the data do not tell apart
# is no reason for infinite variances.
_LEAST = 1e-4


class Spread(NamedTuple):
    """Covariance of estimates, and the degrees of freedom of each.

    Attributes:
        covariance: shape (parameter, parameter).
        degrees_of_freedom: of Student's t, infinite where the noise is known; shape (parameter,).
    """

    covariance: Float[np.ndarray, "parameter parameter"]
    degrees_of_freedom: Float[np.ndarray, " parameter"]


def small_sample(
    problem: Restricted,
    cells: Sequence[Cells],
    covariance: Float[np.ndarray, "parameter parameter"],
    stated: Mapping[str, Stated],
) -> Spread:
    """Covariance and degrees of freedom of estimates whose noise was estimated.

    Arguments:
        problem: the likelihood with the estimated noise.
        cells: the same, with all parameters as `shared` columns and none of their own.
        covariance: of the parameters, as if the noise were known.
        stated: what was known of the noise of each key.

    Returns:
        Both.
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
            return np.sum([each.gram(family.at(x))[0][:-1, :-1] for each in those], axis=0)

        def target(x: np.ndarray, key: str = key, family: _Family = family) -> np.ndarray:
            return np.asarray(problem.value(key, family.at(x)))

        count = len(family.variances)
        weight = _inverse(_second(target, count) / 2)
        first, second = _first(gram, count), _second(gram, count)
        slopes = np.array([-np.diag(covariance @ each @ covariance) for each in first])
        variances += np.einsum("ia,ij,ja->a", slopes, weight, slopes)
        # Second differences by variances, not by their logarithms: the covariance is linear there.
        second[family.variances, family.variances] -= first[family.variances]
        through = np.einsum("iab,bc,jcd->ijad", first, covariance, first)
        added += np.einsum("ij,ijab->ab", weight, second / 2 - through)
    plain = np.diag(covariance)
    with np.errstate(divide="ignore", invalid="ignore"):
        degrees_of_freedom = np.where(variances > 0, 2 * plain**2 / variances, np.inf)
        larger = np.diag(covariance + 2 * covariance @ added @ covariance) / plain
    # A correction of second order may widen an interval, and never to more than double.
    factor = np.sqrt(np.clip(np.nan_to_num(larger, nan=1.0), 1.0, 4.0))
    return Spread(covariance * np.outer(factor, factor), np.maximum(degrees_of_freedom, 1.0))


class _Family:
    """The noises about one, by the logarithms of what was estimated of it.

    Attributes:
        variances: which coordinates are variances, the others being times.

    Arguments:
        noise: the one, at coordinates of zero.
        fixed: whether the variance of a cell is known.
    """

    def __init__(self, noise: ChannelNoise, *, fixed: bool) -> None:
        self._noise, self._fixed = noise, fixed
        fresh = 2 * _STEP * noise.correlated**2
        if noise.is_white:
            names = ["white"]
        elif fixed:
            # With the sum known, there is no room for differences where one part is almost all.
            names = ["correlated", "time"] if noise.white**2 > fresh else ["time"]
        else:
            names = ["white"] if noise.white > _AT_ZERO * noise.correlated else []
            names += ["correlated", "time"]
        self._names = names
        self.variances = np.array([name != "time" for name in names])

    def at(self, x: Float[np.ndarray, " coordinate"]) -> ChannelNoise:
        """The noise at coordinates."""
        factors = dict(zip(self._names, np.exp(x), strict=True))
        noise = self._noise
        part = noise.correlated**2 * factors.get("correlated", 1.0)
        white = noise.white**2 * factors.get("white", 1.0)
        if self._fixed and not noise.is_white:
            white = max(noise.deviation**2 - part, 0.0)
        return ChannelNoise(
            white=float(np.sqrt(white)),
            correlated=float(np.sqrt(part)),
            time_s=float(noise.time_s * factors.get("time", 1.0)),
        )


def _near(noise: ChannelNoise, stated: Stated) -> bool:
    """Whether the noise of a cell is what was stated of it."""
    return stated.deviation is not None and abs(noise.deviation / stated.deviation - 1) < 1e-6


def _inverse(information: Float[np.ndarray, "c c"]) -> Float[np.ndarray, "c c"]:
    """Inverse of an information matrix that differences may have left without a sign."""
    sizes = np.sqrt(np.maximum(np.abs(np.diag(information)), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(sizes, sizes))
    return (vectors / np.maximum(values, _LEAST)) @ vectors.T / np.outer(sizes, sizes)


def _first(function: Callable[[np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """First central differences about zero, shape (coordinate, ...)."""
    steps = _STEP * np.eye(count)
    return np.array([(function(step) - function(-step)) / (2 * _STEP) for step in steps])


def _second(function: Callable[[np.ndarray], np.ndarray], count: int) -> np.ndarray:
    """Second central differences about zero, shape (coordinate, coordinate, ...)."""
    steps = _STEP * np.eye(count)
    centre = function(np.zeros(count))
    result = np.zeros((count, count, *centre.shape))
    for i in range(count):
        result[i, i] = (function(steps[i]) - 2 * centre + function(-steps[i])) / _STEP**2
        for j in range(i):
            ahead = function(steps[i] + steps[j]) + function(-steps[i] - steps[j])
            across = function(steps[i] - steps[j]) + function(steps[j] - steps[i])
            result[i, j] = result[j, i] = (ahead - across) / (4 * _STEP**2)
    return result


def score_covariance(
    cells: Sequence[Cells],
    noise: Mapping[str, ChannelNoise],
    covariance: Float[np.ndarray, "parameter parameter"],
) -> Float[np.ndarray, "parameter parameter"]:
    """Covariance of estimates from the scores that the whitened residuals have.

    The sandwich of Newey and West (1987): scores of neighbouring cells of a channel may go
    together, over about 4 (n / 100)^(2/9) cells. Where it differs much from `covariance`, the
    noise is not what the model of it says.

    Arguments:
        cells: all parameters as `shared` columns.
        noise: of each key.
        covariance: by the noise model, shape (parameter, parameter).

    Returns:
        Of the shape of `covariance`.
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
