"""The pure transitions from one state of a fit to the next.

None of them changes the state that it is given: the loop, after Ctrl-C, still has the one before.
All evaluate the model by the same compiled program.
"""

import dataclasses
import time
from typing import Any

import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._program import program
from .._typing import Array
from ._group import build_groups
from ._linearise import linearise
from ._noise import Noise
from ._problem import Problem, residual
from ._solver import Marquardt, MarquardtState
from ._state import FitState, blank


def step(state: FitState) -> FitState:
    """One trial step; at a point that was not evaluated yet, its evaluation."""
    began = time.perf_counter()
    coordinate, inner, done, converged = _step(
        state.solver, state.coordinate, state.problem, state.inner, state.active
    )
    # Waits for the result, so that the time below is that of the step.
    finished, optimum = bool(done), bool(converged)
    return dataclasses.replace(
        state,
        coordinate=coordinate,
        inner=inner,
        done=finished,
        converged=optimum,
        step_seconds=(*state.step_seconds, time.perf_counter() - began),
    )


def trial(state: FitState) -> FitState:
    """One trial step that counts, and is told."""
    tried = dataclasses.replace(step(state), trials=state.trials + 1)
    return tried.recorded(accepted=bool(tried.inner.accepted))


def move(state: FitState, coordinate: Any) -> FitState:
    """Go on from another point, which is not evaluated yet."""
    coordinate = jnp.asarray(coordinate, dtype=state.coordinate.dtype)
    inner = blank(state.solver, state.problem, coordinate)
    return dataclasses.replace(state, coordinate=coordinate, inner=inner)


def reweight(state: FitState, noise: Noise) -> FitState:
    """Go on from the same point with another noise; not evaluated yet."""
    groups = build_groups(
        state.problem.model, state.setup.runs, noise.values, len(state.problem.paths)
    )
    problem = dataclasses.replace(state.problem, groups=groups)
    return move(dataclasses.replace(state, problem=problem, noise=noise), state.coordinate)


def release(state: FitState) -> FitState | None:
    """Move parameters off a bound at which only their coordinate has become flat.

    Near a bound the slope of the bijector vanishes, and with it the gradient, whether the
    optimum is there or not. The Gauss-Newton step of the parameter itself tells: where it
    leads inwards, further than the bound is away, and promises a lower cost, the parameter
    moves there.

    Returns:
        The new point, not evaluated yet; None where no parameter moves.
    """
    bijector = state.problem.bijector
    coordinate = np.array(state.coordinate)
    values = np.array(bijector.forward(state.coordinate))
    residuals = np.asarray(state.inner.residual)
    slopes = bijector.slope(coordinate)
    noise = 2 * state.cost / max(len(residuals) - len(values), 1)
    released = False
    jacobian = state.jacobian()
    responses, along = jacobian.norms() ** 2, jacobian.transposed_times(residuals)
    for index in np.flatnonzero(np.asarray(state.active)):
        response, downhill = float(responses[index]), -float(along[index])
        if response == 0 or slopes[index] == 0:
            continue
        change = downhill / response * slopes[index]
        gain = downhill**2 / response / 2
        lower, upper = bijector.lower[index], bijector.upper[index]
        to_bound = min(values[index] - lower, upper - values[index])
        target = values[index] + change
        if lower < target < upper and abs(change) > to_bound and gain > noise:
            values[index] = target
            released = True
    return move(state, bijector.inverse(values)) if released else None


def evaluate(state: FitState, coordinate: Any, problem: Problem | None = None) -> MarquardtState:
    """Residual and Jacobian at a point, by the same compiled program as a step."""
    coordinate = jnp.asarray(coordinate, dtype=state.coordinate.dtype)
    problem = state.problem if problem is None else problem
    fresh = blank(state.solver, problem, coordinate)
    _, inner, _, _ = _step(state.solver, coordinate, problem, fresh, state.active)
    return inner


# At module level: a fresh closure would be compiled again for every fit.
@program
def _step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> tuple[Array, MarquardtState, Array, Array]:
    options = {"active": active, "linearise": linearise}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    done, result = solver.terminate(residual, coordinate, problem, options, state, frozenset())
    return coordinate, state, done, done & (result == optx.RESULTS.successful)
