"""Noise with a memory that makes the likelihood of a channel largest, where that is worth it."""

from collections.abc import Hashable, Mapping, Sequence
from typing import NamedTuple, Self

import numpy as np

from ._model import ChannelNoise, Stated
from ._restricted import Restricted
from ._scale import best_scales

# Twice the gain in log-likelihood that a memory must bring, for two more parameters: white noise
# is taken for correlated in about one channel of twenty, and its intervals are wider then.
_WORTH = 5.0

# Twice the gain at the best of a few tries, below which no search from there ends above that.
_PROMISING = 1.0

# No statement on a memory is made from fewer cells.
_FEW = 20

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
    """Noise with a memory but for its size.

    Attributes:
        angle: its tangent is the correlated part over the white one, rad.
        log_time: logarithm of the correlation time in s.
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
    """Logarithms of the shortest and longest time that a memory may have; None without any."""
    cells = problem.of_key(key)
    timed = [each.times for each in cells if each.times is not None and len(each.times) > 2]
    if not timed or sum(len(each.residual) for each in cells) < _FEW:
        return None
    step = float(np.median(np.concatenate([np.diff(times) for times in timed])))
    return float(np.log(step / 3)), float(np.log(max(np.ptp(times) for times in timed)))


def promising(problem: Restricted, stated: Mapping[str, Stated]) -> dict[str, Shape]:
    """The best of a few shapes of each key for which one is better than white noise.

    Arguments:
        problem: with white noise of about the right size, or noise with a memory.
        stated: what is known of each key.
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


def with_memory(
    problem: Restricted,
    key: str,
    white: ChannelNoise,
    starts: Sequence[Shape],
    limits: tuple[float, float],
    *,
    fixed: bool,
) -> ChannelNoise:
    """The best noise with a memory, where it is worth it; else the white one.

    Arguments:
        problem: with the other keys' noise.
        key: of the channels.
        white: the best without a memory.
        starts: of the search, which begins at the best of them.
        limits: as `time_limits`.
        fixed: whether the deviation of a cell is that of `white`.
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
    if least - float(done.fun) < _WORTH:
        return white
    angle, time, scale = done.x.tolist()
    return Shape(angle, time).noise(size * float(np.exp(scale)))
