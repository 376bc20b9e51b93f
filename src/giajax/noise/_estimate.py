"""White and correlated noise of each channel, by restricted likelihood."""

from collections.abc import Mapping

from ._memory import Shape, promising, time_limits, with_memory
from ._model import ChannelNoise, Stated
from ._restricted import Restricted
from ._scale import scaled

# That stated noise must be missed by to be left: a chance of 1 in 100, for one parameter.
_REJECTED = 6.63

# The noise of a channel depends little on that of the others: through the parameters alone.
_SWEEPS = 2

# Squared residuals over stated noise, for each cell, below which more noise is not asked for.
_MORE = 1.05


def estimate(problem: Restricted, stated: Mapping[str, Stated], *, memory: bool) -> Restricted:
    """The likelihood with the noise of every key that makes it largest.

    Arguments:
        problem: with the noise to begin with.
        stated: what is known of each key.
        memory: whether there may be any.

    Returns:
        The problem with the new noise.
    """
    starts: dict[str, Shape] = {}
    if memory:
        # Most noise is white: all channels are asked at once whether they are worth a search.
        for key, present in problem.noise.items():
            if present.is_white:
                problem = problem.with_noise(key, _white(problem, key, stated[key]))
        starts = promising(problem, stated)
    for _ in range(_SWEEPS):
        for key, known in stated.items():
            noise = _of_key(problem, key, known, starts.get(key), memory=memory)
            problem = problem.with_noise(key, noise)
        starts = {key: at for key, at in starts.items() if not problem.noise[key].is_white}
        if len(problem.noise) == 1 or all(each.is_white for each in problem.noise.values()):
            break
    return problem


def _white(problem: Restricted, key: str, stated: Stated) -> ChannelNoise:
    """As it is stated; else the best without a memory."""
    known = stated.noise_of(memory=False)
    return known or scaled(problem, key, ChannelNoise(problem.noise[key].deviation))


def _of_key(
    problem: Restricted, key: str, stated: Stated, start: Shape | None, *, memory: bool
) -> ChannelNoise:
    """The best noise of a key with the others as they are.

    Arguments:
        problem: with its present noise.
        key: of the channels.
        stated: what is known of it.
        start: where a search for a memory is promising; None where it is not.
        memory: whether there may be any.
    """
    if memory and stated.correlated is not None and (known := stated.noise) is not None:
        return known
    white, present = _white(problem, key, stated), problem.noise[key]
    if not memory or (start is None and present.is_white):
        return white
    limits = time_limits(problem, key)
    if limits is None:
        return white
    starts = [start] if start is not None else []
    if not present.is_white:
        starts.append(Shape.of(present))
    if stated.deviation is None:
        return with_memory(problem, key, white, starts, limits, fixed=False)
    best = with_memory(problem, key, white, starts, limits, fixed=True)
    cells = problem.of_key(key)
    count = sum(len(each.residual) for each in cells)
    squares = sum(float(each.residual @ each.residual) for each in cells)
    if squares <= _MORE * count * stated.deviation**2:
        return best
    if not best.is_white:
        starts.append(Shape.of(best))
    free = with_memory(problem, key, scaled(problem, key, white), starts, limits, fixed=False)
    if problem.value(key, best) - problem.value(key, free) <= _REJECTED:
        return best
    # White noise beyond what is stated scales the errors of all channels alike.
    return white if free.is_white else free
