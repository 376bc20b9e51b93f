"""The least-squares problem: weighted differences between predicted and recorded channels."""

from collections.abc import Callable, Mapping, Sequence
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
from ._loss import transform

Sigmas = list[dict[str, float]]
"""Standard deviation of each channel (SI) of each run."""


class Group(eqx.Module):
    """Runs with the same channels, stacked along a first axis so that they share a program.

    Attributes:
        inputs: what the model prepared, each leaf with a leading run axis.
        observed: recorded values, 0 where not measured.
        weight: 1 / standard deviation, 0 where not measured.
        channels: names, in the order of the third axis of `observed`.
        members: positions of the runs in the list that was fitted.
        own: paths and sizes of the prepared inputs' parameters that are free in each run.
        first: position of the first of them in the free coordinate.
    """

    inputs: Any
    observed: Float[Array, "run sample channel"]
    weight: Float[Array, "run sample channel"]
    channels: tuple[str, ...] = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    own: tuple[tuple[str, int], ...] = eqx.field(static=True)
    first: int = eqx.field(static=True)

    @property
    def width(self) -> int:
        """Number of free coordinates that belong to each run alone."""
        return sum(size for _, size in self.own)

    def own_columns(self) -> np.ndarray:
        """Positions of each run's own coordinates in the whole, shape (run, own)."""
        count = len(self.members) * self.width
        return self.first + np.arange(count).reshape(len(self.members), self.width)

    def own_values(self, coordinate: Float[Array, " parameter"]) -> Float[Array, "run own"]:
        """Each run's own part of the free coordinate."""
        count = len(self.members) * self.width
        return coordinate[self.first : self.first + count].reshape(len(self.members), self.width)

    def own_labels(self) -> list[str]:
        """Names of the coordinates that belong to one run, element by element."""
        return [
            f"{path}[{index}]" if size > 1 else path
            for path, size in self.own
            for index in range(size)
        ]


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


def _run_residual(
    shared_and_own: Float[Array, " own"],
    problem: Problem,
    group: Group,
    inputs: Any,
    observed: Array,
    weight: Array,
) -> tuple[Float[Array, " residual"], tuple[Array, Array]]:
    """Residual of one run; its prediction and whether that succeeded come beside it."""
    count = len(problem.paths)
    inputs = _with_own(inputs, group, shared_and_own[count:])
    model = problem.at(shared_and_own).for_derivatives(problem.free_paths(group))
    predicted, successful = model.predict(inputs, group.channels)
    table = jnp.stack([predicted[name] for name in group.channels], axis=-1)
    # An unmeasured cell must not carry the NaN of a failed simulation times zero.
    difference = jnp.where(weight > 0, (table - observed) * weight, 0)
    return transform(problem.loss, difference.ravel()), (table, successful)


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
        values: Array, group: Group, inputs: Any, observed: Array, weight: Array
    ) -> tuple[Array, ...]:
        row, (table, successful) = _run_residual(values, problem, group, inputs, observed, weight)
        return row, table, successful

    rows, tables, successes = zip(*_over_runs(one, coordinate, problem), strict=True)
    row = jnp.concatenate([part.ravel() for part in rows])
    successful = jnp.all(jnp.concatenate(successes))
    return row, Prediction(tuple(tables), successful)


def linearise(
    coordinate: Float[Array, " parameter"], problem: Problem
) -> tuple[Array, tuple[Array, ...], Array, Array, Prediction]:
    """Residual, Jacobian in blocks, its triangular factor R, Q^T r, and the predictions.

    The block of a run, shape (row, shared + own), comes from one vmapped jvp; no derivative of a
    run by the parameters of another one is ever computed. Each block is reduced to a triangle
    by itself, and the triangles together to R: an orthogonal reduction, as QR of the whole.

    Returns:
        residual of shape (residual,); blocks of each group, shape (run, row, shared + own);
        R of shape (parameter, parameter); Q^T r; predictions.
    """

    def one(
        values: Array, group: Group, inputs: Any, observed: Array, weight: Array
    ) -> tuple[Array, ...]:
        def push(tangent: Array) -> tuple[Array, Array, Any]:
            return jax.jvp(
                lambda v: _run_residual(v, problem, group, inputs, observed, weight),
                (values,),
                (tangent,),
                has_aux=True,
            )

        basis = jnp.eye(values.shape[0], dtype=values.dtype)
        row, block, aux = jax.vmap(push, out_axes=(None, 1, None))(basis)
        whole = jnp.concatenate([block, row[:, None]], axis=1)
        # A failed run has NaN here; its step is rejected, and nobody reads the triangle.
        triangle = jnp.linalg.qr(jnp.where(jnp.isfinite(whole), whole, 0), mode="r")
        missing = whole.shape[1] - triangle.shape[0]
        return row, block, jnp.pad(triangle, ((0, missing), (0, 0))), *aux

    parts = _over_runs(one, coordinate, problem)
    rows, blocks, triangles, tables, successes = zip(*parts, strict=True)
    whole = jnp.concatenate(
        [_placed(t, g, problem) for t, g in zip(triangles, problem.groups, strict=True)]
    )
    if whole.shape[0] > whole.shape[1]:
        whole = jnp.linalg.qr(whole, mode="r")
    row = jnp.concatenate([part.ravel() for part in rows])
    prediction = Prediction(tuple(tables), jnp.all(jnp.concatenate(successes)))
    return row, tuple(blocks), whole[:-1, :-1], whole[:-1, -1], prediction


