"""The host loop of a fit: step until the optimum, and estimate the noise that no sidecar states."""

import dataclasses
from collections.abc import Callable

import equinox as eqx
import numpy as np

from .._errors import InputError
from .._maths import on_device
from ._budget import Budget
from ._ends import misled, nearly, stopped_by
from ._identifiability import responds
from ._reason import Reason
from ._records import Iteration
from ._reestimate import reestimate
from ._state import FitState
from ._tolerance import is_promising, resolved, smoothed
from ._transitions import reweight, step, tolerance_of, trial


def descend(
    state: FitState,
    max_iterations: int,
    progress: Callable[[Iteration], None] | None,
    *,
    budget: Budget | None = None,
    keep: Callable[[FitState], None] | None = None,
) -> FitState:
    """Step until converged.

    Arguments:
        state: where to begin, or to go on.
        max_iterations: trial steps before the fit gives up.
        progress: called after each trial step.
        budget: ends the fit before a step that it has no time for.
        keep: called with each state on the way. Whoever goes on from one of them reaches the
            same end. What only ends the fit early (iterations, budget, Ctrl-C) is no part of them.

    Returns:
        The last state; its `ending` says how it ended. After Ctrl-C the best one so far.

    Raises:
        InputError: the model cannot be evaluated at the start.
        KeyboardInterrupt: before anything was evaluated.
    """
    reached = state
    try:
        while reached.ending is None:
            if (limit := _limit(reached, max_iterations, budget)) is not None:
                # At an optimum only a last step nearer to it was left to try.
                return (
                    _converged(reached)
                    if reached.converged
                    else reached.ended("not_converged", *limit)
                )
            shown, reached = len(reached.history), advance(reached)
            if keep is not None:
                keep(reached)
            if progress is not None and len(reached.history) > shown:
                progress(reached.history[-1])
    except KeyboardInterrupt:
        if not reached.evaluated:
            raise
        # An optimum that was reached in this very moment is one.
        if reached.ending is not None:
            return reached
        return reached.ended(
            "interrupted",
            f"interrupted after {reached.trials} iterations; this is the best so far",
            "interrupted",
        )
    return reached


def _limit(
    state: FitState, max_iterations: int, budget: Budget | None
) -> tuple[str, Reason] | None:
    """Why no further step may be tried; None where one may."""
    if not state.evaluated or state.done:
        return None
    if state.trials >= max_iterations:
        return (
            f"no optimum after {state.trials} iterations: start nearer, free fewer "
            "parameters or allow more iterations",
            "iterations",
        )
    if budget is not None and budget.left() < float(np.median(state.step_seconds[1:] or [0.0])):
        return (
            f"{budget.ended_it} after {state.trials} iterations; this is the best so far: go on "
            "from there, or allow more time",
            "budget",
        )
    return None


def advance(state: FitState) -> FitState:
    """The state after this one: a trial step, or what there is to do once none is left.

    Raises:
        InputError: the model cannot be evaluated at the start.
    """
    if not state.evaluated:
        return _at_start(state)
    if not state.done:
        return _after(trial(state))
    return _next_round(state)


def _at_start(state: FitState) -> FitState:
    """With the start evaluated, and what does not respond there held."""
    state = step(state)
    if not state.evaluated:
        raise InputError(
            "the model cannot be evaluated at the start values (the simulation fails): "
            "choose others, for an arm softer or less damped joints, or a shorter run"
        )
    moves = responds(state.natural_jacobian().norms(), state.sizes)
    state = moving(state, moves)
    if np.any(moves):
        if state.setup.suited is None:
            state = resolved(state)
        return dataclasses.replace(state, done=False, converged=False).recorded(accepted=True)
    state = state.recorded(accepted=True)
    return state.ended(
        "not_converged", "no channel responds to any of the free parameters", "no_response"
    )


def moving(state: FitState, moves: np.ndarray) -> FitState:
    """An evaluated point at which only some parameters may move.

    Arguments:
        state: evaluated, with all of these moving.
        moves: which may, shape (parameter,).
    """
    # As every later evaluation gives the factor, so that a fit that goes on from here is the same.
    factor = on_device(np.where(np.asarray(moves)[None], np.asarray(state.inner.factor), 0))
    inner = eqx.tree_at(lambda inner: inner.factor, state.inner, factor)
    return dataclasses.replace(state, active=on_device(np.asarray(moves, bool)), inner=inner)


def _after(tried: FitState) -> FitState:
    """After a trial step: the same, or what may still be done where the fit does not get on."""
    reason, sentence = stopped_by(tried) or ("", "")
    # A step that is refused so near to an optimum may be so for what the cost jumps by.
    refused = not (tried.done or bool(tried.inner.accepted))
    lost = refused and misled(tried)
    rough = lost or (refused and nearly(tried)) or reason in ("rough", "crawl")
    if rough and (smoother := smoothed(tried, surely=lost)) is not None:
        return smoother
    if reason == "rough" and nearly(tried):
        return dataclasses.replace(tried, done=True, converged=True)
    return tried.ended("not_converged", sentence, reason) if reason else tried


def _next_round(state: FitState) -> FitState:
    """From an optimum to the next one with another noise; where the noise is settled, the end.

    The last word is always an optimum with the noise that it was fitted with.
    """
    if not state.rounds_left:
        return _settled(state)
    noise = reestimate(state)
    settled = noise.values == state.noise.values and noise.weights is state.noise.weights
    state = dataclasses.replace(state, noise=noise)
    if settled:
        return _settled(state)
    return step(reweight(state, noise)).next_round()


def _settled(state: FitState) -> FitState:
    """The end at an optimum; one step more where a step would move it."""
    finer = resolved(state)
    if tolerance_of(finer) != tolerance_of(state):
        # The optimum has followed it; where no step is left, the noise may have done so, too.
        finer = finer.recorded(accepted=True)
        return dataclasses.replace(finer, done=not is_promising(finer), converged=True)
    if is_promising(finer):
        # So near to the optimum the noise is settled: it is not estimated once more.
        return dataclasses.replace(finer, done=False, converged=True, rounds_left=0)
    return _converged(finer)


def _converged(state: FitState) -> FitState:
    return state.ended("converged", f"converged in {state.trials} iterations", "optimum")
