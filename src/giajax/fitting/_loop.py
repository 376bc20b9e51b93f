"""Host loop of a fit: steps until the optimum, and every rule that stops it."""

import contextlib
import dataclasses
import itertools
import time
from collections.abc import Callable, Sequence

import equinox as eqx
import numpy as np

from ..runtime.arrays import on_device
from ..runtime.text import InputError, time_in_words
from ._checks import can_improve, with_finer_tolerance, with_suitable_tolerance
from ._far_starts import at_first_rows, sized_by_data, with_all_rows, with_next_rows
from ._linearise import BlockJacobian, minimised
from ._records import Iteration
from ._steps import FitState, Reason, move, reweight, step, trial
from ._uncertainty import FAR_OFF, reestimate, responds, times_white_noise, undetermined_groups


@dataclasses.dataclass(frozen=True)
class Budget:
    """Maximum wall-clock time of a fit with all its initial guesses, from its beginning, s."""

    seconds: float
    began: float = dataclasses.field(default_factory=lambda: time.monotonic())

    def left(self) -> float:
        """Return the remaining time, s, which is negative if the budget is exceeded."""
        return self.seconds - (time.monotonic() - self.began)

    @property
    def ended_it(self) -> str:
        """Text for the message of a fit that the budget ended."""
        return f"the time budget of {time_in_words(self.seconds)} was exhausted"


# Rules that end a fit which is not at an optimum, based on its last steps.

# Number of consecutive rejected steps after which the damping has grown by a factor of 10^16 and no
# step is left.
_REJECTED = 9

# The fit crawls if its last `_STEPS` steps lower the cost by less than this fraction, while the
# linear model of the cost predicts a larger decrease for the next step alone. For many cells, even
# that fraction is large. The limit for `_STEPS` steps is then the noise of `_STEPS` cells.
_STEPS, _CRAWL = 10, 1e-3

# A model is unlikely to describe the data if its cost exceeds the fraction `_UNEXPLAINED` of the
# cost of a constant for each channel of each run, and if the last steps gained less than the
# fraction `_GAIN`. If constants do describe the data, it suffices that the last steps did not halve
# the cost.
_FEW, _SOME, _LAST, _GAIN, _HALVED, _UNEXPLAINED = 6, 10, 5, 0.05, 1.0, 0.8

# A step longer than this fraction of the longest permitted step is on its way from a poor initial
# guess.
_LONG = 0.99

_LITTLE = 0.01  # smallest fraction of the cost that is a relevant predicted decrease
_MISFIT = 4.0  # largest reduced chi-square of a model that may describe the data

# Distances from the optimum in standard errors: the distance that a fit can reach if the cost is
# not smooth, and the distance within which the linear model of the cost is valid.
_NEAR, _LINEAR = 0.1, 1.0

_REFUSED = 3  # smallest number of consecutive rejected steps there that is systematic


def stopped_by(state: FitState) -> tuple[Reason, str] | None:
    """Return the reason why a fit cannot continue after a trial step, or None.

    Returns:
        A word as in `FitResult.reason`, and a sentence.
    """
    steps = state.history[state.round_began :]
    if not state.converged and (state.done or _rejected_in_a_row(steps) >= _REJECTED):
        return _stuck(state)
    if state.done:
        return None
    costs = np.asarray([step.cost for step in steps])
    # If the linear model predicts a small decrease, the fit is about to end by itself.
    hopeful = state.predicted_decrease() < _LITTLE * state.cost or _travels(state, steps[-_LAST:])
    # The cost of a constant assumes that the noise of the cells is independent.
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
                "a constant does: check units, signs, axes and names of the channels, or start "
                "from other values"
            )
    if len(costs) > _STEPS:
        gain = costs[-1 - _STEPS] - costs[-1]
        little = min(_CRAWL * costs[-1], _STEPS * state.residual_scale() ** 2)
        if gain < little and gain < state.predicted_decrease():
            if not bool(state.inner.finite):
                return _stuck(state)
            advice = "give it a prior, hold it fixed, or start from other values"
            return "crawl", (
                f"the last {_STEPS} iterations lowered the cost by a fraction of only "
                f"{gain / costs[-1]:.1g}, mostly along "
                f"{_direction(state)}{_cannot_describe(state) or f': {advice}'}"
            )
    return None


def near_optimum(state: FitState) -> bool:
    """Return whether a cost that is not smooth hides the remaining way to the optimum."""
    return bool(np.sqrt(2 * state.predicted_decrease()) <= _NEAR * state.residual_scale())


