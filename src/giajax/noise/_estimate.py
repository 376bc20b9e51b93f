"""White and correlated noise of each channel, by restricted likelihood."""

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ..runtime.arrays import Float
from ._model import MAD, ChannelNoise, Stated
from ._restricted import Cells, Restricted, best_scales, scaled, solve

_ROUNDS = 20

# Smallest white part, relative to the standard deviation of a cell, that distinguishes an outlier
# from a jump of the correlated part.
_LEAST_WHITE = 0.1

_LEAST_WEIGHT = 1e-12  # minimum weight of a cell, which divides its variance


def robust_deviation(residuals: Float[np.ndarray, " cell"]) -> float:
    """Return a robust standard deviation of normal noise with some outliers, which is never 0."""
    size = np.abs(np.asarray(residuals, dtype=float))
    # It is never zero, because data without noise would have infinite weight.
    return max(MAD * float(np.median(size)), 1e-12 * float(np.max(size, initial=0.0)), 1e-300)


def outlier_weights(
    cells: Cells,
    noise: ChannelNoise,
    weigh: Callable[[np.ndarray], np.ndarray] = lambda size: 1 / np.maximum(size, 1.0),
) -> Float[np.ndarray, " cell"]:
    """Return the weights of the white parts of the cells for a loss, by default the Huber loss.

    The weights minimise the sum of the loss of the white part and of the square of the correlated
    part. An outlier is not correlated noise: its neighbours do not predict it, and it does not
    predict them (iteratively reweighted least squares; Huber 1981, section 7.8). The white variance
    of a cell is divided by its weight, which is positive.

    Arguments:
        cells: cells of one channel.
        noise: noise of the channel.
        weigh: function that returns the weights for normalised sizes of the white parts.
    """
    white = max(noise.white, _LEAST_WHITE * noise.deviation)
    noise = dataclasses.replace(noise, white=white)
    weights = np.ones(len(cells.residual))
    for _ in range(_ROUNDS):
        solved = solve(noise, cells.times, weights, cells.residual[:, None])[0][:, 0]
        # V^-1 e, multiplied by the white variance, is the white part of e.
        own = np.abs(white**2 / weights * solved) / white
        after = np.maximum(weigh(own), _LEAST_WEIGHT)
        done = np.max(np.abs(after - weights), initial=0.0) < 1e-3
        weights = after
        if done:
            break
    return weights


# Smallest value of twice the gain in log-likelihood for which noise counts as correlated, with two
# additional parameters. White noise is then classified as correlated in about one of twenty fits,
# whose intervals are wider.
_LEAST_GAIN = 5.0


def _worth_it(channels: int) -> float:
    """Return this gain for a number of tested channels, which limits chance detections."""
    return float(_LEAST_GAIN + 2 * np.log(channels))


# Twice the gain at the best of a few trial points, below which a search from there would fail.
_PROMISING = 1.0

_FEWEST_SAMPLES = 20  # minimum number of cells for a test of correlation

# Composition of the noise as an angle, rad. Its cosine is the white part and its sine the
# correlated part, and either may be very small. The likelihood then depends on the square of the
# small part, so a search ends there. With a logarithm it would continue for ever.
_MIXED = (0.08, np.pi / 2 - 1e-3)

# Initial guesses of a search: angles, and the number of times between the shortest and longest.
_ANGLES = (0.25, 0.6, 1.2)
_TIMES = 4

# Settings of the minimiser. The likelihood is a logarithm of the order of thousands. The step of
# its differences exceeds its rounding errors, and an iteration with a smaller gain is the last.
_STEP = 1e-5
_ENOUGH = 1e-4
_ITERATIONS = 30


class Shape(NamedTuple):
    """Correlated noise apart from its size.

    Attributes:
        angle: angle, rad, whose tangent is the ratio of the correlated part to the white part.
        log_time: logarithm of the correlation time in s.
    """

    angle: float
    log_time: float

    @classmethod
    def of(cls, noise: ChannelNoise) -> Self:
        """Return the shape of given noise, limited to the range of a search."""
        angle = float(np.clip(np.arctan2(noise.correlated, noise.white), 0.1, 1.5))
        return cls(angle, float(np.log(noise.time_s)))

    def noise(self, deviation: float) -> ChannelNoise:
        """Return the noise with this shape and the given standard deviation of a cell."""
        return ChannelNoise(
            white=deviation * float(np.cos(self.angle)),
            correlated=deviation * float(np.sin(self.angle)),
            time_s=float(np.exp(self.log_time)),
        )


def time_limits(problem: Restricted, key: str) -> tuple[float, float] | None:
    """Return the logarithms of the shortest and longest correlation time, or None."""
    cells = problem.of_key(key)
    timed = [each.times for each in cells if each.times is not None and len(each.times) > 2]
    if not timed or sum(len(each.residual) for each in cells) < _FEWEST_SAMPLES:
        return None
    step = float(np.median(np.concatenate([np.diff(times) for times in timed])))
    return float(np.log(step / 3)), float(np.log(max(np.ptp(times) for times in timed)))


