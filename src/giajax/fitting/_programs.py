"""The compiled programs of a fit, each with what it returns, for those that are kept.

At module level: a fresh closure would be compiled again for every fit.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import optimistix as optx

from .._program import program
from .._typing import Array
from ._group import Group
from ._linearise import assembled, linearise, linearise_run
from ._problem import Problem
from ._residual import joined, of_group, residual, whitened_run
from ._solver import Marquardt
from ._solver_state import MarquardtState

Stepped = tuple[Array, MarquardtState, Any, Any]
"""Where the solver is, its state there, whether it is done, and whether at an optimum."""


def _stepped(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> Stepped:
    truth = jax.ShapeDtypeStruct((), bool)
    return coordinate, state, truth, truth


@functools.partial(program, like=_stepped)
def step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> Stepped:
    options = _options(problem, active) | {"linearise": linearise}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    return _ended(solver, coordinate, problem, state, options)


@functools.partial(program, like=lambda solver, coordinate, *rest: coordinate)
def propose(
    solver: Marquardt, coordinate: Array, bijector: Any, state: MarquardtState, active: Array
) -> Array:
    lower, upper = bijector.ends()
    options = {"active": active, "lower": lower, "upper": upper}
    return solver.propose(coordinate, options, state)


def _judged(
    solver: Marquardt,
    coordinate: Array,
    trial: Array,
    parts: Any,
    problem: Problem,
    state: MarquardtState,
    active: Array,
) -> Stepped:
    return _stepped(solver, coordinate, problem, state, active)


@functools.partial(program, like=_judged)
def judge(
    solver: Marquardt,
    coordinate: Array,
    trial: Array,
    parts: Any,
    problem: Problem,
    state: MarquardtState,
    active: Array,
) -> Stepped:
    options = _options(problem, active)
    there = assembled(parts, trial, problem)
    coordinate, state = solver.judge(coordinate, options, state, trial, there)
    return _ended(solver, coordinate, problem, state, options)


def _linearised_like(runs: tuple[Array, Group], problem: Problem) -> tuple[Any, ...]:
    values, group = runs
    count, columns = values.shape
    rows = group.observed.size // count
    row, table, successful = _predicted_like(runs, problem)
    block = jax.ShapeDtypeStruct((count, rows, columns), values.dtype)
    triangle = jax.ShapeDtypeStruct((count, columns + 1, columns + 1), values.dtype)
    return row, block, triangle, table, successful


@functools.partial(program, like=_linearised_like)
def linearised(runs: tuple[Array, Group], problem: Problem) -> tuple[Array, ...]:
    values, group = runs
    return of_group(linearise_run, values, group, problem)


def _predicted_like(runs: tuple[Array, Group], problem: Problem) -> tuple[Any, ...]:
    values, group = runs
    count = values.shape[0]
    row = jax.ShapeDtypeStruct((count, group.observed.size // count), values.dtype)
    table = jax.ShapeDtypeStruct(group.observed.shape, values.dtype)
    return row, table, jax.ShapeDtypeStruct((count,), bool)


@functools.partial(program, like=_predicted_like)
def predicted(runs: tuple[Array, Group], problem: Problem) -> tuple[Array, ...]:
    values, group = runs
    return of_group(whitened_run, values, group, problem)


def result_row(coordinate: Array, problem: Problem) -> Any:
    count = sum(group.observed.size for group in problem.groups) + len(problem.priors)
    return jax.ShapeDtypeStruct((count,), coordinate.dtype)


@functools.partial(program, like=result_row)
def residual_row(coordinate: Array, problem: Problem) -> Array:
    row, prediction = residual(coordinate, problem)
    return jnp.where(prediction.successful, row, jnp.nan)


@functools.partial(program, like=lambda parts, coordinate, problem: result_row(coordinate, problem))
def joined_row(parts: Any, coordinate: Array, problem: Problem) -> Array:
    row, prediction = joined(parts, coordinate, problem)
    return jnp.where(prediction.successful, row, jnp.nan)


def _options(problem: Problem, active: Array) -> dict[str, Any]:
    """What the solver has to know beside the problem."""
    lower, upper = problem.bijector.ends()
    return {"active": active, "lower": lower, "upper": upper}


def _ended(
    solver: Marquardt,
    coordinate: Array,
    problem: Problem,
    state: MarquardtState,
    options: dict[str, Any],
) -> Stepped:
    done, result = solver.terminate(residual, coordinate, problem, options, state, frozenset())
    return coordinate, state, done, done & (result == optx.RESULTS.successful)
