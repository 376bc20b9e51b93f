"""Axes and points of recorded positions, taken for others or lost: tried without a fit."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import FitResult, Response, Suspect, SuspectKind, predict, resolved_ties, tied
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
    p_value = float(min(1.0, np.exp(-drop / scale / 2)))
    note = "with the values that the fit began with" if at_start and drop else ""
    return [_row_of(name_of(way), "axes", drop, p_value, note)], len(ways)


def _row_of(path: str, kind: SuspectKind, drop: float, p_value: float, note: str) -> Suspect:
    """A row of something that is so or not, with nothing to estimate."""
    return Suspect(
        path=path,
        kind=kind,
        unit="",
        value=None,
        estimate=None,
        estimate_error=None,
        chi_square_drop=drop,
        degrees_of_freedom=1,
        p_value=p_value,
        testable=True,
        note=note,
    )


_STILL = 2.0  # times the variance of the noise: what stands still has no more
_JUMP = 20.0  # of chi-square, that two points jump by where they are exchanged from one row on
_ALWAYS = 0.9  # of what the best rows take: points that are exchanged in all of them take as much

Cells = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Of a point in the rows of all runs: coordinates recorded, predicted, and their factors."""

Way = tuple[float, int, int]
"""What something takes from chi-square, the first of its rows, and the one after the last."""


def points_row(
    runs: Sequence[Run],
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    chi_square: float,
    rest: Projected,
) -> list[Suspect]:
    """The best of recorded points that some rows in turn have exchanged, lost or taken for others.

    Two are exchanged, one shows another, or stands still until the end of its run. The predictions
    are those where the fit ended; and as a wrong model may have points in the wrong order, or move
    what has come to rest, the recording by itself has to agree: it jumps where points are exchanged
    within a run, has two at one place where one shows the other, and moves another one while one
    stands still.
    """
    if any(run.times is None for run in runs):
        return []
    cells = _cells_of_points(runs, at, factors)
    starts = np.cumsum([0, *(len(response.predicted) for response in at)])
    ways: dict[str, Way] = {}
    for one, other in itertools.combinations(sorted(cells), 2):
        ways |= _taken_for((one, other), (cells[one], cells[other]), starts)
    for first, end in itertools.pairwise(starts):
        for name, found in _lost(cells, int(first), int(end)).items():
            ways[name] = max(ways.get(name, found), found)
    if not ways:
        return []
    name, (drop, first, end) = max(ways.items(), key=lambda way: way[1][0])
    # As of axes, for each of the stretches that it might have been.
    scale = max(1.0, (chi_square - drop) / max(rest.values - rest.parameters, 1))
    likelihood = np.log(len(ways)) + 2 * np.log(starts[-1]) - drop / scale / 2
    if likelihood > 0:  # As much by chance.
        return []
    places = [_moment(runs, starts, row) for row in (first, max(end - 1, first))]
    note = f"from {places[0]} to {places[1]}"
    return [_row_of(name, "points", drop, float(np.exp(likelihood)), note)]


def _cells_of_points(
    runs: Sequence[Run], at: Sequence[Response], factors: Sequence[np.ndarray]
) -> dict[str, Cells]:
    """Of each recorded point, in all rows: coordinates observed, predicted, and their factors."""
    found: dict[str, Cells] = {}
    starts = np.cumsum([0, *(len(response.predicted) for response in at)])
    for run, response, factor, first in zip(runs, at, factors, starts, strict=False):
        rows = slice(first, first + len(factor))
        for column, name in enumerate(response.channels):
            channel = run.channels[name]
            if channel.component is None or channel.quantity not in ("length", "pixel"):
                continue
            blank = np.zeros((3, starts[-1], len(_AXES)))
            blank[1] = np.nan
            point = found.setdefault(name.rpartition("_")[0], (blank[0], blank[1], blank[2]))
            values = (response.observed, response.predicted, factor)
            for table, all_columns in zip(point, values, strict=True):
                table[rows, channel.component] = np.nan_to_num(all_columns[:, column])
    return found


