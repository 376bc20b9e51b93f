"""Steps and residuals of a least-squares problem by compiled programs, on all cores.

A problem of one run is one program. Of several, the runs are dealt out over the cores, and what
they have in common, the step itself, is a program of its own before and after them; so it is on one
core, too, where the shares are longer and the numbers the same.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from .._program import program
from .._shares import Batch, dealt, on_all_cores
from .._typing import Array, Float
from ._group import Group
from ._linearise import assembled, linearise, linearise_run
from ._prepared import in_a_share
from ._problem import Prediction, Problem, joined, of_group, residual, whitened_run
from ._solver import Marquardt
from ._solver_state import MarquardtState

Stepped = tuple[Array, MarquardtState, Any, Any]
"""Where the solver is, its state there, whether it is done, and whether at an optimum."""


def stepped(
    solver: Marquardt,
    coordinate: Array,
    problem: Problem,
    state: MarquardtState,
    active: Array,
    *,
    sample: bool = False,
) -> Stepped:
    """One step of the solver, by the same programs wherever it is.

    Arguments:
        solver: of the least-squares problem.
        coordinate: the best point so far, shape (parameter,).
        problem: what is minimised.
        state: of the solver there.
        active: parameters that may move, shape (parameter,).
        sample: of many runs evaluate a few, and have zeros for the others.
    """
    if not _several(problem):
        return _step(solver, coordinate, problem, state, active)
    trial = _propose(solver, coordinate, problem.bijector, state, active)
    parts = tuple(_of_runs(_linearised, trial, problem, sample))
    return _judge(solver, coordinate, trial, parts, problem, state, active)


def residuals(
    coordinate: Array, problem: Problem, *, sample: bool = False
) -> Float[np.ndarray, " residual"]:
    """Residuals at a point within the bounds, without derivatives; NaN where the model fails.

    Arguments:
        coordinate: the point, shape (parameter,).
        problem: what is minimised.
        sample: of many runs evaluate a few, and have zeros for the others.
    """
    if not _several(problem):
        return np.asarray(_residuals(coordinate, problem))
    parts = tuple(_of_runs(_predicted, coordinate, problem, sample))
    return np.asarray(_joined(parts, coordinate, problem))


def blank(solver: Marquardt, problem: Problem, coordinate: Array) -> MarquardtState:
    """The solver's state before its first evaluation."""
    groups, dtype = problem.groups, coordinate.dtype
    prediction = Prediction(
        tuple(jax.ShapeDtypeStruct(group.observed.shape, dtype) for group in groups),
        jax.ShapeDtypeStruct((), bool),
    )
    shape = _row(coordinate, problem)
    # By numpy, as in the solver: each operation of JAX here would be a program of its own.
    blocks = tuple(
        np.zeros((len(g.members), g.observed.size // len(g.members), g.columns().shape[1]), dtype)
        for g in groups
    )
    options = {"jacobian": (*blocks, np.zeros(len(problem.priors), dtype))}
    return solver.init(residual, coordinate, problem, options, shape, prediction, frozenset())


def _several(problem: Problem) -> bool:
    """Whether there are several runs."""
    return sum(len(group.members) for group in problem.groups) > 1


def _of_runs(
    call: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem, sample: bool
) -> Iterable[tuple[np.ndarray, ...]]:
    """What a program gives of the runs of each group, with a leading run axis."""
    whole = np.asarray(coordinate)
    # The runs come with the group that they are in, and only those of a share.
    common = dataclasses.replace(problem, groups=())
    batches, places = [], []
    for group in problem.groups:
        measured = np.count_nonzero(np.any(np.asarray(group.weight) > 0, axis=-1), axis=-1)
        length = in_a_share(len(measured))
        place = dealt(measured, length)[-1] if sample else np.arange(len(measured))
        runs = dataclasses.replace(group, members=(), first=0, shared=())
        items = jax.tree.map(lambda leaf, at=place: np.asarray(leaf)[at], runs)
        values = whole[group.columns()[place]]
        batches.append(Batch(call, (values, items), (common,), measured[place], length))
        places.append((place, len(measured)))
    found = on_all_cores(batches)
    if not sample:
        return found
    return [_among(part, *at) for part, at in zip(found, places, strict=True)]


def _among(part: tuple[np.ndarray, ...], place: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """What was found of some runs among all of them: zero for the others, which do not fail."""
    whole = [np.full((count, *leaf.shape[1:]), leaf.dtype == bool, leaf.dtype) for leaf in part]
    for leaf, known in zip(whole, part, strict=True):
        leaf[place] = known
    return tuple(whole)


# At module level: a fresh closure would be compiled again for every fit. What each of them returns
# stands beside it, for the programs that are kept between processes.


def _stepped(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> Stepped:
    truth = jax.ShapeDtypeStruct((), bool)
    return coordinate, state, truth, truth


@functools.partial(program, like=_stepped)
def _step(
    solver: Marquardt, coordinate: Array, problem: Problem, state: MarquardtState, active: Array
) -> Stepped:
    options = _options(problem, active) | {"linearise": linearise}
    coordinate, state, _ = solver.step(residual, coordinate, problem, options, state, frozenset())
    return _ended(solver, coordinate, problem, state, options)


@functools.partial(program, like=lambda solver, coordinate, *rest: coordinate)
def _propose(
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
def _judge(
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
def _linearised(runs: tuple[Array, Group], problem: Problem) -> tuple[Array, ...]:
    values, group = runs
    return of_group(linearise_run, values, group, problem)


def _predicted_like(runs: tuple[Array, Group], problem: Problem) -> tuple[Any, ...]:
    values, group = runs
    count = values.shape[0]
    row = jax.ShapeDtypeStruct((count, group.observed.size // count), values.dtype)
    table = jax.ShapeDtypeStruct(group.observed.shape, values.dtype)
    return row, table, jax.ShapeDtypeStruct((count,), bool)


@functools.partial(program, like=_predicted_like)
def _predicted(runs: tuple[Array, Group], problem: Problem) -> tuple[Array, ...]:
    values, group = runs
    return of_group(whitened_run, values, group, problem)


def _row(coordinate: Array, problem: Problem) -> Any:
    count = sum(group.observed.size for group in problem.groups) + len(problem.priors)
    return jax.ShapeDtypeStruct((count,), coordinate.dtype)


@functools.partial(program, like=_row)
def _residuals(coordinate: Array, problem: Problem) -> Array:
    row, prediction = residual(coordinate, problem)
    return jnp.where(prediction.successful, row, jnp.nan)


@functools.partial(program, like=lambda parts, coordinate, problem: _row(coordinate, problem))
def _joined(parts: Any, coordinate: Array, problem: Problem) -> Array:
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
