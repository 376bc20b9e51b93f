"""The host loop of a fit: step until the optimum, and estimate the noise that no sidecar states."""

import dataclasses
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ._identifiability import responds
from ._records import Iteration
from ._reestimate import reestimate
from ._state import FitState
from ._transitions import release, reweight, step, trial

# How often the noise is estimated anew, unless it settles before.
_NOISE_ROUNDS = 4

# How often parameters may be moved off their bounds before the bound is believed.
_RELEASES = 3


def descend(
    state: FitState, max_iterations: int, progress: Callable[[Iteration], None] | None
) -> FitState:
    """Step until converged.

    Arguments:
        state: where to begin.
        max_iterations: trial steps before the fit gives up.
        progress: called after each trial step.

    Returns:
        The last state; its `ending` says how it ended. After Ctrl-C the best one so far.

    Raises:
        InputError: the model cannot be evaluated at the start.
        KeyboardInterrupt: before anything was evaluated.
    """
    reached = state
    try:
        for after in _states(state, max_iterations):
            shown, reached = len(reached.history), after
            if progress is not None and len(reached.history) > shown:
                progress(reached.history[-1])
    except KeyboardInterrupt:
        if not reached.evaluated:
            raise
        return reached.ended(
            "interrupted",
            f"interrupted after {reached.trials} iterations; this is the best so far",
        )
    return reached


def _states(state: FitState, max_iterations: int) -> Iterator[FitState]:
    """Each evaluated state on the way, the last one with its ending."""
    state = step(state)
    if not state.evaluated:
        raise InputError(
            "the model cannot be evaluated at the start values (the simulation fails): "
            "choose others, for an arm softer or less damped joints, or a shorter run"
        )
    moves = responds(state.natural_jacobian().norms(), state.sizes)
    state = dataclasses.replace(state, active=jnp.asarray(moves)).recorded(accepted=True)
    yield state
    if not np.any(moves):
        yield state.ended("not_converged", "no channel responds to any of the free parameters")
        return
    for rounds_left in reversed(range(_NOISE_ROUNDS)):
        for reached in _to_optimum(state, max_iterations):
            yield reached
            state = reached
        # The last word is always an optimum with the noise that it was fitted with.
        if state.ending is not None or rounds_left == 0:
            break
        noise = reestimate(state)
        settled = noise.values == state.noise.values and noise.weights is state.noise.weights
        state = dataclasses.replace(state, noise=noise)
        if settled:
            break
        state = step(reweight(state, noise))
    if state.ending is None:
        state = state.ended("converged", f"converged in {state.trials} iterations")
    yield state


def _to_optimum(state: FitState, max_iterations: int) -> Iterator[FitState]:
    """Each state until the solver is done; the last one has an ending unless it is an optimum."""
    for releases_left in reversed(range(_RELEASES + 1)):
        state = dataclasses.replace(state, done=False)
        while not state.done:
            if state.trials >= max_iterations:
                yield state.ended(
                    "not_converged",
                    f"no optimum after {state.trials} iterations: start nearer, free fewer "
                    "parameters or allow more iterations",
                )
                return
            state = trial(state)
            yield state
        there = release(state) if releases_left else None
        if there is None:
            break
        tried = dataclasses.replace(step(there), trials=state.trials + 1)
        if tried.cost < state.cost:
            state = tried.recorded(accepted=True)
            yield state
            continue
        # Back to the bound, which is now believed.
        state = dataclasses.replace(
            state, trials=tried.trials, step_seconds=tried.step_seconds
        ).recorded(accepted=False)
        yield state
        break
    if not state.converged:
        yield state.ended(
            "not_converged",
            "no step lowers the cost any further, and the optimum is not reached: "
            "start elsewhere or free fewer parameters",
        )
