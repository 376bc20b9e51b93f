"""The least-squares problem: weighted differences between predicted and recorded channels."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import Run
from ..runtime.arrays import Array, Float, on_device
from ..schema.parameters import get, replace
from ._configuration import Tie, element_labels, tied, within_bounds
from ._coordinates import Bijector, Layout
from ._losses import AbstractLoss
from ._weights import Noise, Priors, Whitening


def stacked(trees: Sequence[Any]) -> Any:
    """Stack pytrees, repeating last rows where the first axes differ (see `prepare`)."""

    def stack(*leaves: Array) -> Array:
        # By numpy: each shape would be a program of its own, compiled before the fit begins.
        rows = [np.asarray(leaf) for leaf in leaves]
        length = max(row.shape[0] if row.ndim else 0 for row in rows)
        padded = [
            np.concatenate([row, np.repeat(row[-1:], length - row.shape[0], axis=0)])
            if row.ndim and row.shape[0] < length
            else row
            for row in rows
        ]
        return jax.device_put(np.stack(padded))

    return jax.tree.map(stack, *trees)


Own = tuple[tuple[str, int], ...]
"""Paths and sizes of the prepared inputs' parameters that are free in each run."""


def batch_members(
    model: AbstractModel, runs: Sequence[Run], prepared: Sequence[Any]
) -> list[tuple[tuple[str, ...], Own, list[int]]]:
    """Positions of the runs that share a program, with the channels and what is free in each."""
    members: dict[Any, list[int]] = {}
    for index, (run, inputs) in enumerate(zip(runs, prepared, strict=True)):
        free = capabilities.free_inputs(model, run)
        own = tuple((path, get(inputs, path).size) for path in free)
        key = tuple(run.observations), own, jax.tree.structure(inputs)
        members.setdefault(key, []).append(index)
    return [(channels, own, indices) for (channels, own, _), indices in members.items()]


def chunk_size(count: int) -> int:
    """How many of some runs that share a program a core takes at once.

    Several of many, because to begin costs half a millisecond; a divisor, so that none is left
    over; few, so that no core waits for another's last ones: there are at least 16 shares, or as
    many as runs. It does not depend on the machine, so that programs are the same everywhere.
    """
    return next(n for n in (4, 3, 2, 1) if n == 1 or (count % n == 0 and count >= 16 * n))


def sample_size(count: int) -> int:
    """How many of some runs that share a program say whether its derivatives are right."""
    return min(4, max(1, count // 8))


def prepared_with(model: AbstractModel, run: Run, own: Mapping[str, float]) -> Any:
    """A prepared run with values of what is free in it alone, by label (`initial.angle[0]`)."""
    inputs = model.prepare(run)
    for path in capabilities.free_inputs(model, run):
        values = np.array(get(inputs, path), dtype=float)
        for index, label in enumerate(element_labels(path, values.size)):
            values.reshape(-1)[index] = own.get(label, values.reshape(-1)[index])
        inputs = replace(inputs, {path: values})
    return inputs


Recorded = Sequence[Mapping[str, np.ndarray]]
"""Of each run, values by channel, SI; NaN where a cell does not count."""


def recorded_cells(
    runs: Sequence[Run],
    noise: Noise,
    indices: Sequence[int],
    channels: Sequence[str],
    recorded: Recorded,
) -> dict[str, Any]:
    """What of a batch of runs depends on their values and noise, padded to the longest."""
    observed = [np.stack([recorded[i][c] for c in channels], -1) for i in indices]
    weight = [
        np.where(
            np.isnan(cells), 0.0, 1 / np.asarray([noise.values[i][c].deviation for c in channels])
        )
        * _root_weights(noise, runs[i], i, channels)
        for i, cells in zip(indices, observed, strict=True)
    ]
    length = max(len(cells) for cells in observed)
    return {
        "observed": _padded([np.nan_to_num(cells) for cells in observed], length),
        "weight": _padded(weight, length),
        "whitening": _whitening(runs, noise, indices, channels, length, recorded),
    }


def _root_weights(noise: Noise, run: Run, index: int, channels: Sequence[str]) -> np.ndarray:
    """Roots of the cells' weights, where no whitening has them: in a run without time."""
    if noise.weights is None or run.times is not None:
        return np.ones(())
    return np.sqrt(np.stack([noise.weights[index][name] for name in channels], axis=-1))


def _whitening(
    runs: Sequence[Run],
    noise: Noise,
    indices: Sequence[int],
    channels: Sequence[str],
    length: int,
    recorded: Recorded,
) -> Whitening | None:
    """That of the runs of a batch, stacked; None where noise is white for sure."""
    if not noise.correlated:
        return None
    parts = []
    for i in indices:
        times = runs[i].times
        if times is None:
            return None
        weights = {
            name: np.where(np.isnan(cells), 0.0, 1.0 if known is None else known[name])
            for known in [None if noise.weights is None else noise.weights[i]]
            for name, cells in recorded[i].items()
        }
        of_run = {name: noise.values[i][name] for name in channels}
        parts.append(Whitening.of(of_run, times, weights, length))
    dtype = jnp.result_type(float)
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves), dtype=dtype), *parts)


