"""Axes of recorded positions, in each of their orders and signs: tried without a fit."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import FitResult, Response, Suspect, predict, resolved_ties, tied
from ..models import AbstractModel
from ..recordings import Channel, Run
from ..schema.parameters import replace
from ._refit import with_fitted_states
from ._score import Projected, models_of_runs, weighted_rest

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


def distinct_axes(runs: Sequence[Run]) -> list[Axes]:
    """The ways that differ in what these runs record; none where they record fewer than two axes.

    The first is the identity.
    """
    channels = [run.channels[name] for run in runs for name in run.observations]
    recorded = sorted({c.component for c in channels if c.component is not None and point_of(c)})
    if len(recorded) < 2:
        return []
    ways = {tuple(way[axis] for axis in recorded): way for way in reversed(all_axes())}
    return sorted(ways.values(), key=lambda way: all_axes().index(way))


def coordinates(model: AbstractModel, run: Run) -> dict[str, np.ndarray]:
    """Predictions (SI) of what a run records, with all three coordinates of each point."""
    points = [point_of(run.channels[name]) for name in run.observations]
    whole = [f"{point}_{axis}" for point in points if point for axis in _AXES]
    return predict(model, run, list(dict.fromkeys([*run.observations, *whole])))


def seen_as(
    way: Axes, run: Run, predicted: Mapping[str, np.ndarray], channels: Sequence[str]
) -> np.ndarray:
    """Predictions of channels if a recording has other axes, shape (sample, channel)."""
    sources = [_source(way, run.channels[name]) or (name, 1) for name in channels]
    return np.stack([sign * predicted[name] for name, sign in sources], axis=-1)


def _source(way: Axes, channel: Channel) -> tuple[str, int] | None:
    """The coordinate of the model that a recorded one is, and its sign; None for no position."""
    if channel.component is None or (point := point_of(channel)) is None:
        return None
    other, sign = way[channel.component]
    return f"{point}_{_AXES[other]}", sign


def turned_back(run: Run, way: Axes) -> Run:
    """The run as it would be with the axes of the model."""
    values, channels = dict(run.values), dict(run.channels)
    moved: dict[str, np.ndarray] = {}
    named: dict[str, Channel] = {}
    for name in run.observations:
        if (source := _source(way, run.channels[name])) is not None:
            new, sign = source
            moved[new] = sign * values.pop(name)
            named[new] = Channel.named(new, channels.pop(name).unit)
    values, observed = {**values, **moved}, run.observed
    if observed is not None:
        observed = tuple(name for name in (*moved, *observed) if name in values)
    return dataclasses.replace(run, values=values, channels=channels | named, observed=observed)


def axes_row(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    chi_square: float,
    rest: Projected,
) -> tuple[list[Suspect], int]:
    """The best of the other orders and signs of the axes, and how many were tried."""
    ways = distinct_axes(runs)
    if not ways:
        return [], 0
    points = [models_of_runs(result)]
    if result.history:
        first = replace(result.model, result.history[0].parameters)
        ties = resolved_ties(first, result.config.get("ties", {}))
        points.append([tied(first, ties)] * len(runs))
    begun = with_fitted_states(result, runs)
    best: tuple[float, Axes, bool] | None = None
    for number, models in enumerate(points):
        whole = [coordinates(model, run) for model, run in zip(models, begun, strict=True)]
        for way in ways:
            seen = [
                seen_as(way, run, predicted, response.channels)
                for run, predicted, response in zip(runs, whole, at, strict=True)
            ]
            other = chi_square_of(at, seen, factors)
            if way != IDENTITY and (best is None or other < best[0]) and np.isfinite(other):
                best = other, way, number > 0
    if best is None:
        return [], len(ways)
    other, way, at_start = best
    drop = max(chi_square - other, 0.0)
    # Of two models without anything free, a likelihood ratio of 1/c has a probability below c.
    scale = max(1.0, other / max(rest.values - rest.parameters, 1))
    row = Suspect(
        path=name_of(way),
        kind="axes",
        unit="",
        value=None,
        estimate=None,
        estimate_error=None,
        chi_square_drop=drop,
        degrees_of_freedom=1,
        p_value=float(min(1.0, np.exp(-drop / scale / 2))),
        testable=True,
        note="with the values that the fit began with" if at_start and drop else "",
    )
    return [row], len(ways)


def chi_square_of(
    at: Sequence[Response], predicted: Sequence[np.ndarray], factors: Sequence[np.ndarray]
) -> float:
    """Sum of weighted squares of predictions less what was observed."""
    rests = map(weighted_rest, at, predicted, factors)
    return sum((float(np.sum(rest**2)) for rest in rests), 0.0)
