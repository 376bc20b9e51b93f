"""Runs as arrays: those with the same channels stacked, so that they share a program."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import get
from ..runs import Run
from ._layout import Layout
from ._noise import Noise
from ._stack import stacked
from ._whitening import Whitening


class Group(eqx.Module):
    """Runs with the same channels, stacked along a first axis so that they share a program.

    Attributes:
        inputs: what the model prepared, each leaf with a leading run axis.
        observed: recorded values, 0 where not measured.
        weight: 1 / standard deviation, 0 where not measured.
        whitening: of correlated noise; None where there can be none.
        channels: names, in the order of the third axis of `observed`.
        members: positions of the runs in the list that was fitted.
        own: paths and sizes of the prepared inputs' parameters that are free in each run.
        first: position of the first of them in the free coordinate.
        shared: by run, the position of its value of each of the model's free parameters.
    """

    inputs: Any
    observed: Float[Array, "run sample channel"]
    weight: Float[Array, "run sample channel"]
    whitening: Whitening | None
    channels: tuple[str, ...] = eqx.field(static=True)
    members: tuple[int, ...] = eqx.field(static=True)
    own: tuple[tuple[str, int], ...] = eqx.field(static=True)
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
        return [
            f"{path}[{index}]" if size > 1 else path
            for path, size in self.own
            for index in range(size)
        ]


def build_groups(
    model: AbstractModel, runs: Sequence[Run], noise: Noise, layout: Layout
) -> tuple[Group, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them.

    Arguments:
        model: prepares the runs.
        runs: what was recorded.
        noise: of the channels.
        layout: of the free parameters of the model itself.

    Returns:
        The groups, in the order of their first runs.
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
    first = layout.size
    for (channels, _, own), indices in members.items():
        observed = [np.stack([runs[i].observations[c] for c in channels], -1) for i in indices]
        weight = [
            np.where(np.isnan(cells), 0.0, 1 / np.asarray(_deviations(noise, i, channels)))
            * _root_weights(noise, runs[i], i, channels)
            for i, cells in zip(indices, observed, strict=True)
        ]
        length = max(len(cells) for cells in observed)
        group = Group(
            inputs=stacked([prepared[i] for i in indices]),
            observed=_padded([np.nan_to_num(cells) for cells in observed], length),
            weight=_padded(weight, length),
            whitening=_whitening(runs, noise, indices, channels, length),
            channels=channels,
            members=tuple(indices),
            own=own,
            first=first,
            shared=tuple(layout.of_runs[i] for i in indices),
        )
        first += len(indices) * group.width
        groups.append(group)
    return tuple(groups)


def _deviations(noise: Noise, index: int, channels: Sequence[str]) -> list[float]:
    return [noise.values[index][channel].deviation for channel in channels]


def _root_weights(noise: Noise, run: Run, index: int, channels: Sequence[str]) -> np.ndarray:
    """Roots of the cells' weights, where no whitening has them: in a run without time."""
    if noise.weights is None or run.times is not None:
        return np.ones(())
    return np.sqrt(np.stack([noise.weights[index][name] for name in channels], axis=-1))


def _whitening(
    runs: Sequence[Run], noise: Noise, indices: Sequence[int], channels: Sequence[str], length: int
) -> Whitening | None:
    """That of the runs of a group, stacked; None where noise has no memory for sure."""
    if not noise.memory:
        return None
    parts = []
    for i in indices:
        times = runs[i].times
        if times is None:
            return None
        measured = {
            name: np.where(np.isnan(values), 0.0, 1.0)
            for name, values in runs[i].observations.items()
        }
        weights = {
            name: cells if noise.weights is None else cells * noise.weights[i][name]
            for name, cells in measured.items()
        }
        of_run = {name: noise.values[i][name] for name in channels}
        parts.append(Whitening.of(of_run, times, weights, length))
    dtype = jnp.result_type(float)
    return jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves), dtype=dtype), *parts)


def own_start(groups: Sequence[Group]) -> np.ndarray:
    """Where the coordinates of the single runs start: as their runs were prepared."""
    values = [
        np.asarray(get(group.inputs, path)[row], dtype=float).ravel()
        for group in groups
        for row in range(len(group.members))
        for path, _ in group.own
    ]
    return np.concatenate([np.empty(0), *values])


def own_begun(
    groups: Sequence[Group], runs: Sequence[Run], begun: Mapping[str, Mapping[str, float]]
) -> np.ndarray:
    """As `own_start`, apart from those that begin elsewhere.

    Arguments:
        groups: of the runs.
        runs: what is fitted to.
        begun: their values, by the run's name and the name of the coordinate.
    """
    own = own_start(groups)
    shared = groups[0].first
    for group in groups:
        for member, columns in zip(group.members, group.own_columns(), strict=True):
            values = begun.get(runs[member].name, {})
            for label, column in zip(group.own_labels(), columns.tolist(), strict=True):
                own[column - shared] = values.get(label, own[column - shared])
    return own


def _padded(arrays: Sequence[np.ndarray], length: int) -> Array:
    rows = [np.pad(a, ((0, length - len(a)), (0, 0))) for a in arrays]
    return on_device(np.stack(rows), jnp.result_type(float))
