"""Hold data out of a fit: whole runs, whole channels, or the last part of the recordings.

`giajax.fitting` compares the held-out data with the prediction of the fitted model.
"""

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from ..runtime.text import InputError
from ._run import Run

SHARE = 0.2
"""Fraction of the duration of a recording that `last` holds out."""

_LAST = re.compile(r"last(?::(.*))?", re.IGNORECASE)

_NUMBER = re.compile(r"[0-9]*\.?[0-9]+")


@dataclasses.dataclass(frozen=True)
class SplitRun:
    """A run and its fitted and held-out parts, each None if it is empty.

    Both parts have the times and inputs of the whole run. The cells of the other part are NaN, and
    channels without any cell in a part are left out of it.
    """

    whole: Run
    fitted: Run | None
    held: Run | None

    @property
    def held_from(self) -> dict[str, int]:
        """First sample with a value of each channel in the held-out part."""
        cells = {} if self.held is None else self.held.observations
        return {name: int(np.argmax(~np.isnan(values))) for name, values in cells.items()}


def hold_out(runs: Sequence[Run], names: Sequence[str]) -> tuple[SplitRun, ...]:
    """Split runs into a fitted and a held-out part.

    Arguments:
        runs: the runs of a fit, or their windows.
        names: names of runs or of channels (in all runs), or `last`: the last fifth of the duration
            of each recording; `last:0.3` holds out another fraction. If the samples have no times,
            it is this fraction of the samples.

    Returns:
        The parts of each run.

    Raises:
        InputError: a name is unknown or ambiguous, or holds out no measured value; or no data are
            left to fit.
    """
    held_from: list[dict[str, int]] = [{} for _ in runs]
    for name in names:
        rows = _first_rows(name.strip(), runs)
        parts = [split_run(run, first) for run, first in zip(runs, rows, strict=True)]
        if all(part.held is None for part in parts):
            raise InputError(
                f"'{name}' holds out no measured value: hold out more data, or omit this entry"
            )
        for known, first in zip(held_from, rows, strict=True):
            known |= {channel: min(row, known.get(channel, row)) for channel, row in first.items()}
    parts = [split_run(run, first) for run, first in zip(runs, held_from, strict=True)]
    if all(part.fitted is None for part in parts):
        raise InputError(
            f"the held-out data ({', '.join(names)}) contain all measured values, so none is left "
            "to fit: hold out less data"
        )
    return tuple(parts)


def fitted_parts(parts: Iterable[SplitRun]) -> list[Run]:
    """Return the fitted parts of runs, without runs that are held out entirely."""
    return [part.fitted for part in parts if part.fitted is not None]


def held_parts(parts: Iterable[SplitRun]) -> list[Run]:
    """Return the held-out parts of runs, without runs that are fitted entirely."""
    return [part.held for part in parts if part.held is not None]


def split_run(run: Run, held_from: Mapping[str, int]) -> SplitRun:
    """Split a run at the first held-out sample of each channel; others are fitted entirely."""
    masks = {
        name: np.arange(len(values)) >= held_from.get(name, len(values))
        for name, values in run.observations.items()
    }
    fitted = _cells(run, {name: ~held for name, held in masks.items()})
    return SplitRun(run, fitted, held=_cells(run, masks))


def _cells(run: Run, kept: Mapping[str, np.ndarray]) -> Run | None:
    """Return the run with only the kept cells, and only channels that have any; None if empty."""
    values = {}
    for name, mask in kept.items():
        cells = run.values[name]
        if not np.all(mask | np.isnan(cells)):
            cells = np.where(mask, cells, np.nan)
            cells.setflags(write=False)
        if not np.all(np.isnan(cells)):
            values[name] = cells
    if not values:
        return None
    # If no channel is left out, the run is fitted as it would be without held-out data.
    observed = run.observed if len(values) == len(kept) else tuple(values)
    # A channel that is left out keeps its values, because they may give the initial state.
    return dataclasses.replace(run, values={**run.values, **values}, observed=observed)


def _first_rows(name: str, runs: Sequence[Run]) -> list[dict[str, int]]:
    """Return the first sample that a name holds out, for each run and channel."""
    named = [run for run in runs if name in (run.name, run.recording)]
    measured = [run for run in runs if name in run.observations]
    last = _LAST.fullmatch(name)
    if bool(named) + bool(measured) + (last is not None) > 1:
        raise InputError(
            f"'{name}' is to be held out, but this name refers to more than one of a run, a "
            "channel and the last samples: rename the run or its file"
        )
    if len({run.path or id(run) for run in named}) > 1:
        raise InputError(
            f"'{name}' is to be held out, but two recordings have this name: rename one of them"
        )
    if last is not None:
        share = SHARE if last[1] is None else np.nan
        if last[1] is not None and _NUMBER.fullmatch(last[1]):
            share = float(last[1])
        if not 0 < share < 1:
            raise InputError(
                f"'{name}' is to be held out, but does not give a valid fraction: write it as "
                "last:0.3, with a number between 0 and 1"
            )
        return _last(runs, share)
    if named or measured:
        return [
            {channel: 0 for channel in run.observations if run in named or channel == name}
            for run in runs
        ]
    names = ", ".join(dict.fromkeys(run.recording for run in runs))
    channels = ", ".join(dict.fromkeys(channel for run in runs for channel in run.observations))
    raise InputError(
        f"'{name}' is to be held out, but is neither a run nor a channel: name a run ({names}), a "
        f"channel ({channels}), or last"
    )


def _last(runs: Sequence[Run], share: float) -> list[dict[str, int]]:
    """Return the first held-out samples if the last part of each recording is held out.

    The fraction refers to the whole recording, even if it is cut into windows.
    """
    ends: dict[object, tuple[float, float]] = {}
    for run in runs:
        if run.times is not None:
            start, end = ends.get(run.path or id(run), (np.inf, -np.inf))
            span = min(start, run.times[0]), max(end, run.times[-1])
            ends[run.path or id(run)] = span
    rows = []
    for run in runs:
        if run.times is None:
            count = len(next(iter(run.values.values())))
            first = count - round(share * count)
        else:
            start, end = ends[run.path or id(run)]
            # A sample exactly at the end of the first part belongs to it, despite rounding errors.
            instant = end - (share - 1e-9) * (end - start)
            first = int(np.searchsorted(run.times, instant, side="right"))
        rows.append(dict.fromkeys(run.observations, first))
    return rows