def refused_near_optimum(state: FitState) -> bool:
    """Return whether steps within one standard error are rejected, so the derivatives are wrong."""
    near = np.sqrt(2 * state.predicted_decrease()) <= _LINEAR * state.residual_scale()
    # Steps into a region where the model fails are rejected as well.
    refused = _rejected_in_a_row(state.history[state.round_began :])
    return bool(state.inner.finite) and bool(near) and refused >= _REFUSED


def constant_cost(state: FitState) -> float:
    """Return the cost of the best constant for each channel of each run."""
    total = 0.0
    for batch in state.problem.batches:
        weights, observed = np.asarray(batch.weight), np.asarray(batch.observed)
        squares = weights**2
        mean = np.sum(squares * observed, axis=1) / np.maximum(np.sum(squares, axis=1), 1e-300)
        left = (observed - mean[:, None]) * weights
        total += float(np.sum(state.problem.loss.scores(left).rho)) / 2
    return total


def _travels(state: FitState, steps: Sequence[Iteration]) -> bool:
    """Return whether each step is accepted and as long as permitted."""
    long = _LONG * state.solver.largest_step
    return all(step.accepted and step.step >= long for step in steps)


def _rejected_in_a_row(steps: Sequence[Iteration]) -> int:
    """Return the number of consecutive rejected steps at the end."""
    return len(list(itertools.takewhile(lambda step: not step.accepted, reversed(steps))))


def _stuck(state: FitState) -> tuple[Reason, str]:
    """Return why no step is accepted: the model fails beyond, or its cost is not smooth."""
    if not bool(state.inner.finite):
        return "wall", (
            "the model cannot be evaluated beyond the current point, but the optimum has not been "
            "reached: start from other values, or set bounds on the diverging parameters"
        )
    return "rough", (
        "no step lowers the cost further, but the optimum has not been reached: use a tighter "
        "solver tolerance if the model has one, start from other values, or free fewer parameters"
    )


def _cannot_describe(state: FitState) -> str:
    """Return a clause on large residuals that the last steps did not halve, or "".

    If the noise has been estimated, an optimum with such residuals was already reached.
    """
    steps = state.history[state.round_began :]
    gained = len(steps) <= _LAST or steps[-1 - _LAST].cost > 2 * steps[-1].cost
    if gained and not state.noise.estimated:
        return ""
    scale = times_white_noise(state)
    if not scale > FAR_OFF:
        return ""
    return (
        f", and the residuals are {scale:.2g} times the noise, so the model does not describe the "
        "data: run 'giajax check' on the data (units, signs, labels, lost cells, glitches), and "
        "'giajax suspects' on the result"
    )


def _direction(state: FitState) -> str:
    """Return the model parameter whose coordinate the last step changed most."""
    best = int(np.argmax(np.abs(np.asarray(state.inner.step))))
    places = zip(state.problem.paths, state.problem.positions, strict=True)
    return next((path for path, at in places if best in at), "the states of individual runs")


def advance(state: FitState) -> FitState:
    """Return the next state: after a trial step, or after the actions that follow the last step."""
    if not state.evaluated:
        return _at_start(state)
    if not state.done:
        by_its_own = state.setup.settings.optimiser is None
        return _after(trial(state)) if by_its_own else _by_optimiser(state)
    return _next_round(state)


def advance_alone(state: FitState) -> FitState:
    """Advance a fit with the noise and the tolerance unchanged, and dead parameters held."""
    if not state.evaluated:
        state = step(state)
        if not state.evaluated:
            return state.ended(
                "not_converged", "the model cannot be evaluated at this point", "wall"
            )
        # Active parameters may include some without a response.
        moves = responds(state.natural_jacobian.norms(), state.sizes)
        state = with_active(state, moves & np.asarray(state.active))
        state = dataclasses.replace(state, done=False, converged=False)
        return state.recorded(accepted=True)
    if state.done:
        return _converged(state)
    state = trial(state)
    reason, sentence = stopped_by(state) or ("", "")
    if not reason:
        return state
    at_optimum = reason in ("rough", "crawl") and near_optimum(state)
    return state.ended("converged" if at_optimum else "not_converged", sentence, reason)