def _placed(triangles: Float[Array, "run row column"], group: Group, problem: Problem) -> Array:
    """Triangles of a group's runs, with their columns where they belong in the whole."""
    runs, count, _ = triangles.shape
    shared = len(problem.paths)
    whole = jnp.zeros((runs, count, problem.size + 1), triangles.dtype)
    whole = whole.at[:, :, :shared].set(triangles[:, :, :shared])
    whole = whole.at[:, :, -1].set(triangles[:, :, -1])
    if group.width:
        at = np.ix_(np.arange(runs), np.arange(count))
        columns = group.own_columns()[:, None, :]
        whole = whole.at[at[0][..., None], at[1][..., None], columns].set(
            triangles[:, :, shared:-1]
        )
    return whole.reshape(runs * count, -1)


def _over_runs(
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
        )

        def each(row: Any, group: Group = group) -> tuple[Array, ...]:
            values, inputs, observed, weight = row
            return one(values, group, inputs, observed, weight)

        if len(group.members) == 1:
            found = each(jax.tree.map(lambda leaf: leaf[0], rows))
            results.append(tuple(leaf[None] for leaf in found))
        else:
            # One run after the other: each keeps its own steps; the program is compiled once.
            results.append(jax.lax.map(each, rows))
    return results


def build_groups(
    model: AbstractModel, runs: Sequence[Run], sigmas: Sigmas, shared: int
) -> tuple[Group, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them.

    Arguments:
        model: prepares the runs.
        runs: what was recorded.
        sigmas: standard deviations of the channels.
        shared: number of free parameters of the model itself.
    """
    members: dict[Any, list[int]] = {}
    prepared = [model.prepare(run) for run in runs]
    owns = [
        tuple((path, get(inputs, path).size) for path in model.free_inputs(run))
        for run, inputs in zip(runs, prepared, strict=True)
    ]
    for index, run in enumerate(runs):
        structure = jax.tree.structure(prepared[index])
        key = (tuple(run.observations), structure, owns[index])
        members.setdefault(key, []).append(index)
    groups = []
    first = shared
    for (channels, _, own), indices in members.items():
        observed = [np.stack([runs[i].observations[c] for c in channels], -1) for i in indices]
        weight = [
            np.where(np.isnan(cells), 0.0, 1 / np.asarray([sigmas[i][c] for c in channels]))
            for i, cells in zip(indices, observed, strict=True)
        ]
        length = max(len(cells) for cells in observed)
        group = Group(
            inputs=_stack([prepared[i] for i in indices]),
            observed=_padded([np.nan_to_num(cells) for cells in observed], length),
            weight=_padded(weight, length),
            channels=channels,
            members=tuple(indices),
            own=own,
            first=first,
        )
        first += len(indices) * group.width
        groups.append(group)
    return tuple(groups)


def own_start(groups: Sequence[Group]) -> np.ndarray:
    """Where the coordinates of the single runs start: as their runs were prepared."""
    values = [
        np.asarray(get(group.inputs, path)[row], dtype=float).ravel()
        for group in groups
        for row in range(len(group.members))
        for path, _ in group.own
    ]
    return np.concatenate([np.empty(0), *values])


def _padded(arrays: Sequence[np.ndarray], length: int) -> Array:
    rows = [np.pad(a, ((0, length - len(a)), (0, 0))) for a in arrays]
    return jnp.asarray(np.stack(rows), dtype=jnp.result_type(float))


def _stack(trees: Sequence[Any]) -> Any:
    """Stack pytrees, repeating last rows where the first axes differ (see `prepare`)."""

    def stack(*leaves: Array) -> Array:
        length = max(leaf.shape[0] if leaf.ndim else 0 for leaf in leaves)
        return jnp.stack(
            [
                jnp.concatenate([leaf, jnp.repeat(leaf[-1:], length - leaf.shape[0], axis=0)])
                if leaf.ndim and leaf.shape[0] < length
                else leaf
                for leaf in leaves
            ]
        )

    return jax.tree.map(stack, *trees)


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


def stated_sigmas(runs: Sequence[Run]) -> list[Mapping[str, float | None]]:
    """What the sidecars say of each channel's noise, SI; None where they say nothing."""
    return [{name: run.noise(name) for name in run.observations} for run in runs]
