"""Why a fit ends where it is not at an optimum: what stops it, told from its last steps."""

from collections.abc import Sequence

import numpy as np

from ._loss import transform
from ._reason import Reason
from ._records import Iteration
from ._state import FitState

# Rejected steps in a row, after which the damping has grown by 10^16 and no step is left.
_REJECTED = 9

# So many steps that lower the cost by less than this part of it are a crawl, where the linear
# model of the cost promises more than that of the next step alone. Of many cells even that part is
# much: a crawl gains less than the noise of one cell a step.
_STEPS, _CRAWL = 10, 1e-3

# A model whose cost is more than this part of that of a constant for each channel of each run, and
# that gained less than a part of it in the last steps, is not about to describe the data. Where
# constants do describe them, it is enough that the last steps did not halve the cost.
_FEW, _SOME, _LAST, _GAIN, _HALVED, _UNEXPLAINED = 6, 10, 5, 0.05, 1.0, 0.8

# A step that is longer than this part of the longest one is on its way from a far start.
_LONG = 0.99

# Part of the cost that is not worth to be promised.
_LITTLE = 0.01

# Above this reduced chi-square something is missing.
_MISFIT = 4.0

# In standard errors: as near to an optimum as a cost that is not smooth lets a fit come, and so
# near that the linear model of the cost holds as far as the optimum.
_NEAR, _LINEAR = 0.1, 1.0

# Refused steps in a row that are no accident there.
_MISLED = 3


def stopped_by(state: FitState) -> tuple[Reason, str] | None:
    """What keeps a fit from going on, as a word and a sentence; None where nothing does.

    The words are those of `FitResult.reason`.

    Arguments:
        state: after a trial step.
    """
    steps = state.history[state.round_began :]
    if not state.converged and (state.done or _rejected_in_a_row(steps) >= _REJECTED):
        return _stuck(state)
    if state.done:
        return None
    costs = np.asarray([step.cost for step in steps])
    # Where the linear model promises little, the fit is about to end by itself.
    hopeful = state.promised() < _LITTLE * state.cost or _travels(state, steps[-_LAST:])
    # The cost of a constant is that of cells which are independent of each other.
    hopeful = hopeful or not state.noise.is_white
    if len(costs) > _FEW and not hopeful and 2 * state.cost > _MISFIT * len(state.inner.residual):
        constant = constant_cost(state)
        still = 2 * constant < _MISFIT * len(state.inner.residual)
        gained = costs[-1 - _LAST] / costs[-1] - 1
        still = still and gained < _HALVED
        slow = len(costs) > _SOME and gained < _GAIN
        if (still and state.cost > constant) or (slow and state.cost > _UNEXPLAINED * constant):
            return "cannot_fit", (
                f"after {state.trials} iterations the model describes the data hardly better than "
                "a constant would: check units, signs, axes and names of the channels, or start "
                "elsewhere"
            )
    if len(costs) > _STEPS:
        gain = costs[-1 - _STEPS] - costs[-1]
        little = min(_CRAWL * costs[-1], _STEPS * state.shown_noise() ** 2)
        if gain < little and gain < state.promised():
            if not bool(state.inner.sound):
                return _stuck(state)
            return "crawl", (
                f"the last {_STEPS} iterations lowered the cost by {gain / costs[-1]:.1g} of it, "
                f"mostly along {_direction(state)}: give that a prior, hold it or start elsewhere"
            )
    return None


def nearly(state: FitState) -> bool:
    """Whether the optimum is so near that a cost which is not smooth hides the rest of the way."""
    return bool(np.sqrt(2 * state.promised()) <= _NEAR * state.shown_noise())


def misled(state: FitState) -> bool:
    """Whether steps within a standard error are refused, so that derivatives are no slopes."""
    near = np.sqrt(2 * state.promised()) <= _LINEAR * state.shown_noise()
    # Beyond a wall they are refused, too.
    refused = _rejected_in_a_row(state.history[state.round_began :])
    return bool(state.inner.sound) and bool(near) and refused >= _MISLED


def constant_cost(state: FitState) -> float:
    """The cost of the best constant for each channel of each run."""
    total = 0.0
    for group in state.problem.groups:
        weights, observed = np.asarray(group.weight), np.asarray(group.observed)
        squares = weights**2
        mean = np.sum(squares * observed, axis=1) / np.maximum(np.sum(squares, axis=1), 1e-300)
        left = (observed - mean[:, None]) * weights
        total += float(np.sum(np.asarray(transform(state.problem.loss, left)) ** 2)) / 2
    return total


def _travels(state: FitState, steps: Sequence[Iteration]) -> bool:
    """Whether each step leads downhill, and is as long as one may be."""
    long = _LONG * state.solver.largest_step
    return all(step.accepted and step.step >= long for step in steps)


def _rejected_in_a_row(steps: Sequence[Iteration]) -> int:
    """How many of the last trial steps were rejected, one after the other."""
    count = 0
    for step in reversed(steps):
        if step.accepted:
            break
        count += 1
    return count


def _stuck(state: FitState) -> tuple[Reason, str]:
    """No step is accepted any more: the model fails beyond, or its cost is not smooth."""
    if not bool(state.inner.sound):
        return "wall", (
            "the model cannot be evaluated beyond where the fit is, and the optimum is not "
            "reached: start elsewhere, or bound what runs away"
        )
    return "rough", (
        "no step lowers the cost any further, and the optimum is not reached: give a tighter "
        "tolerance if the model has one, start elsewhere or free fewer parameters"
    )


def _direction(state: FitState) -> str:
    """The parameter of the model whose coordinate the last step moved most."""
    best = int(np.argmax(np.abs(np.asarray(state.inner.step))))
    for path, places in zip(state.problem.paths, state.problem.positions, strict=True):
        if best in places:
            return path
    return "the states of single runs"