def descend(
    state: FitState,
    max_iterations: int,
    progress: Callable[[Iteration], None] | None,
    *,
    budget: Budget | None = None,
    keep: Callable[[FitState], None] | None = None,
    advance: Callable[[FitState], FitState] = advance,
) -> FitState:
    """Step until the fit ends. The `ending` of the state describes how it ended.

    Arguments:
        state: state from which to begin or continue.
        max_iterations: maximum number of trial steps.
        progress: function that is called after each trial step.
        budget: time budget. The fit ends before a step for which the remaining time is too short.
        keep: function that is called with each intermediate state. A fit that continues from such a
            state reaches the same end. These states do not include an early end by iterations,
            budget or Ctrl-C.
        advance: function that returns the next state.

    Raises:
        InputError: the model cannot be evaluated at the initial values.
        KeyboardInterrupt: Ctrl-C before the first evaluation. Later the best state so far is
            returned.
    """
    reached = state
    try:
        while reached.ending is None:
            if (limit := _limit(reached, max_iterations, budget)) is not None:
                # At an optimum, only a last step closer to it was left.
                if reached.converged:
                    return _converged(reached)
                sentence, reason = limit
                sentence += _rows(reached)
                return with_all_rows(reached).ended("not_converged", sentence, reason)
            shown, reached = len(reached.history), advance(reached)
            if keep is not None:
                keep(reached)
            if progress is not None and len(reached.history) > shown:
                progress(reached.history[-1])
    except KeyboardInterrupt:
        if not reached.evaluated:
            raise
        # The optimum may have been reached at the moment of the interruption.
        if reached.ending is not None:
            return reached
        sentence = f"interrupted after {reached.trials} iterations; this is the best point so far"
        sentence += _rows(reached)
        # If the fit is interrupted again, it ends with the rows used so far.
        with contextlib.suppress(KeyboardInterrupt):
            reached = with_all_rows(reached)
        return reached.ended("interrupted", sentence, "interrupted")
    return reached


def _rows(state: FitState) -> str:
    """Return a clause on the rows used in a fit that began with the first ones."""
    return f" (for the first {state.part:.0%} of the rows)" if state.part < 1 else ""


def _limit(
    state: FitState, max_iterations: int, budget: Budget | None
) -> tuple[str, Reason] | None:
    """Return why no further step may be tried, or None."""
    if not state.evaluated or state.done:
        return None
    if state.trials >= max_iterations:
        advice = ": start closer to the optimum, free fewer parameters, or allow more iterations"
        return (
            f"no optimum was reached after {state.trials} "
            f"iterations{_cannot_describe(state) or advice}",
            "iterations",
        )
    if budget is not None and budget.left() < float(np.median(state.step_seconds[1:] or [0.0])):
        return (
            f"{budget.ended_it} after {state.trials} iterations; this is the best point so far: "
            "continue from this point, or allow more time",
            "budget",
        )
    return None


def _at_start(state: FitState) -> FitState:
    """Return the state with the start evaluated and parameters without a response held."""
    state = step(state)
    if not state.evaluated:
        raise InputError(
            "the model cannot be evaluated at the initial values (the simulation fails): "
            "choose other values (for an arm, lower stiffness or damping of the joints), or use a "
            "shorter run"
        )
    moves = responds(state.natural_jacobian.norms(), state.sizes)
    state = with_active(state, moves)
    if np.any(moves):
        if state.setup.suited is None:
            state = with_suitable_tolerance(state)
        state = dataclasses.replace(sized_by_data(state), done=False, converged=False)
        return at_first_rows(state.recorded(accepted=True))
    state = state.recorded(accepted=True)
    return state.ended(
        "not_converged",
        "no channel responds to any of the free parameters: check that the model moves ([initial], "
        "commands and their joints) and that the recorded channels vary",
        "no_response",
    )


def with_active(state: FitState, moves: np.ndarray) -> FitState:
    """Return an evaluated point at which only some parameters may move."""
    # The factor equals that of later evaluations, so a fit that continues from here is the same.
    factor = on_device(np.where(np.asarray(moves)[None], np.asarray(state.inner.factor), 0))
    inner = eqx.tree_at(lambda inner: inner.factor, state.inner, factor)
    return dataclasses.replace(state, active=on_device(np.asarray(moves, bool)), inner=inner)


def _after(tried: FitState) -> FitState:
    """Return the state after a trial step, or after the remedy if the fit does not progress."""
    reason, sentence = stopped_by(tried) or ("", "")
    if tried.part < 1:
        return with_next_rows(tried, bool(reason))
    # So near to an optimum, a step may be rejected because of jumps of the cost.
    refused = not (tried.done or bool(tried.inner.accepted))
    lost = refused and refused_near_optimum(tried)
    rough = lost or (refused and near_optimum(tried)) or reason in ("rough", "crawl")
    if rough and (smoother := with_finer_tolerance(tried, surely=lost)) is not None:
        return smoother
    if reason == "rough" and near_optimum(tried):
        return dataclasses.replace(tried, done=True, converged=True)
    return tried.ended("not_converged", sentence, reason) if reason else tried