def promising(problem: Restricted, stated: Mapping[str, Stated]) -> dict[str, Shape]:
    """Return the best of a few shapes for each key, if it is better than white noise.

    The noise of the problem is white with approximately the right size, or correlated.
    """
    alike: dict[Hashable, list[str]] = {}
    for key in problem.noise:
        if stated[key].correlated is None or stated[key].noise is None:
            instants = tuple(each.instants for each in problem.of_key(key))
            alike.setdefault(instants, []).append(key)
    starts = {}
    for keys in alike.values():
        limits = time_limits(problem, keys[0])
        if limits is None:
            continue
        low, high = limits
        times = np.linspace(low + 1, high - 2, _TIMES).tolist()
        shapes = [Shape(angle, time) for angle in _ANGLES for time in times]
        noises = [ChannelNoise(1.0), *(shape.noise(1.0) for shape in shapes)]
        for key, by_scale in problem.by_scales(keys, noises).items():
            size = np.full(len(noises), np.log(problem.noise[key].deviation))
            values = best_scales(by_scale, size)[1]
            if stated[key].deviation is not None:
                fixed = by_scale(size[:, None])[:, 0]
                values = fixed if _gain(fixed) > _PROMISING else values
            if _gain(values) > _PROMISING:
                starts[key] = shapes[int(np.argmin(values[1:]))]
    return starts


def _gain(values: np.ndarray) -> float:
    """Return the advantage of the best of the other values over the first, in -2 log L."""
    return float(values[0] - np.min(values[1:]))


def best_correlated(
    problem: Restricted,
    key: str,
    white: ChannelNoise,
    starts: Sequence[Shape],
    limits: tuple[float, float],
    *,
    fixed: bool,
) -> ChannelNoise:
    """Return the best correlated noise of a key if its gain is large enough, else white noise.

    The search begins at the best of the initial guesses. With `fixed`, the standard deviation of a
    cell is that of `white`.
    """
    size = white.deviation
    noises = [white, *(shape.noise(size) for shape in starts)]
    least, *values = problem.by_scale(key, noises)(np.zeros((len(noises), 1)))[:, 0].tolist()
    at = starts[int(np.argmin(values))]
    bounds = [_MIXED, limits, (0.0, 0.0) if fixed else (-3.0, 3.0)]

    def with_slopes(x: np.ndarray) -> tuple[float, np.ndarray]:
        moved = [x.copy() for _ in range(3)]
        steps = [_STEP if x[i] + _STEP < bounds[i][1] else -_STEP for i in range(2)]
        for i, step in enumerate(steps):
            moved[1 + i][i] += step
        by_scale = problem.by_scale(key, [Shape(*each[:2].tolist()).noise(size) for each in moved])
        (value, larger), *others = by_scale(
            np.array([x[2], x[2] + _STEP]) * np.ones((3, 1))
        ).tolist()
        slopes = [(other[0] - value) / step for other, step in zip(others, steps, strict=True)]
        return value, np.array([*slopes, (larger - value) / _STEP])

    # The import is slow, and most fits do not estimate noise.
    from scipy.optimize import minimize

    # The tolerance of SciPy is relative to the likelihood, which grows with the number of cells.
    options = {"ftol": _ENOUGH / max(abs(least), 1.0), "maxiter": _ITERATIONS}
    done = minimize(
        with_slopes, [*at, 0.0], jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    if least - float(done.fun) < _worth_it(len(problem.noise)):
        return white
    angle, time, scale = done.x.tolist()
    return Shape(angle, time).noise(size * float(np.exp(scale)))


# Smallest deviation from the specified noise that rejects it: a probability of 1 in 100 for one
# parameter.
_REJECTED = 6.63

# The noise of a channel depends little on that of the others, because only the parameters connect
# them.
_SWEEPS = 2

# Mean of the squared residuals, divided by the specified variance, below which no larger noise is
# estimated.
_MORE = 1.05


def estimate(problem: Restricted, stated: Mapping[str, Stated], *, correlated: bool) -> Restricted:
    """Return the likelihood with the most likely noise of every key, given the specified noise."""
    starts: dict[str, Shape] = {}
    if correlated:
        # Most noise is white, so all channels are tested together before any search.
        for key, present in problem.noise.items():
            if present.is_white:
                problem = problem.with_noise(key, _white(problem, key, stated[key]))
        starts = promising(problem, stated)
    for _ in range(_SWEEPS):
        for key, known in stated.items():
            noise = _of_key(problem, key, known, starts.get(key), correlated=correlated)
            problem = problem.with_noise(key, noise)
        starts = {key: at for key, at in starts.items() if not problem.noise[key].is_white}
        if len(problem.noise) == 1 or all(each.is_white for each in problem.noise.values()):
            break
    return problem


def _white(problem: Restricted, key: str, stated: Stated) -> ChannelNoise:
    """Return the specified white noise, otherwise the most likely white noise."""
    known = stated.noise_of(correlated=False)
    return known or scaled(problem, key, ChannelNoise(problem.noise[key].deviation))


def _of_key(
    problem: Restricted, key: str, stated: Stated, start: Shape | None, *, correlated: bool
) -> ChannelNoise:
    """Return the most likely noise of a key, with the noise of the others unchanged.

    `start` is a promising shape of correlated noise, or None.
    """
    if correlated and stated.correlated is not None and (known := stated.noise) is not None:
        return known
    white, present = _white(problem, key, stated), problem.noise[key]
    if not correlated or (start is None and present.is_white):
        return white
    limits = time_limits(problem, key)
    if limits is None:
        return white
    starts = [start] if start is not None else []
    starts += [] if present.is_white else [Shape.of(present)]
    if stated.deviation is None:
        return best_correlated(problem, key, white, starts, limits, fixed=False)
    best = best_correlated(problem, key, white, starts, limits, fixed=True)
    cells = problem.of_key(key)
    count = sum(len(each.residual) for each in cells)
    squares = sum(float(each.residual @ each.residual) for each in cells)
    if squares <= _MORE * count * stated.deviation**2:
        return best
    starts += [] if best.is_white else [Shape.of(best)]
    free = best_correlated(problem, key, scaled(problem, key, white), starts, limits, fixed=False)
    if problem.value(key, best) - problem.value(key, free) <= _REJECTED:
        return best
    # White noise above the specified noise scales the errors of all channels equally.
    return white if free.is_white else free
