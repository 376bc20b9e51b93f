"""Tests for recorded columns and points that were confused or lost, without a fit."""

import functools
import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import (
    FitResult,
    PredictedRun,
    Response,
    Suspect,
    SuspectKind,
    predict,
    resolved_ties,
    tied,
)
from ..models import AbstractModel
from ..recordings import Channel, Mistake, Run, mistakes
from ..runtime.text import InputError
from ..schema import LINKS
from ..schema.parameters import declared, replace
from ._refit import with_fitted_states
from ._score import Projected, models_of_runs, neighbours, weighted_rest

_AXES = "xyz"
# Maximum number of mistakes of commands that are tested.
_SIMULATED = 60

# Required ratio of chi-square. Mistakes that only compensated for missing physics reduced
# chi-square by up to a half.
_FAR_LESS = 4.0


def mistaken_rows(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    chi_square: float,
    rest: Projected,
) -> tuple[list[Suspect], int]:
    """Return the best test of other axes and of other columns, and the number of tests.

    Another name or unit of a column must reduce chi-square by a large factor, with the same values
    of the parameters, because a wrong name may reduce it slightly if the model omits an effect.
    Small mistakes are therefore not reported. Mistakes of commands are tested with the initial
    values of the fit only: a fit to wrong commands has distorted its model to match them, and each
    test requires a simulation.
    """
    asked = mistakes_of(result.model, runs)
    points = [models_of_runs(result)]
    if result.history:
        first = replace(result.model, result.history[0].parameters)
        ties = resolved_ties(first, result.config.get("ties", {}))
        points.append([tied(first, ties)] * len(runs))
    starting = with_fitted_states(result, runs)
    channels = [_asked_of(run, asked) for run in runs]
    simulated = _simulated(asked)
    best: dict[SuspectKind, tuple[float, str, bool]] = {}
    for number, models in enumerate(points if asked else []):
        # All predictions have the same channels, so only one program is compiled.
        predicted = functools.partial(_predicted, models, channels=channels)
        as_they_are = predicted(starting)
        columns = [
            np.stack([of_run[name] for name in response.channels], axis=-1)
            for of_run, response in zip(as_they_are, at, strict=True)
        ]
        most = chi_square_of(at, columns, factors) / _FAR_LESS
        last = number == len(points) - 1
        for mistake in asked:
            whole = as_they_are
            if mistake.kind == "commands":
                if not last or mistake.name not in simulated:
                    continue
                try:
                    whole = predicted([mistake.undone(run) for run in starting])
                except InputError:  # No arm can follow these commands, so this is not the mistake.
                    continue
            seen = [
                _seen_with(mistake, of_run, response.channels)
                for of_run, response in zip(whole, at, strict=True)
            ]
            other = chi_square_of(at, seen, factors)
            kind: SuspectKind = "axes" if mistake.kind == "axes" else "columns"
            if kind == "columns" and other > most:
                continue
            if np.isfinite(other) and other < best.get(kind, (np.inf,))[0]:
                best[kind] = other, mistake.name, number > 0
    rows = []
    for kind, (other, name, begun) in best.items():
        drop = chi_square - other
        if drop <= 0:
            continue
        # For two models without free parameters, a likelihood ratio of 1/c has a probability below
        # c.
        scale = max(1.0, other / max(rest.values - rest.parameters, 1))
        p_value = float(min(1.0, np.exp(-drop / scale / 2)))
        rows.append(_row_of(name, kind, drop, p_value, begun=begun))
    commands = sum(each.kind == "commands" for each in asked)
    return rows, len(asked) - commands + len(simulated)


def mistakes_of(model: AbstractModel, runs: Sequence[Run]) -> list[Mistake]:
    """Return the possible mistakes of columns for an arm with the number of links of the model."""
    lengths = declared(model).get(LINKS.length.path)
    return mistakes(runs, None if lengths is None else int(np.size(lengths.value(model))))


def _asked_of(run: Run, asked: Sequence[Mistake]) -> list[str]:
    """Return the channels of a run, and those it would have without one of the mistakes."""
    there = set(run.observations)
    sources = [each.sources.items() for each in asked if each.kind != "commands"]
    return sorted(there | {of for some in sources for name, (of, _) in some if name in there})


def _simulated(asked: Sequence[Mistake]) -> set[str]:
    """Return the names of the mistakes of commands to be simulated, for the nearest joints."""

    def distance(mistake: Mistake) -> int:
        names = ((name, of) for name, (of, _) in mistake.sources.items())
        joints = ([Channel.named(each).index or 0 for each in both] for both in names)
        return max(abs(one - other) for one, other in joints)

    commands = [each for each in asked if each.kind == "commands"]
    return {each.name for each in sorted(commands, key=distance)[:_SIMULATED]}


