"""A fit that begins where another one ended: steps alone, with noise and tolerance as they are."""

import dataclasses
import functools

import numpy as np

from ._descend import moving
from ._ends import nearly, stopped_by
from ._identifiability import responds
from ._reason import Reason
from ._state import FitState
from ._statistics import Statistics, statistics
from ._transitions import step, trial


@dataclasses.dataclass(frozen=True)
class Refit:
    """How a fit ended that began from another one.

    Attributes:
        state: the last one.
        converged: whether it is at an optimum of what was free.
        reason: as of `FitResult`; "iterations" where they were used up, "wall" where the model
            cannot be evaluated at the start.
    """

    state: FitState
    converged: bool
    reason: Reason

    @property
    def values(self) -> np.ndarray:
        """Of all free parameters, in the order of `Optimum.labels`, SI; what was held as held."""
        return self.state.values()

    @property
    def cost(self) -> float:
        """Half the sum of the loss, in units of the noise."""
        return self.state.cost

    @property
    def iterations(self) -> int:
        """Trial steps."""
        return self.state.trials

    @functools.cached_property
    def statistics(self) -> Statistics:
        """Standard errors and correlations at the end."""
        return statistics(self.state)


def descended(state: FitState, most: int) -> Refit:
    """Steps until none is left, with the noise and the tolerance as they are.

    Arguments:
        state: where to begin, not evaluated yet.
        most: trial steps.
    """
    state = step(state)
    if not state.evaluated:
        return Refit(state, False, "wall")
    # What was not left out may leave some without a response.
    moves = responds(state.natural_jacobian().norms(), state.sizes)
    state = dataclasses.replace(moving(state, moves & np.asarray(state.active)), done=False)
    state = dataclasses.replace(state, converged=False).recorded(accepted=True)
    while not state.done:
        if state.trials >= most:
            return Refit(state, False, "iterations")
        state = trial(state)
        reason, _ = stopped_by(state) or ("", "")
        if reason:
            return Refit(state, reason in ("rough", "crawl") and nearly(state), reason)
    return Refit(state, True, "optimum")