def _taken_for(
    names: tuple[str, str], pair: tuple[Cells, Cells], starts: np.ndarray
) -> dict[str, Way]:
    """Two points exchanged, and each in the place of the other; nothing of other coordinates."""
    factors = [factor for _, _, factor in pair]
    if not np.array_equal(*(np.any(factor > 0, axis=0) for factor in factors)):
        return {}
    both = np.sqrt(factors[0] * factors[1])
    rows = np.flatnonzero(np.any(both > 0, axis=1))
    if not len(rows):
        return {}
    apart = (both * (pair[0][0] - pair[1][0]))[rows]
    gains = []
    for (observed, predicted, factor), (_, instead, _) in (pair, (pair[1], pair[0])):
        off = [(factor * (each - observed)) ** 2 for each in (predicted, instead)]
        gains.append(np.sum(np.where(both > 0, off[0] - off[1], 0.0), axis=1)[rows])
    run = np.searchsorted(starts, rows, side="right")
    total = gains[0] + gains[1]
    first, end = _best_stretch(total)
    inner = [row for row in (first, end) if 0 < row < len(rows) and run[row - 1] == run[row]]
    if any(-2 * apart[row - 1] @ apart[row] < _JUMP for row in inner):
        # Or they are exchanged from the first row on, and nowhere the other way.
        always = np.sum(total) > _ALWAYS * np.sum(total[first:end])
        first, end = 0, len(rows) * bool(always)
    found = [(f"{names[0]} and {names[1]} exchanged", total, first, end)]
    for name, gain in zip((names, (names[1], names[0])), gains, strict=True):
        first, end = _best_stretch(gain)
        count = np.sum(both[rows][first:end] > 0)
        if np.sum(apart[first:end] ** 2) < 2 * _STILL * count:
            found.append((f"{name[0]} shows {name[1]}", gain, first, end))
    return {
        f"points: {name}": (
            float(np.sum(gain[first:end])),
            int(rows[first]),
            int(rows[end - 1]) + 1,
        )
        for name, gain, first, end in found
    }


def _lost(cells: Mapping[str, Cells], first: int, end: int) -> dict[str, Way]:
    """Points that stand still until the end of a run while another one moves."""
    gains, moves = {}, {}
    for name, (observed, predicted, factor) in cells.items():
        weights = factor[first:end] ** 2
        left = np.cumsum(np.sum(weights > 0, axis=1)[::-1])[::-1]
        rest = np.nan_to_num(predicted - observed)[first:end]
        scatter = _scatter_from(observed[first:end], weights)
        gains[name] = _scatter_from(rest, weights) - scatter
        moves[name] = scatter / np.maximum(left, 1) / _STILL
    most = np.max(list(moves.values()), axis=0, initial=0.0)
    ways = {}
    for name, gain in gains.items():
        gain = np.where((moves[name] < 1) & (most > _STILL), gain, 0.0)
        ways[f"points: {name} stands still"] = (
            float(np.max(gain)),
            first + int(np.argmax(gain)),
            end,
        )
    return ways


def _best_stretch(gain: np.ndarray) -> tuple[int, int]:
    """The first of the neighbouring rows with the largest sum, and the one after the last."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    end = int(np.argmax(total - np.minimum.accumulate(total)))
    first = int(np.argmin(total[: end + 1]))
    return first, end


def _scatter_from(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Weighted squares of values about their mean from each row on, shape (row,)."""
    powers = np.stack([weights, weights * values, weights * values**2])
    count, sums, squares = np.cumsum(powers[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.sum(squares - sums**2 / np.where(count > 0, count, 1.0), axis=1))


def _moment(runs: Sequence[Run], starts: np.ndarray, row: int) -> str:
    """The time of one of the rows of all runs."""
    place = int(np.searchsorted(starts, row, side="right")) - 1
    run = runs[place]
    assert run.times is not None
    return f"{run.times[row - starts[place]]:.4g} s" + f" of '{run.name}'" * (len(runs) > 1)


def chi_square_of(
    at: Sequence[Response], predicted: Sequence[np.ndarray], factors: Sequence[np.ndarray]
) -> float:
    """Sum of weighted squares of predictions less what was observed."""
    rests = map(weighted_rest, at, predicted, factors)
    return sum((float(np.sum(rest**2)) for rest in rests), 0.0)