def _predicted(
    models: Sequence[AbstractModel], runs: Sequence[Run], channels: Sequence[Sequence[str]]
) -> list[PredictedRun]:
    return [predict(*of_run) for of_run in zip(models, runs, channels, strict=True)]


def _seen_with(
    mistake: Mistake, predicted: Mapping[str, np.ndarray], channels: Sequence[str]
) -> np.ndarray:
    """Return predictions as if recorded with a mistake, shape (sample, channel)."""
    of = [mistake.sources.get(name, (name, 1.0)) for name in channels]
    return np.stack([times * predicted[name] for name, times in of], axis=-1)


def _row_of(
    path: str,
    kind: SuspectKind,
    drop: float,
    p_value: float,
    note: str = "",
    *,
    begun: bool = False,
) -> Suspect:
    """Return the row of a hypothesis that is true or false and has no value to estimate."""
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
        begun=begun,
    )


# Factor on the variance of the noise. A point that stands still has no larger variance.
_STILL = 2.0
# Minimum jump in chi-square of two points between the rows at which they are exchanged.
_JUMP = 20.0
# Fraction of the squared jump. After the exchange, the points must be this near to the expected
# positions.
_NEARER = 0.25
# Fraction of the decrease for the best rows. Points that are always exchanged reach it with all
# rows.
_ALWAYS = 0.9

Cells = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Recorded and predicted coordinates of a point in the rows of all runs, and their weights."""

Way = tuple[float, int, int]
"""Decrease of chi-square, first row of a sequence of rows, and the row after its last one."""


def points_row(
    runs: Sequence[Run],
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    chi_square: float,
    rest: Projected,
) -> list[Suspect]:
    """Return the best hypothesis of exchanged, confused or lost points in consecutive rows.

    Two points are exchanged, one point shows another, or a point does not move until the end of its
    run. The predictions at the end of the fit are used. Because a wrong model may have points in
    the wrong order, or may move a point that has come to rest, the recording itself must also
    support the hypothesis: points that are exchanged within a run must jump, two points must be at
    the same place if one shows the other, and another point must move while a lost point does not.
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
    # Hypotheses about whole runs must reduce chi-square as much as other names of columns, because
    # a wrong model also has points in the wrong order.
    ways = {
        name: (drop, first, end)
        for name, (drop, first, end) in ways.items()
        if end - first < _ALWAYS * starts[-1] or chi_square - drop < chi_square / _FAR_LESS
    }
    if not ways:
        return []
    name, (drop, first, end) = max(ways.items(), key=lambda way: way[1][0])
    # The likelihood ratio is computed as for axes, and corrected for the number of possible
    # sequences of rows.
    scale = max(1.0, (chi_square - drop) / max(rest.values - rest.parameters, 1))
    # Residuals of a distorted fit are both larger and correlated. The larger of the two factors is
    # used.
    scale = max(scale, _times_white(at, factors, list(cells), first, end))
    likelihood = np.log(len(ways)) + 2 * np.log(starts[-1]) - drop / scale / 2
    if likelihood > 0:  # The decrease may be due to chance.
        return []
    places = [_moment(runs, starts, row) for row in (first, max(end - 1, first))]
    note = f"from {places[0]} to {places[1]}"
    return [_row_of(name, "points", drop, float(np.exp(likelihood)), note)]


# Minimum number of rows from which the correlation of a channel is estimated.
_FEWEST_ROWS = 16


def _times_white(
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    points: Sequence[str],
    first: int,
    end: int,
) -> float:
    """Return the factor by which correlation increases the decrease of chi-square by chance.

    It is relative to white noise. The median correlation of neighbouring samples of the points
    outside the rows from `first` to `end` is used, or of all rows if too few remain outside.
    """
    found, row = [], 0
    for response, factor in zip(at, factors, strict=True):
        rows = np.arange(row, row + len(factor))
        row += len(factor)
        outside = ((rows < first) | (rows >= end))[:, None] & (factor > 0)
        residuals = weighted_rest(response, response.predicted, factor)
        columns = zip(response.channels, residuals.T, outside.T, strict=True)
        for name, rest, kept in columns:
            if name.rpartition("_")[0] in points and np.count_nonzero(kept) >= _FEWEST_ROWS:
                found.append(neighbours(np.where(kept, rest, 0.0), kept))
    if not found and end > first:
        return _times_white(at, factors, points, 0, 0)
    rho = float(np.median(found)) if found else 0.0
    return (1 + rho) / (1 - rho)


