"""White and correlated noise of each channel, by restricted likelihood."""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import minimize

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

# Of the minimiser. The likelihood is a logarithm of thousands: its differences are of steps that
# its rounding does not reach, and what changes it by less than a thousandth changes no error.
_OPTIONS = {"eps": 1e-5, "ftol": 1e-7, "maxiter": 30}


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

    def noise_at(x: np.ndarray) -> ChannelNoise:
        size = white.deviation if fixed else white.deviation * float(np.exp(x[2]))
        return _noise(size, 1 / (1 + float(np.exp(-x[0]))), float(np.exp(x[1])))

    def target(x: np.ndarray) -> float:
        return problem.value(key, noise_at(x))

    least = problem.value(key, white)
    low, high = bounds
    tries = [(share, time) for share in (-1.5, 2.0) for time in np.linspace(low + 1, high - 2, 4)]
    if not start.is_white:
        share = (start.correlated / start.deviation) ** 2
        share = float(np.clip(share, 1e-3, 1 - 1e-3))
        tries.append((float(np.log(share / (1 - share))), float(np.log(start.time_s))))
    values = [(target(np.array([*at, 0.0])), at) for at in tries]
    nearest, at = min(values)
    if least - nearest < -_WORTH:
        return white
    first = np.array([*at, 0.0])
    limits = [(-5.0, 14.0), bounds, (0.0, 0.0) if fixed else (-3.0, 3.0)]
    done = minimize(target, first, method="L-BFGS-B", bounds=limits, options=_OPTIONS)
    if least - float(done.fun) < _WORTH:
        return white
    return noise_at(done.x)


def _best_scale(problem: Restricted, key: str, noise: ChannelNoise) -> ChannelNoise:
    """The noise times the factor that makes the likelihood largest."""

    def target(x: np.ndarray) -> float:
        return problem.value(key, noise.times(float(np.exp(x[0]))))

    done = minimize(target, np.zeros(1), method="L-BFGS-B", bounds=[(-8.0, 8.0)], options=_OPTIONS)
    return noise.times(float(np.exp(done.x[0])))


def _noise(deviation: float, share: float, time_s: float) -> ChannelNoise:
    return ChannelNoise(
        white=deviation * float(np.sqrt(1 - share)),
        correlated=deviation * float(np.sqrt(share)),
        time_s=time_s,
    )
