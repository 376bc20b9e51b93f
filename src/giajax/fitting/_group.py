"""Runs as arrays: those with the same channels stacked, so that they share a program."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from .._typing import Array, Float
from ..models import AbstractModel
from ..parameters import get
from ..runs import Run
from ._layout import Layout
from ._noise import Noise
from ._recorded import Recorded, recorded_cells
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
    recorded = [run.observations for run in runs]
    for (channels, _, own), indices in members.items():
        observed, weight, whitening = recorded_cells(runs, noise, indices, channels, recorded)
        group = Group(
            inputs=stacked([prepared[i] for i in indices]),
            observed=observed,
            weight=weight,
            whitening=whitening,
            channels=channels,
            members=tuple(indices),
            own=own,
            first=first,
            shared=tuple(layout.of_runs[i] for i in indices),
        )
        first += len(indices) * group.width
        groups.append(group)
    return tuple(groups)


def recorded_otherwise(
    groups: Sequence[Group], runs: Sequence[Run], noise: Noise, recorded: Recorded
) -> tuple[Group, ...]:
    """Groups whose runs recorded something else; what was prepared of the runs stays.

    Arguments:
        groups: of the runs.
        runs: what is fitted to.
        noise: of the channels.
        recorded: of each run, values by channel, SI; NaN where a cell does not count.
    """
    others = []
    for group in groups:
        cells = recorded_cells(runs, noise, group.members, group.channels, recorded)
        observed, weight, whitening = cells
        others.append(
            dataclasses.replace(group, observed=observed, weight=weight, whitening=whitening)
        )
    return tuple(others)


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
