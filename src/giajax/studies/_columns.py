"""Columns and points that are taken for others, or lost: tried without a fit."""

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
_SIMULATED = 60  # mistakes of commands that are tried at most

_FAR_LESS = 4.0  # times; what missing physics looked like took up to half of chi-square


def mistaken_rows(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    chi_square: float,
    rest: Projected,
) -> tuple[list[Suspect], int]:
    """The best of other axes, and of other names and units of columns; and how many were tried.

    Another name or unit has to leave far less than the columns as they are, with the same values:
    where physics is missing, a wrong one may leave less, too. Small mistakes are not named for it.
    Commands are tried with the initial values of the fit: a fit to wrong ones has bent its
    model to them, and each takes a simulation.
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
        # The same channels each time: one program.
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
                except InputError:  # No arm can follow them, which is no mistake then.
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
        # Of two models without anything free, a likelihood ratio of 1/c has a probability below c.
        scale = max(1.0, other / max(rest.values - rest.parameters, 1))
        p_value = float(min(1.0, np.exp(-drop / scale / 2)))
        rows.append(_row_of(name, kind, drop, p_value, begun=begun))
    commands = sum(each.kind == "commands" for each in asked)
    return rows, len(asked) - commands + len(simulated)


def mistakes_of(model: AbstractModel, runs: Sequence[Run]) -> list[Mistake]:
    """The mistakes of columns, of an arm with as many links as the model has."""
    lengths = declared(model).get(LINKS.length.path)
    return mistakes(runs, None if lengths is None else int(np.size(lengths.value(model))))


def _asked_of(run: Run, asked: Sequence[Mistake]) -> list[str]:
    """The channels of a run, and those that it would have without one of the mistakes."""
    there = set(run.observations)
    sources = [each.sources.items() for each in asked if each.kind != "commands"]
    return sorted(there | {of for some in sources for name, (of, _) in some if name in there})


def _simulated(asked: Sequence[Mistake]) -> set[str]:
    """Names of mistakes of commands, each of which takes a simulation: those of nearest joints."""

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
    """Predictions of channels as a recording with a mistake has them, shape (sample, channel)."""
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
        begun=begun,
    )


_STILL = 2.0  # times the variance of the noise: what does not move has no more
_JUMP = 20.0  # of chi-square, that two points jump by where they are exchanged from one row on
_NEARER = 0.25  # of the squares by which they jump: so near they are to where they would be
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

    Two are exchanged, one shows another, or does not move until the end of its run. The predictions
    are those where the fit ended; and as a wrong model may have points in the wrong order, or move
    what has come to rest, the recording by itself has to agree: it jumps where points are exchanged
    within a run, has two at one place where one shows the other, and moves another one while one
    does not move.
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
    # Of whole runs as of other names of columns: a wrong model has points in a wrong order, too.
    ways = {
        name: (drop, first, end)
        for name, (drop, first, end) in ways.items()
        if end - first < _ALWAYS * starts[-1] or chi_square - drop < chi_square / _FAR_LESS
    }
    if not ways:
        return []
    name, (drop, first, end) = max(ways.items(), key=lambda way: way[1][0])
    # As of axes, for each of the stretches that it might have been.
    scale = max(1.0, (chi_square - drop) / max(rest.values - rest.parameters, 1))
    # What a fit has bent to is both larger and correlated: the larger of the two counts.
    scale = max(scale, _times_white(at, factors, list(cells), first, end))
    likelihood = np.log(len(ways)) + 2 * np.log(starts[-1]) - drop / scale / 2
    if likelihood > 0:  # As much by chance.
        return []
    places = [_moment(runs, starts, row) for row in (first, max(end - 1, first))]
    note = f"from {places[0]} to {places[1]}"
    return [_row_of(name, "points", drop, float(np.exp(likelihood)), note)]


_FEWEST_ROWS = 16  # of a channel, whose memory says nothing if it has fewer


def _times_white(
    at: Sequence[Response],
    factors: Sequence[np.ndarray],
    points: Sequence[str],
    first: int,
    end: int,
) -> float:
    """How many times as much residuals with a memory take from chi-square by chance.

    As neighbouring samples of most points have in common outside of the rows from `first` to
    `end`, where these are not nearly all.
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

    def edges(first: int, end: int) -> list[np.ndarray]:
        """The rows before and after each end of a stretch that lies within a run."""
        inner = [row for row in (first, end) if 0 < row < len(rows) and run[row - 1] == run[row]]
        return [rows[row - 1 : row + 1] for row in inner]

    first, end = _best_stretch(total)
    if not all(_cross(pair, two) for two in edges(first, end)):
        # Or they are exchanged from the first row on, and nowhere the other way.
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
    """Whether two points go on where the other one was, from a row to the next.

    A cell that was lost makes one of them jump, and to nowhere near the other.
    """
    one, other = pair
    stays = _jump(one, one, rows) + _jump(other, other, rows)
    crosses = _jump(one, other, rows) + _jump(other, one, rows)
    return stays - crosses >= _JUMP and crosses < _NEARER * stays


def _stays(pair: tuple[Cells, Cells], rows: np.ndarray) -> bool:
    """Whether the second point goes on as it was where the first one jumps to it, or from it."""
    return _jump(pair[1], pair[1], rows) < _NEARER * _jump(pair[0], pair[0], rows)


def _jump(to: Cells, since: Cells, rows: np.ndarray) -> float:
    """Squares by which a point is off, in the second row, where another would have moved to."""
    moved = np.nan_to_num(since[1][rows[1]] - since[1][rows[0]])
    weight = np.minimum(to[2][rows[1]], since[2][rows[0]])
    return float(np.sum((weight * (to[0][rows[1]] - since[0][rows[0]] - moved)) ** 2))


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
        ways[f"points: {name} does not move"] = (
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