def _by_optimiser(state: FitState) -> FitState:
    """Return the state at the end of the configured optimiser. One program makes all steps."""
    optimiser, most = state.setup.settings.optimiser, state.setup.settings.max_iterations
    name = type(optimiser).__name__
    coordinate = np.array(state.coordinate)
    places = np.flatnonzero(np.asarray(state.active))
    y = on_device(coordinate[places], coordinate.dtype)
    # A call with zero steps compiles the program for any number of steps.
    began, arguments = time.perf_counter(), (state.problem, state.coordinate, on_device(places))
    minimised(optimiser, y, arguments, on_device(np.array(0)))
    first, *others = state.step_seconds
    compiled = first + time.perf_counter() - began
    state = dataclasses.replace(state, step_seconds=(compiled, *others))
    left = most - state.trials
    y, successful, count = minimised(optimiser, y, arguments, on_device(np.array(left)))
    coordinate[places] = np.asarray(y)
    lower, upper = state.problem.bijector.ends()
    there = step(move(state, np.clip(coordinate, np.asarray(lower), np.asarray(upper))))
    # An optimiser that diverges may end anywhere.
    there = there if there.cost <= state.cost else state
    there = dataclasses.replace(there, trials=state.trials + int(count))
    there = there.recorded(accepted=there.cost < state.cost)
    if successful and near_optimum(there):
        return dataclasses.replace(there, done=True, converged=True)
    if successful and there.cost < (1 - _CRAWL) * state.cost:
        # The optimiser had no derivative beyond a bound. From the bound it may return.
        return dataclasses.replace(there, done=False, converged=False)
    reason: Reason
    if int(count) >= left:
        how, reason = (
            f"found no optimum in {most} iterations: allow more iterations, or",
            "iterations",
        )
    elif successful:
        how, reason = "ended before convergence: give it smaller tolerances, or", "crawl"
    else:
        how, reason = f"stopped after {int(count)} iterations without an optimum:", "rough"
    return there.ended("not_converged", f"{name} {how} start from other values", reason)


def _next_round(state: FitState) -> FitState:
    """Continue from an optimum with re-estimated noise, or end if the noise has converged.

    The last state is always an optimum for the noise with which it was fitted.
    """
    if (woken := _woken(state)) is not None:
        return woken
    if not state.rounds_left:
        return _settled(state)
    noise = reestimate(state)
    settled = noise.values == state.noise.values and noise.weights is state.noise.weights
    state = dataclasses.replace(state, noise=noise)
    if settled:
        return _settled(state)
    return step(reweight(state, noise)).next_round()


def _woken(state: FitState) -> FitState | None:
    """Free the parameters that respond at this optimum, but did not at the start.

    Returns:
        The new state, or None if there is no such parameter.
    """
    active = np.asarray(state.active)
    if np.all(active):
        return None
    slope = np.maximum(state.problem.bijector.slope(np.asarray(state.coordinate)), 1e-300)
    whole = BlockJacobian.of(state.problem, state.inner.jacobian).scaled(1 / slope)
    moves = active | responds(whole.norms(), state.sizes)
    # A parameter that duplicates a free one would make that parameter's standard error undefined.
    columns = np.flatnonzero(moves)
    for group in undetermined_groups(whole.reduced()[:, columns]):
        moves[columns[group]] = active[columns[group]]
    if np.array_equal(moves, active):
        return None
    state = dataclasses.replace(
        state, active=on_device(moves), round_began=len(state.history), converged=False
    )
    return dataclasses.replace(step(move(state, state.coordinate)), done=False, converged=False)


def _settled(state: FitState) -> FitState:
    """End the fit at an optimum, or make one more step that would improve it."""
    finer = with_suitable_tolerance(state)
    if finer.tolerance != state.tolerance:
        # The optimum has followed the tolerance. If no step is left, the noise may have changed,
        # too.
        finer = finer.recorded(accepted=True)
        return dataclasses.replace(finer, done=not can_improve(finer), converged=True)
    if can_improve(finer) and state.setup.settings.optimiser is None:
        # So near to the optimum, the noise has converged and is not estimated again.
        return dataclasses.replace(finer, done=False, converged=True, rounds_left=0)
    return _converged(finer)


def _converged(state: FitState) -> FitState:
    return state.ended("converged", f"converged in {state.trials} iterations", "optimum")
