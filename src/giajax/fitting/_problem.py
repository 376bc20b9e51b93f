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
    """Stack pytrees. Last rows are repeated if the first axes have different lengths."""

    def stack(*leaves: Array) -> Array:
        # NumPy is used, because with JAX each shape would be a program to compile before the fit
        # begins.
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
"""Paths and sizes of the prepared inputs that are free parameters in each run."""


def batch_members(
    model: AbstractModel, runs: Sequence[Run], prepared: Sequence[Any]
) -> list[tuple[tuple[str, ...], Own, list[int]]]:
    """Return the positions of runs that share a program, with their channels and own parameters."""
    members: dict[Any, list[int]] = {}
    for index, (run, inputs) in enumerate(zip(runs, prepared, strict=True)):
        free = capabilities.free_inputs(model, run)
        own = tuple((path, get(inputs, path).size) for path in free)
        key = tuple(run.observations), own, jax.tree.structure(inputs)
        members.setdefault(key, []).append(index)
    return [(channels, own, indices) for (channels, own, _), indices in members.items()]


def chunk_size(count: int) -> int:
    """Return the number of runs, of those that share a program, that a core evaluates at once.

    It is larger than one for many runs, because each start takes half a millisecond. It is a
    divisor, so no run is left over. It is small, so no core waits for another at the end: there are
    at least 16 shares, or as many as runs. It does not depend on the machine, so programs are the
    same everywhere.
    """
    return next(n for n in (4, 3, 2, 1) if n == 1 or (count % n == 0 and count >= 16 * n))