def _padded(arrays: Sequence[np.ndarray], length: int) -> Array:
    rows = [np.pad(a, ((0, length - len(a)), (0, 0))) for a in arrays]
    return on_device(np.stack(rows), jnp.result_type(float))


class RunBatch(eqx.Module):
    """Runs with the same channels, stacked along a first axis so that they share a program.

    Attributes:
        inputs: what the model prepared, each leaf with a leading run axis.
        observed: recorded values, 0 where not measured.
        weight: 1 / standard deviation, 0 where not measured.
        whitening: of correlated noise; None where there can be none.
        members: positions of the runs in the list that was fitted.
        own: as of `batch_members`.
        first: position of the first of them in the free coordinate.
        shared: by run, the position of its value of each of the model's free parameters.
    """

    inputs: Any
    observed: Float[Array, "run sample channel"]
    weight: Float[Array, "run sample channel"]
    whitening: Whitening | None
    channels: tuple[str, ...] = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    own: Own = eqx.field(static=True)
    first: int = eqx.field(static=True)
    shared: tuple[tuple[int, ...], ...] = eqx.field(static=True)

    @property
    def width(self) -> int:
        """Number of free coordinates that belong to each run alone."""
        return sum(size for _, size in self.own)

    def own_columns(self) -> np.ndarray:
        """Positions of each run's own coordinates in the whole, shape (run, own)."""
        count = len(self.members) * self.width
        return self.first + np.arange(count).reshape(len(self.members), self.width)

    def columns(self) -> np.ndarray:
        """Positions in the whole of all that each run responds to, shape (run, shared + own)."""
        return np.concatenate([np.asarray(self.shared, dtype=int), self.own_columns()], axis=1)

    def own_labels(self) -> list[str]:
        """Names of the coordinates that belong to one run, element by element."""
        return [label for path, size in self.own for label in element_labels(path, size)]


