"""Whether a recording has its axes in another order, or turned round: all 48 ways, directly."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import predict
from ..models import AbstractModel
from ..runs import Channel, Run

_AXES = "xyz"

Axes = tuple[tuple[int, int], ...]
"""Of recorded x, y and z: the axis of the model that it is, and its sign."""

IDENTITY: Axes = ((0, 1), (1, 1), (2, 1))


def all_axes() -> list[Axes]:
    """The 48 signed permutations, the identity first."""
    ways = [
        tuple(zip(order, signs, strict=True))
        for order in itertools.permutations(range(3))
        for signs in itertools.product((1, -1), repeat=3)
    ]
    return sorted(ways, key=lambda way: way != IDENTITY)


def name_of(way: Axes) -> str:
    """What a person calls it: `axes: y and z swapped`."""
    moved = [axis for axis in range(3) if way[axis][0] != axis]
    turned = [_AXES[axis] for axis in range(3) if way[axis][1] < 0]
    if len(moved) == 2 and not turned:
        return f"axes: {_AXES[moved[0]]} and {_AXES[moved[1]]} swapped"
    if not moved:
        return f"axes: {' and '.join(turned)} reversed"
    shown = [
        f"{_AXES[axis]} is {'-' * (sign < 0)}{_AXES[other]}"
        for axis, (other, sign) in enumerate(way)
        if (other, sign) != (axis, 1)
    ]
    return f"axes: recorded {', '.join(shown)}"


def point_of(channel: Channel) -> str | None:
    """The recorded point that a channel is a coordinate of: `link06`; None for no position."""
    if channel.component is None or channel.quantity != "length":
        return None
    return channel.name.removesuffix(f"_{_AXES[channel.component]}")


def axes_of(run: Run) -> set[int]:
    """The axes along which a run records points."""
    recorded = (run.channels[name] for name in run.observations)
    return {c.component for c in recorded if c.component is not None and point_of(c) is not None}


def distinct_axes(runs: Sequence[Run]) -> list[Axes]:
    """The ways that differ in what these runs record; none where they record fewer than two axes.

    The first is the identity.
    """
    recorded = sorted(set().union(*(axes_of(run) for run in runs)))
    if len(recorded) < 2:
        return []
    ways = {tuple(way[axis] for axis in recorded): way for way in reversed(all_axes())}
    return sorted(ways.values(), key=lambda way: all_axes().index(way))


def coordinates(model: AbstractModel, run: Run) -> dict[str, np.ndarray]:
    """Predictions (SI) of what a run records, with all three coordinates of each point."""
    names = list(run.observations)
    points = {point_of(run.channels[name]): None for name in names}
    whole = [f"{point}_{axis}" for point in points if point for axis in _AXES]
    return predict(model, run, list(dict.fromkeys([*names, *whole])))


def seen_as(
    way: Axes, run: Run, predicted: Mapping[str, np.ndarray], channels: Sequence[str]
) -> np.ndarray:
    """Predictions of channels if a recording has other axes, shape (sample, channel)."""
    columns = []
    for name in channels:
        channel = run.channels[name]
        point = point_of(channel)
        if point is None or channel.component is None:
            columns.append(predicted[name])
            continue
        other, sign = way[channel.component]
        columns.append(sign * predicted[f"{point}_{_AXES[other]}"])
    return np.stack(columns, axis=-1)


def turned_back(run: Run, way: Axes) -> Run:
    """The run as it would be with the axes of the model.

    Arguments:
        run: with recorded points.
        way: how its axes are those of the model.
    """
    values, channels = dict(run.values), dict(run.channels)
    moved: dict[str, tuple[np.ndarray, Channel]] = {}
    for name in run.observations:
        channel = run.channels[name]
        point = point_of(channel)
        if point is None or channel.component is None:
            continue
        other, sign = way[channel.component]
        new = f"{point}_{_AXES[other]}"
        moved[new] = sign * values.pop(name), Channel.named(new, channel.unit)
        del channels[name]
    observed = (
        None
        if run.observed is None
        else tuple(name for name in (*moved, *run.observed) if name in moved or name in values)
    )
    return dataclasses.replace(
        run,
        values={**values, **{name: value for name, (value, _) in moved.items()}},
        channels={**channels, **{name: channel for name, (_, channel) in moved.items()}},
        observed=observed,
    )
