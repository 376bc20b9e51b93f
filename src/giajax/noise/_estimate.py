"""White and correlated noise of each channel, by restricted likelihood."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ._model import ChannelNoise, Stated
from ._restricted import Restricted

# Twice the gain in log-likelihood that a memory must bring, for two more parameters: white noise
# is taken for correlated in about one channel of twenty, and its intervals are wider then.
_WORTH = 5.0

# That stated noise must be missed by to be left: a chance of 1 in 100, for one parameter.
_REJECTED = 6.63

# The noise of a channel depends little on that of the others: through the parameters alone.
_SWEEPS = 2

# Squared residuals over stated noise, for each cell, below which more noise is not asked for.
_MORE = 1.05

# No statement on a memory is made from fewer cells.
_FEW = 20

# How a deviation is made of white noise and what is correlated, as an angle, rad: its cosine and
# its sine, of which either may be next to nothing. Where one is, the likelihood depends on the
# square of it: a search ends there, where it would go on for ever along a logarithm.
_MIXED = (0.08, np.pi / 2 - 1e-3)

# Of the minimiser. The likelihood is a logarithm of thousands: its differences are of steps that
# its rounding does not reach, and an iteration that gains less than this is the last.
_STEP = 1e-5
_ENOUGH = 2e-5
_ITERATIONS = 30


def estimate(problem: Restricted, stated: Mapping[str, Stated], *, memory: bool) -> Restricted:
    """The likelihood with the noise of every key that makes it largest.

    Arguments:
        problem: with the noise to begin with.
        stated: what is known of each key.
        memory: whether there may be any.

    Returns:
        The problem with the new noise.
    """
    for _ in range(_SWEEPS):
        for key in problem.noise:
            problem = problem.with_noise(key, _of_key(problem, key, stated[key], memory=memory))
        if len(problem.noise) == 1 or all(each.is_white for each in problem.noise.values()):
            break
    return problem


def _of_key(problem: Restricted, key: str, stated: Stated, *, memory: bool) -> ChannelNoise:
    cells = [each for each in problem.cells if each.key == key]
    count = sum(len(each.residual) for each in cells)
    present = problem.noise[key]
    known = stated.noise_of(memory=memory)
    if known is not None and (stated.correlated is not None or not memory):
        return known
    white = known or _best_scale(problem, key, ChannelNoise(present.deviation))
    timed = [each.times for each in cells if each.times is not None and len(each.times) > 2]
    if not memory or count < _FEW or not timed:
        return white
    step = float(np.median(np.concatenate([np.diff(times) for times in timed])))
    longest = max(float(np.ptp(times)) for times in timed)
    bounds = (np.log(step / 3), np.log(longest))
    if known is None:
        return _with_memory(problem, key, white, present, bounds, fixed=False)
    best = _with_memory(problem, key, known, present, bounds, fixed=True)
    if sum(float(np.sum(each.residual**2)) for each in cells) > _MORE * count * known.deviation**2:
        scaled = _best_scale(problem, key, known)
        free = _with_memory(problem, key, scaled, best, bounds, fixed=False)
        if problem.value(key, best) - problem.value(key, free) > _REJECTED:
            # White noise beyond what is stated scales the errors of all channels alike.
            return known if free.is_white else free
    return best


def _with_memory(
    problem: Restricted,
    key: str,
    white: ChannelNoise,
    start: ChannelNoise,
    bounds: tuple[float, float],
    *,
    fixed: bool,
) -> ChannelNoise:
    """The best noise with a memory, where it is worth it; else the white one."""

    def noise_at(angle: float, time: float) -> ChannelNoise:
        return ChannelNoise(
            white=white.deviation * float(np.cos(angle)),
            correlated=white.deviation * float(np.sin(angle)),
            time_s=float(np.exp(time)),
        )

    def along(angle: float, time: float) -> Callable[[float], float]:
        return problem.by_scale(key, noise_at(angle, time))

    least = problem.value(key, white)
    low, high = bounds
    tries = [(angle, time) for angle in (0.45, 1.2) for time in np.linspace(low + 1, high - 2, 4)]
    if not start.is_white:
        angle = float(np.clip(np.arctan2(start.correlated, start.white), 0.1, 1.5))
        tries.append((angle, float(np.log(start.time_s))))
    values = [(problem.value(key, noise_at(*at)), at) for at in tries]
    nearest, at = min(values)
    if least - nearest < -_WORTH:
        return white
    limits = [_MIXED, bounds, (0.0, 0.0) if fixed else (-3.0, 3.0)]
    (angle, time, scale), value = _minimum(along, (*at, 0.0), limits, nearest)
    return white if least - value < _WORTH else noise_at(angle, time).times(float(np.exp(scale)))


def _best_scale(problem: Restricted, key: str, noise: ChannelNoise) -> ChannelNoise:
    """The noise times the factor that makes the likelihood largest."""
    by_scale = problem.by_scale(key, noise)
    (scale,), _ = _minimum(lambda: by_scale, (0.0,), [(-8.0, 8.0)], by_scale(0.0))
    return noise.times(float(np.exp(scale)))


def _minimum(
    along: Callable[..., Callable[[float], float]],
    start: Sequence[float],
    bounds: Sequence[tuple[float, float]],
    first: float,
) -> tuple[list[float], float]:
    """Where a likelihood is largest, and -2 log L there.

    Arguments:
        along: of all variables but the last, the logarithm of a factor: -2 log L by that one,
            which costs no more passes over the samples.
        start: of the variables.
        bounds: of each.
        first: -2 log L at the start.
    """
    # Slow to import, and most fits estimate no noise.
    from scipy.optimize import minimize

    def with_slopes(x: np.ndarray) -> tuple[float, np.ndarray]:
        *shape, scale = x.tolist()
        here = along(*shape)
        value = here(scale)
        slopes = [(here(scale + _STEP) - value) / _STEP]
        for i in reversed(range(len(shape))):
            step = _STEP if shape[i] + _STEP < bounds[i][1] else -_STEP
            moved = [*shape[:i], shape[i] + step, *shape[i + 1 :]]
            slopes.insert(0, (along(*moved)(scale) - value) / step)
        return value, np.array(slopes)

    # SciPy's is relative to the likelihood, which is as large as there are cells.
    options = {"ftol": _ENOUGH / max(abs(first), 1.0), "maxiter": _ITERATIONS}
    done = minimize(with_slopes, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options)
    return done.x.tolist(), float(done.fun)