def sample_size(count: int) -> int:
    """Return the number of runs of a program that are used to check its derivatives."""
    return min(4, max(1, count // 8))


def prepared_with(model: AbstractModel, run: Run, own: Mapping[str, float]) -> Any:
    """Prepare a run with given values of its own free parameters, by label (`initial.angle[0]`)."""
    inputs = model.prepare(run)
    for path in capabilities.free_inputs(model, run):
        values = np.array(get(inputs, path), dtype=float)
        for index, label in enumerate(element_labels(path, values.size)):
            values.reshape(-1)[index] = own.get(label, values.reshape(-1)[index])
        inputs = replace(inputs, {path: values})
    return inputs


Recorded = Sequence[Mapping[str, np.ndarray]]
"""For each run, the values by channel in SI units, with NaN where a cell is not used."""


def recorded_cells(
    runs: Sequence[Run],
    noise: Noise,
    indices: Sequence[int],
    channels: Sequence[str],
    recorded: Recorded,
) -> dict[str, Any]:
    """Return the recorded cells, weights and whitening of a batch, padded to the longest run."""
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
    """Return the roots of the weights of cells in a run without times, which has no whitening."""
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
    """Return the stacked whitening of the runs of a batch, or None if all noise is white."""
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
        inputs: inputs that the model prepared. Each leaf has a leading run axis.
        observed: recorded values, 0 where not measured.
        weight: 1 / standard deviation, 0 where not measured.
        whitening: whitening of correlated noise, or None if the noise cannot be correlated.
        channels: names of the channels.
        members: positions of the runs in the list of fitted runs.
        own: paths and sizes as in `batch_members`.
        first: position of the first own parameter of these runs in the free coordinate.
        shared: for each run, the positions of its values of the model's free parameters.
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
        """Return the positions of each run's own coordinates, shape (run, own)."""
        count = len(self.members) * self.width
        return self.first + np.arange(count).reshape(len(self.members), self.width)

    def columns(self) -> np.ndarray:
        """Return the positions of coordinates that affect each run, shape (run, shared + own)."""
        return np.concatenate([np.asarray(self.shared, dtype=int), self.own_columns()], axis=1)

    def own_labels(self) -> list[str]:
        """Return the names of the coordinates that belong to one run, by element."""
        return [label for path, size in self.own for label in element_labels(path, size)]


def build_batches(
    model: AbstractModel, runs: Sequence[Run], noise: Noise, layout: Layout
) -> tuple[RunBatch, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them.

    The batches are in the order of their first runs. The layout contains the parameters of the
    model.
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
    """Return batches with different values or noise. The prepared inputs of the runs stay."""
    return tuple(
        dataclasses.replace(
            batch, **recorded_cells(runs, noise, batch.members, batch.channels, recorded)
        )
        for batch in batches
    )


def own_start(
    batches: Sequence[RunBatch], runs: Sequence[Run], begun: Mapping[str, Mapping[str, float]]
) -> np.ndarray:
    """Return the initial coordinates of single runs: as prepared, unless `begun` has a value."""
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
    """All quantities on which the residual depends, except the free coordinates.

    The coordinate begins with the values of the model's parameters: one value that all runs share,
    or one for each group of runs. The parameters of single runs follow, which have no bounds. A run
    depends on its values of the model's parameters and on its own parameters. The Jacobian is
    computed and stored in the corresponding blocks.

    Attributes:
        model: model with the held parameters.
        batches: batches of runs that share a program.
        bijector: map of the whole coordinate to parameters.
        paths: paths of the model's free parameters.
        loss: loss function, which weights large residuals.
        places: positions of the values of each path in the coordinate. If empty, each path has one
            value, in order.
        ties: parameters that are computed from others.
        priors: priors of the coordinates. Their rows of the residual come last.
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
        """Positions of the values of each path in the coordinate."""
        return self.places or tuple((index,) for index in range(len(self.paths)))

    @property
    def shared(self) -> int:
        """Number of coordinates before those of single runs."""
        return sum(map(len, self.positions))

    def at(self, coordinate: Float[Array, " own"]) -> AbstractModel:
        """Return the model at the coordinates of a run, with one coordinate for each path."""
        bounds = self.bijector.at([place[0] for place in self.positions])
        return self.with_values(bounds.forward(coordinate[: len(self.paths)]))

    def with_values(self, values: Float[Array | np.ndarray, " path"]) -> AbstractModel:
        """Return the model with a value for each path, and with the tied parameters updated."""
        model = replace(self.model, {path: values[i] for i, path in enumerate(self.paths)})
        return tied(model, self.ties)

    def means(self, values: Array | np.ndarray) -> Array | np.ndarray:
        """Return a value for each path from all coordinates. Several values are averaged."""
        means = [values[np.asarray(place)].mean() for place in self.positions]
        if isinstance(values, np.ndarray):
            return np.asarray(means)
        return jnp.stack(means) if means else jnp.zeros(0)

    def free_paths(self, batch: RunBatch) -> tuple[str, ...]:
        """Return all paths with respect to which the predictions of a batch are differentiated."""
        following = (tie.path for tie in self.ties)
        return (*self.paths, *following, *(path for path, _ in batch.own))


class Prediction(eqx.Module):
    """Auxiliary output of the residual.

    Attributes:
        channels: predictions of each batch, SI units, shape (run, sample, channel).
        successful: whether all simulations succeeded.
    """

    channels: tuple[Any, ...]
    successful: Any


def predictions_by_run(
    problem: Problem, prediction: Prediction, runs: Sequence[Run]
) -> list[dict[str, np.ndarray]]:
    """Return the predicted channels (SI units) of each run, without the padding."""
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
    """Return the residual of one run before whitening, its prediction and its success."""
    inputs, observed, weight, _ = run
    count = len(problem.paths)
    inputs = _with_own(inputs, batch, shared_and_own[count:])
    model = capabilities.for_derivatives(problem.at(shared_and_own), problem.free_paths(batch))
    predicted, successful = model.predict(inputs, batch.channels)
    table = jnp.stack([predicted[name] for name in batch.channels], axis=-1)
    if problem.ties:
        # A step that moves a tied parameter outside its bounds is rejected.
        successful = successful & within_bounds(model, problem.ties)
        table = jnp.where(successful, table, jnp.nan)
    # An unmeasured cell must not receive NaN, from a failed simulation times zero.
    difference = jnp.where(weight > 0, (table - observed) * weight, 0)
    return problem.loss.transform(difference.ravel()), (table, successful)


def whitened(columns: Float[Array, "residual column"], whitening: Whitening | None) -> Array:
    """Whiten the residuals of a run, or columns of their Jacobian."""
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
    """Return the transformed weighted residuals of all runs as one row, and the predictions.

    The residuals of the priors come last. The function is at module level, because a new closure
    would be compiled again for every fit.
    """
    return joined(over_runs(whitened_run, coordinate, problem), coordinate, problem)


def whitened_run(
    values: Array, problem: Problem, batch: RunBatch, run: tuple[Any, ...]
) -> tuple[Array, ...]:
    """Return the whitened residual of a run, its prediction and its success, for `over_batch`."""
    row, (table, successful) = run_residual(values, problem, batch, run)
    return whitened(row[:, None], run[-1])[:, 0], table, successful


def joined(
    parts: Sequence[tuple[Any, ...]], coordinate: Array, problem: Problem
) -> tuple[Float[Array, " residual"], Prediction]:
    """Join the results of `whitened_run` for each batch (leading run axis) as in `residual`."""
    rows, tables, successes = zip(*parts, strict=True)
    known, _ = problem.priors.rows(coordinate, problem.bijector)
    row = jnp.concatenate([*(part.ravel() for part in rows), known])
    return row, Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))


def over_runs(
    one: Callable[..., tuple[Array, ...]], coordinate: Array, problem: Problem
) -> list[tuple[Array, ...]]:
    """Return the results of `one` for each batch, with a leading run axis."""
    return [over_batch(one, coordinate[g.columns()], g, problem) for g in problem.batches]


def over_batch(
    one: Callable[..., tuple[Array, ...]],
    values: Float[Array, "run own"],
    batch: RunBatch,
    problem: Problem,
) -> tuple[Array, ...]:
    """Return the results of a function such as `whitened_run` for a batch.

    The results have a leading run axis. The batches of the problem itself are not used.
    """
    rows = (values, batch.inputs, batch.observed, batch.weight, batch.whitening)

    def each(row: Any) -> tuple[Array, ...]:
        return one(row[0], problem, batch, row[1:])

    if values.shape[0] == 1:
        result = each(jax.tree.map(lambda leaf: leaf[0], rows))
        return tuple(leaf[None] for leaf in result)
    # The runs are evaluated one after the other, because each has its own steps. The program is
    # compiled once.
    return tuple(jax.lax.map(each, rows))
