"""Residuals of the runs of a problem: one run, those of a group one after the other, and all."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from .._typing import Array, Float
from ..parameters import get, replace
from ._group import Group
from ._loss import transform
from ._problem import Prediction, Problem
from ._ties import within_bounds
from ._whitening import Whitening


def run_residual(
    shared_and_own: Float[Array, " own"],
    problem: Problem,
    group: Group,
    inputs: Any,
    observed: Array,
    weight: Array,
) -> tuple[Float[Array, " residual"], tuple[Array, Array]]:
    """Residual of one run, not whitened; beside it its prediction and whether that succeeded."""
    count = len(problem.paths)
    inputs = _with_own(inputs, group, shared_and_own[count:])
    model = problem.at(shared_and_own).for_derivatives(problem.free_paths(group))
    predicted, successful = model.predict(inputs, group.channels)
    table = jnp.stack([predicted[name] for name in group.channels], axis=-1)
    if problem.ties:
        # A step that leads a tied parameter beyond its bounds is rejected.
        successful = successful & within_bounds(model, problem.ties)
        table = jnp.where(successful, table, jnp.nan)
    # An unmeasured cell must not carry the NaN of a failed simulation times zero.
    difference = jnp.where(weight > 0, (table - observed) * weight, 0)
    return transform(problem.loss, difference.ravel()), (table, successful)


def whitened(columns: Float[Array, "residual column"], whitening: Whitening | None) -> Array:
    """Residuals of a run, or columns of their Jacobian, made independent of each other."""
    return columns if whitening is None else whitening.apply(columns)


def _with_own(inputs: Any, group: Group, values: Float[Array, " own"]) -> Any:
    start = 0
    for path, size in group.own:
        shape = get(inputs, path).shape
        inputs = replace(inputs, {path: values[start : start + size].reshape(shape)})
        start += size
    return inputs


def residual(
    coordinate: Float[Array, " parameter"], problem: Problem
) -> tuple[Float[Array, " residual"], Prediction]:
    """Transformed weighted residuals of all runs in one row, those of the priors last; predictions.

    A module-level function: a fresh closure would be compiled again for every fit.
    """
    return joined(over_runs(whitened_run, coordinate, problem), coordinate, problem)


def whitened_run(
    values: Array,
    problem: Problem,
    group: Group,
    inputs: Any,
    observed: Array,
    weight: Array,
    whitening: Any,
) -> tuple[Array, ...]:
    """A run's residual, its prediction, and whether that succeeded; arguments as `of_group` has."""
    row, (table, successful) = run_residual(values, problem, group, inputs, observed, weight)
    return whitened(row[:, None], whitening)[:, 0], table, successful


def joined(
    parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem
) -> tuple[Float[Array, " residual"], Prediction]:
    """As `residual`, from what `whitened_run` gives of each group, with a leading run axis."""
    rows, tables, successes = zip(*parts, strict=True)
    known, _ = problem.priors.rows(coordinate, problem.bijector)
    row = jnp.concatenate([*(part.ravel() for part in rows), known])
    return row, Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))


def over_runs(
    one: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem
) -> list[tuple[Array, ...]]:
    """Results of `one` for each group, with a leading run axis."""
    return [of_group(one, coordinate[g.columns()], g, problem) for g in problem.groups]


def of_group(
    one: Callable[..., tuple[Array, ...]],
    values: Float[Array, "run own"],
    group: Group,
    problem: Problem,
) -> tuple[Array, ...]:
    """Results of a function for the runs of a group, with a leading run axis.

    Arguments:
        one: of a run's coordinates, the problem, the group, and the run's inputs, observed values,
            weights and whitening.
        values: coordinates that each run responds to.
        group: of these runs.
        problem: what they are a part of; its own groups do not count.
    """
    rows = (values, group.inputs, group.observed, group.weight, group.whitening)

    def each(row: Any) -> tuple[Array, ...]:
        own, *rest = row
        return one(own, problem, group, *rest)

    if values.shape[0] == 1:
        result = each(jax.tree.map(lambda leaf: leaf[0], rows))
        return tuple(leaf[None] for leaf in result)
    # One run after the other: each keeps its own steps; the program is compiled once.
    return tuple(jax.lax.map(each, rows))