def _cells_of_points(
    runs: Sequence[Run], at: Sequence[Response], factors: Sequence[np.ndarray]
) -> dict[str, Cells]:
    """Return the recorded and predicted coordinates of each recorded point, with their weights."""
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
    """Return the decrease if two points are exchanged, and if either shows the other.

    The result is empty for points with different coordinates.
    """
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

    def edges(first: int, end: int) -> list[np.ndarray]:
        """Return the rows before and after each end of a sequence that lies within a run."""
        inner = [row for row in (first, end) if 0 < row < len(rows) and run[row - 1] == run[row]]
        return [rows[row - 1 : row + 1] for row in inner]

    first, end = _best_stretch(total)
    if not all(_cross(pair, two) for two in edges(first, end)):
        # Otherwise the points may be exchanged in all rows.
        always = np.sum(total) > _ALWAYS * np.sum(total[first:end])
        first, end = 0, len(rows) * bool(always)
    found = [(f"{names[0]} and {names[1]} exchanged", total, first, end)]
    for name, gain in zip((names, (names[1], names[0])), gains, strict=True):
        first, end = _best_stretch(gain)
        count = np.sum(both[rows][first:end] > 0)
        shown = pair if name == names else pair[::-1]
        if np.sum(apart[first:end] ** 2) < 2 * _STILL * count and all(
            _stays(shown, two) for two in edges(first, end)
        ):
            found.append((f"{name[0]} shows {name[1]}", gain, first, end))
    return {
        f"points: {name}": (
            float(np.sum(gain[first:end])),
            int(rows[first]),
            int(rows[end - 1]) + 1,
        )
        for name, gain, first, end in found
    }


def _cross(pair: tuple[Cells, Cells], rows: np.ndarray) -> bool:
    """Return whether each of two points continues where the other was, in the next row.

    If a cell was lost, one point also jumps, but not to the position of the other.
    """
    one, other = pair
    stays = _jump(one, one, rows) + _jump(other, other, rows)
    crosses = _jump(one, other, rows) + _jump(other, one, rows)
    return stays - crosses >= _JUMP and crosses < _NEARER * stays


def _stays(pair: tuple[Cells, Cells], rows: np.ndarray) -> bool:
    """Return whether the second point moves on steadily where the first jumps to or from it."""
    return _jump(pair[1], pair[1], rows) < _NEARER * _jump(pair[0], pair[0], rows)


def _jump(to: Cells, since: Cells, rows: np.ndarray) -> float:
    """Return the weighted squared distance of one point from the expected position of another.

    Both are evaluated in the second row. The expected position is the position of the other point
    (`since`) in the first row plus its predicted motion.
    """
    moved = np.nan_to_num(since[1][rows[1]] - since[1][rows[0]])
    weight = np.minimum(to[2][rows[1]], since[2][rows[0]])
    return float(np.sum((weight * (to[0][rows[1]] - since[0][rows[0]] - moved)) ** 2))


def _lost(cells: Mapping[str, Cells], first: int, end: int) -> dict[str, Way]:
    """Return the hypotheses of points that stand still until the end while another point moves."""
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
        ways[f"points: {name} does not move"] = (
            float(np.max(gain)),
            first + int(np.argmax(gain)),
            end,
        )
    return ways


def _best_stretch(gain: np.ndarray) -> tuple[int, int]:
    """Return the rows in sequence with the largest sum: the first, and the row after the last."""
    total = np.concatenate([[0.0], np.cumsum(gain)])
    end = int(np.argmax(total - np.minimum.accumulate(total)))
    first = int(np.argmin(total[: end + 1]))
    return first, end


def _scatter_from(values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the weighted squares about the mean, from each row to the last, shape (row,)."""
    powers = np.stack([weights, weights * values, weights * values**2])
    count, sums, squares = np.cumsum(powers[:, ::-1], axis=1)[:, ::-1]
    return np.asarray(np.sum(squares - sums**2 / np.where(count > 0, count, 1.0), axis=1))


def _moment(runs: Sequence[Run], starts: np.ndarray, row: int) -> str:
    """Return the time of a row in the concatenated rows of all runs."""
    place = int(np.searchsorted(starts, row, side="right")) - 1
    run = runs[place]
    assert run.times is not None
    return f"{run.times[row - starts[place]]:.4g} s" + f" of '{run.name}'" * (len(runs) > 1)


def chi_square_of(
    at: Sequence[Response], predicted: Sequence[np.ndarray], factors: Sequence[np.ndarray]
) -> float:
    """Return the weighted sum of squared differences between predictions and observations."""
    rests = map(weighted_rest, at, predicted, factors)
    return sum((float(np.sum(rest**2)) for rest in rests), 0.0)