def build_batches(
    model: AbstractModel, runs: Sequence[Run], noise: Noise, layout: Layout
) -> tuple[RunBatch, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them.

    The batches are in the order of their first runs; the layout is of the model's own parameters.
    """
    prepared = [model.prepare(run) for run in runs]
    batches = []
    first = layout.size
    recorded = [run.observations for run in runs]
    for channels, own, indices in batch_members(model, runs, prepared):
        batch = RunBatch(
            inputs=stacked([prepared[i] for i in indices]),
            **recorded_cells(runs, noise, indices, channels, recorded),
            channels=channels,
            members=tuple(indices),
            own=own,
            first=first,
            shared=tuple(layout.of_runs[i] for i in indices),
        )
        first += len(indices) * batch.width
        batches.append(batch)
    return tuple(batches)


def with_recorded(
    batches: Sequence[RunBatch], runs: Sequence[Run], noise: Noise, recorded: Recorded
) -> tuple[RunBatch, ...]:
    """Batches with other values or another noise; what was prepared of the runs stays."""
    return tuple(
        dataclasses.replace(
            batch, **recorded_cells(runs, noise, batch.members, batch.channels, recorded)
        )
        for batch in batches
    )


def own_start(
    batches: Sequence[RunBatch], runs: Sequence[Run], begun: Mapping[str, Mapping[str, float]]
) -> np.ndarray:
    """Where the coordinates of the single runs start: as prepared, where they are not `begun`."""
    values: list[float] = []
    for batch in batches:
        for row, member in enumerate(batch.members):
            known = begun.get(runs[member].name, {})
            for path, size in batch.own:
                usual = np.asarray(get(batch.inputs, path)[row], dtype=float).ravel().tolist()
                labels = element_labels(path, size)
                values += [known.get(n, start) for n, start in zip(labels, usual, strict=True)]
    return np.asarray(values, dtype=float)


class Problem(eqx.Module):
    """Everything that the residual depends on, apart from the free coordinates.

    The coordinate begins with the values of the model's parameters, one each that all runs share
    or one for each group of runs; then come those of each run alone, which have no bounds. A run
    responds to its values of the former and to its own: the Jacobian is computed and stored in
    these blocks.

    Attributes:
        model: with what is not free.
        batches: of runs that share a program.
        bijector: of the whole coordinate.
        paths: of the model's free parameters.
        loss: how a large residual counts.
        places: positions of each path's values in the coordinate; one each, in their order, where
            it is empty.
        ties: parameters that follow from others.
        priors: what is known of the coordinates before; their rows of the residual come last.
    """

    model: AbstractModel
    batches: tuple[RunBatch, ...]
    bijector: Bijector
    paths: tuple[str, ...] = eqx.field(static=True)
    loss: AbstractLoss = eqx.field(static=True)
    places: tuple[tuple[int, ...], ...] = eqx.field(static=True, default=())
    ties: tuple[Tie, ...] = eqx.field(static=True, default=())
    priors: Priors = eqx.field(default_factory=lambda: Priors.of({}, ()))

    @property
    def size(self) -> int:
        """Number of free coordinates."""
        return self.shared + sum(len(g.members) * g.width for g in self.batches)

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

    def free_paths(self, batch: RunBatch) -> tuple[str, ...]:
        """Paths of all that the predictions of a batch's runs are differentiated by."""
        following = (tie.path for tie in self.ties)
        return (*self.paths, *following, *(path for path, _ in batch.own))


class Prediction(eqx.Module):
    """What comes out beside the residual.

    Attributes:
        channels: predictions of each batch (SI), shape (run, sample, channel).
        successful: whether all simulations succeeded.
    """

    channels: tuple[Any, ...]
    successful: Any


def predictions_by_run(
    problem: Problem, prediction: Prediction, runs: Sequence[Run]
) -> list[dict[str, np.ndarray]]:
    """Predicted channels (SI) of each run, without the padding."""
    by_run: list[dict[str, np.ndarray]] = [{} for _ in runs]
    for batch, predicted in zip(problem.batches, prediction.channels, strict=True):
        table = np.asarray(predicted)
        for row, member in enumerate(batch.members):
            count = len(next(iter(runs[member].observations.values())))
            by_run[member] = {
                name: table[row, :count, column] for column, name in enumerate(batch.channels)
            }
    return by_run


def run_residual(
    shared_and_own: Float[Array, " own"],
    problem: Problem,
    batch: RunBatch,
    run: tuple[Any, ...],
) -> tuple[Float[Array, " residual"], tuple[Array, Array]]:
    """Residual of one run, not whitened; beside it its prediction and whether that succeeded."""
    inputs, observed, weight, _ = run
    count = len(problem.paths)
    inputs = _with_own(inputs, batch, shared_and_own[count:])
    model = capabilities.for_derivatives(problem.at(shared_and_own), problem.free_paths(batch))
    predicted, successful = model.predict(inputs, batch.channels)
    table = jnp.stack([predicted[name] for name in batch.channels], axis=-1)
    if problem.ties:
        # A step that leads a tied parameter beyond its bounds is rejected.
        successful = successful & within_bounds(model, problem.ties)
        table = jnp.where(successful, table, jnp.nan)
    # An unmeasured cell must not carry the NaN of a failed simulation times zero.
    difference = jnp.where(weight > 0, (table - observed) * weight, 0)
    return problem.loss.transform(difference.ravel()), (table, successful)


def whitened(columns: Float[Array, "residual column"], whitening: Whitening | None) -> Array:
    """Residuals of a run, or columns of their Jacobian, made independent of each other."""
    return columns if whitening is None else whitening.apply(columns)


def _with_own(inputs: Any, batch: RunBatch, values: Float[Array, " own"]) -> Any:
    start = 0
    for path, size in batch.own:
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
    values: Array, problem: Problem, batch: RunBatch, run: tuple[Any, ...]
) -> tuple[Array, ...]:
    """A run's residual, its prediction, and whether that succeeded; as `over_batch` calls it."""
    row, (table, successful) = run_residual(values, problem, batch, run)
    return whitened(row[:, None], run[-1])[:, 0], table, successful


def joined(
    parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem
) -> tuple[Float[Array, " residual"], Prediction]:
    """As `residual`, from what `whitened_run` gives of each batch, with a leading run axis."""
    rows, tables, successes = zip(*parts, strict=True)
    known, _ = problem.priors.rows(coordinate, problem.bijector)
    row = jnp.concatenate([*(part.ravel() for part in rows), known])
    return row, Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))


def over_runs(
    one: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem
) -> list[tuple[Array, ...]]:
    """Results of `one` for each batch, with a leading run axis."""
    return [over_batch(one, coordinate[g.columns()], g, problem) for g in problem.batches]


def over_batch(
    one: Callable[..., tuple[Array, ...]],
    values: Float[Array, "run own"],
    batch: RunBatch,
    problem: Problem,
) -> tuple[Array, ...]:
    """Results of `whitened_run`, or its like, for a batch, with a leading run axis.

    The batches of the problem itself do not count.
    """
    rows = (values, batch.inputs, batch.observed, batch.weight, batch.whitening)

    def each(row: Any) -> tuple[Array, ...]:
        return one(row[0], problem, batch, row[1:])

    if values.shape[0] == 1:
        result = each(jax.tree.map(lambda leaf: leaf[0], rows))
        return tuple(leaf[None] for leaf in result)
    # One run after the other: each keeps its own steps; the program is compiled once.
    return tuple(jax.lax.map(each, rows))
