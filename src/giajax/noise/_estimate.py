"""White and correlated noise of each channel, by restricted likelihood."""

import dataclasses
from collections.abc import Callable, Hashable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ..runtime.arrays import Float
from ._model import MAD, ChannelNoise, Stated
from ._restricted import Cells, Restricted, best_scales, scaled, solve

_ROUNDS = 20

# The white part that tells an outlier from a jump of the correlated part, at least.
_LEAST_WHITE = 0.1

_LEAST_WEIGHT = 1e-12  # of a cell that has none: its variance is divided by it


def robust_deviation(residuals: Float[np.ndarray, " cell"]) -> float:
    """Standard deviation of normal noise with some outliers; never 0."""
    size = np.abs(np.asarray(residuals, dtype=float))
    # Never zero: data without noise would weigh infinitely.
    return max(MAD * float(np.median(size)), 1e-12 * float(np.max(size, initial=0.0)), 1e-300)


def outlier_weights(
    cells: Cells,
    noise: ChannelNoise,
    weigh: Callable[[np.ndarray], np.ndarray] = lambda size: 1 / np.maximum(size, 1.0),
) -> Float[np.ndarray, " cell"]:
    """A loss's weights of the white part of each cell, as `weigh` gives them of its size; Huber's.

    They minimise the sum of the loss of the white part and of the square of the correlated
    one: an outlier is not correlated noise, so its neighbours do not predict it, nor it them
    (iteratively reweighted least squares; Huber 1981, section 7.8). The white variance of a cell is
    divided by its weight, which is above 0.
    """
    white = max(noise.white, _LEAST_WHITE * noise.deviation)
    noise = dataclasses.replace(noise, white=white)
    weights = np.ones(len(cells.residual))
    for _ in range(_ROUNDS):
        solved = solve(noise, cells.times, weights, cells.residual[:, None])[0][:, 0]
        # V^-1 e times the white variance is the white part of e.
        own = np.abs(white**2 / weights * solved) / white
        after = np.maximum(weigh(own), _LEAST_WEIGHT)
        done = np.max(np.abs(after - weights), initial=0.0) < 1e-3
        weights = after
        if done:
            break
    return weights


# Twice the gain in log-likelihood that correlation must bring, for two more parameters: white noise
# is taken for correlated in about one fit of twenty, and its intervals are wider then.
_LEAST_GAIN = 5.0


def _worth_it(channels: int) -> float:
    """That gain where so many channels are asked: a chance hit among many is not hysteresis."""
    return float(_LEAST_GAIN + 2 * np.log(channels))


# Twice the gain at the best of a few tries, below which no search from there ends above that.
_PROMISING = 1.0

_FEWEST_SAMPLES = 20  # no statement on correlation is made from fewer cells

# How a deviation is made of white noise and what is correlated, as an angle, rad: its cosine and
# its sine, of which either may be next to nothing. Where one is, the likelihood depends on the
# square of it: a search ends there, where it would go on for ever along a logarithm.
_MIXED = (0.08, np.pi / 2 - 1e-3)

# Where a search may begin: angles, and how many times between the shortest and the longest.
_ANGLES = (0.25, 0.6, 1.2)
_TIMES = 4

# Of the minimiser. The likelihood is a logarithm of thousands: its differences are of steps that
# its rounding does not reach, and an iteration that gains less than this is the last.
_STEP = 1e-5
_ENOUGH = 1e-4
_ITERATIONS = 30


class Shape(NamedTuple):
    """Correlated noise but for its size: the correlated part over the white one, and the time.

    The first is the tangent of an angle (rad), the second as a logarithm (of s).
    """

    angle: float
    log_time: float

    @classmethod
    def of(cls, noise: ChannelNoise) -> Self:
        """That of some noise, inside the range of a search."""
        angle = float(np.clip(np.arctan2(noise.correlated, noise.white), 0.1, 1.5))
        return cls(angle, float(np.log(noise.time_s)))

    def noise(self, deviation: float) -> ChannelNoise:
        """The noise of which a cell has a deviation."""
        return ChannelNoise(
            white=deviation * float(np.cos(self.angle)),
            correlated=deviation * float(np.sin(self.angle)),
            time_s=float(np.exp(self.log_time)),
        )


def time_limits(problem: Restricted, key: str) -> tuple[float, float] | None:
    """Logarithms of the shortest and longest time of correlated noise; None without any."""
    cells = problem.of_key(key)
    timed = [each.times for each in cells if each.times is not None and len(each.times) > 2]
    if not timed or sum(len(each.residual) for each in cells) < _FEWEST_SAMPLES:
        return None
    step = float(np.median(np.concatenate([np.diff(times) for times in timed])))
    return float(np.log(step / 3)), float(np.log(max(np.ptp(times) for times in timed)))


def promising(problem: Restricted, stated: Mapping[str, Stated]) -> dict[str, Shape]:
    """The best of a few shapes of each key for which one is better than white noise.

    The problem has white noise of about the right size, or correlated noise.
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
    """By how much the best of the others is better than the first, in -2 log L."""
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
    """The best correlated noise of a key, where it is worth it; else the best white one.

    The search begins at the best of the starts; `fixed`: a cell's deviation is that of `white`.
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

    # Slow to import, and most fits estimate no noise.
    from scipy.optimize import minimize

    # SciPy's is relative to the likelihood, which is as large as there are cells.
    options = {"ftol": _ENOUGH / max(abs(least), 1.0), "maxiter": _ITERATIONS}
    done = minimize(
        with_slopes, [*at, 0.0], jac=True, method="L-BFGS-B", bounds=bounds, options=options
    )
    if least - float(done.fun) < _worth_it(len(problem.noise)):
        return white
    angle, time, scale = done.x.tolist()
    return Shape(angle, time).noise(size * float(np.exp(scale)))


# That stated noise must be missed by to be left: a chance of 1 in 100, for one parameter.
_REJECTED = 6.63

# The noise of a channel depends little on that of the others: through the parameters alone.
_SWEEPS = 2

# Squared residuals over stated noise, for each cell, below which more noise is not asked for.
_MORE = 1.05


def estimate(problem: Restricted, stated: Mapping[str, Stated], *, correlated: bool) -> Restricted:
    """The likelihood with the noise of every key that makes it largest, by what is known."""
    starts: dict[str, Shape] = {}
    if correlated:
        # Most noise is white: all channels are asked at once whether they are worth a search.
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
    """As it is stated; else the best white one."""
    known = stated.noise_of(correlated=False)
    return known or scaled(problem, key, ChannelNoise(problem.noise[key].deviation))


def _of_key(
    problem: Restricted, key: str, stated: Stated, start: Shape | None, *, correlated: bool
) -> ChannelNoise:
    """The best noise of a key with the others as they are; `start`: a promising correlated one."""
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
    # White noise beyond what is stated scales the errors of all channels alike.
    return white if free.is_white else free
