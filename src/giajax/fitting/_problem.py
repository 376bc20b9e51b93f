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
from ._priors import Priors
from ._ties import Tie, tied, within_bounds
from ._whitening import Whitening


class Problem(eqx.Module):
    """Everything that the residual depends on, apart from the free coordinates.

    The coordinate begins with the values of the model's parameters, one each that all runs share
    or one for each group of runs; then come those of each run alone, which have no bounds. A run
    responds to its values of the former and to its own: the Jacobian is computed and stored in
    these blocks.

    Attributes:
        model: with what is not free.
        groups: of runs that share a program.
        bijector: of the whole coordinate.
        paths: of the model's free parameters.
        loss: how a large residual counts.
        places: positions of each path's values in the coordinate; one each, in their order, where
            it is empty.
        ties: parameters that follow from others.
        priors: what is known of the coordinates before; their rows of the residual come last.
    """

    model: AbstractModel
    groups: tuple[Group, ...]
    bijector: Bijector
    paths: tuple[str, ...] = eqx.field(static=True)
    loss: str = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    ties: tuple[Tie, ...] = eqx.field(static=True, default=())
    priors: Priors = eqx.field(default_factory=Priors.none)

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return self.shared + sum(len(g.members) * g.width for g in self.groups)

    @property
    def positions(self) -> tuple[tuple[int, ...], ...]:
        """Positions of each path's values in the coordinate."""
        return self.places or tuple((index,) for index in range(len(self.paths)))

    @property
    def shared(self) -> int:
        """Number of coordinates before those of single runs."""
        return sum(map(len, self.positions))

    def at(self, coordinate: Float[Array, " own"]) -> AbstractModel:
        """The model at the coordinates of a run, of which one a path counts."""
        bounds = self.bijector.at([place[0] for place in self.positions])
        return self.with_values(bounds.forward(coordinate[: len(self.paths)]))

    def with_values(self, values: Float[Array | np.ndarray, " path"]) -> AbstractModel:
        """The model with a value for each path, and with what follows from them."""
        model = replace(self.model, {path: values[i] for i, path in enumerate(self.paths)})
        return tied(model, self.ties)

    def means(self, values: Array | np.ndarray) -> Array | np.ndarray:
        """A value for each path, of those of all coordinates: of several, the mean."""
        means = [values[np.asarray(place)].mean() for place in self.positions]
        if isinstance(values, np.ndarray):
            return np.asarray(means)
        return jnp.stack(means) if means else jnp.zeros(0)

    def free_paths(self, group: Group) -> tuple[str, ...]:
        """Paths of all that the predictions of a group's runs are differentiated by."""
        return (*self.paths, *(path for path, _ in group.own))


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
