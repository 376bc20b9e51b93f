"""Runs as arrays: those with the same channels stacked, so that they share a program."""

from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import get
from ..runs import Run
from ._stack import stacked as _stack


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


def build_groups(
    model: AbstractModel, runs: Sequence[Run], sigmas: Sequence[Mapping[str, float]], shared: int
) -> tuple[Group, ...]:
    """Prepare runs and stack those with the same channels, padded to the longest of them.

    Arguments:
        model: prepares the runs.
        runs: what was recorded.
        sigmas: standard deviations of the channels.
        shared: number of free parameters of the model itself.

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
