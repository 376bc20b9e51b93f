"""The least-squares problem: weighted differences between predicted and recorded channels."""

from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import get, replace
from ..runs import Run
from ._bijector import Bijector
from ._group import Group
from ._loss import transform
from ._whitening import Whitening


class Problem(eqx.Module):
    """Everything that the residual depends on, apart from the free coordinates.

    The coordinate begins with that of the model's parameters, which all runs share; then come
    those of each run alone, which have no bounds. A run responds to the shared ones and its own:
    the Jacobian is computed and stored in these blocks.
    """

    model: AbstractModel
    groups: tuple[Group, ...]
    bijector: Bijector
    paths: tuple[str, ...] = eqx.field(static=True)
    loss: str = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return len(self.paths) + sum(len(g.members) * g.width for g in self.groups)

    def at(self, coordinate: Float[Array, " parameter"]) -> AbstractModel:
        """The model at free coordinates, of which the first ones count."""
        values = self.bijector.part(len(self.paths)).forward(coordinate[: len(self.paths)])
        return replace(self.model, {path: values[i] for i, path in enumerate(self.paths)})

    def free_paths(self, group: Group) -> tuple[str, ...]:
        """Paths of all that the predictions of a group's runs are differentiated by."""
        return (*self.paths, *(path for path, _ in group.own))

    def labels(self, runs: Sequence[Run]) -> list[str]:
        """Names of all free coordinates."""
        names = list(self.paths)
        for group in self.groups:
            for member in group.members:
                names += [f"{label} of '{runs[member].name}'" for label in group.own_labels()]
        return names


class Prediction(eqx.Module):
    """What comes out beside the residual.

    Attributes:
        channels: predictions of each group (SI), shape (run, sample, channel).
        successful: whether all simulations succeeded.
    """

    channels: tuple[Any, ...]
    successful: Any


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
    """Transformed weighted residuals of all runs in one row, and the predictions.

    A module-level function: a fresh closure would be compiled again for every fit.
    """

    def one(
        values: Array, group: Group, inputs: Any, observed: Array, weight: Array, whitening: Any
    ) -> tuple[Array, ...]:
        row, (table, successful) = run_residual(values, problem, group, inputs, observed, weight)
        return whitened(row[:, None], whitening)[:, 0], table, successful

    rows, tables, successes = zip(*over_runs(one, coordinate, problem), strict=True)
    row = jnp.concatenate([part.ravel() for part in rows])
    successful = jnp.all(jnp.concatenate(successes))
    return row, Prediction(tuple(tables), successful)


def over_runs(
    one: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem
) -> list[tuple[Array, ...]]:
    """Results of `one` for each group, with a leading run axis."""
    results = []
    for group in problem.groups:
        own = group.own_values(coordinate)
        shared = jnp.broadcast_to(
            coordinate[None, : len(problem.paths)], (len(group.members), len(problem.paths))
        )
        rows = (
            jnp.concatenate([shared, own], axis=1),
            group.inputs,
            group.observed,
            group.weight,
            group.whitening,
        )

        def each(row: Any, group: Group = group) -> tuple[Array, ...]:
            values, inputs, observed, weight, whitening = row
            return one(values, group, inputs, observed, weight, whitening)

        if len(group.members) == 1:
            result = each(jax.tree.map(lambda leaf: leaf[0], rows))
            results.append(tuple(leaf[None] for leaf in result))
        else:
            # One run after the other: each keeps its own steps; the program is compiled once.
            results.append(jax.lax.map(each, rows))
    return results


def predictions_by_run(
    problem: Problem, prediction: Prediction, runs: Sequence[Run]
) -> list[dict[str, np.ndarray]]:
    """Predicted channels (SI) of each run, without the padding."""
    by_run: list[dict[str, np.ndarray]] = [{} for _ in runs]
    for group, predicted in zip(problem.groups, prediction.channels, strict=True):
        table = np.asarray(predicted)
        for row, member in enumerate(group.members):
            count = len(next(iter(runs[member].observations.values())))
            by_run[member] = {
                name: table[row, :count, column] for column, name in enumerate(group.channels)
            }
    return by_run
