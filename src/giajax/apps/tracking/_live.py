"""Live tracking of a run that is still being recorded."""

import dataclasses
import itertools
import time as clock
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ...fitting import FitResult
from ...models import AbstractModel
from ...recordings import LineReader, Run
from ...runtime.process import stop_if_asked
from ...runtime.text import InputError
from ...schema import CommandSection, InitialSection, WindSection
from ._rounds import GATE
from ._track import (
    LATELY,
    SHOWN,
    Change,
    States,
    Unknown,
    correlated_noise_of,
    model_and_unknown,
    noise_of,
)
from ._tracker import Tracker

_POLL = 0.2  # interval between attempts to read a growing file, s


@dataclasses.dataclass(frozen=True)
class Heard:
    """Estimate at one time of a live run.

    Attributes:
        time: time stamp of the last row, s.
        now: state predicted for the time at which this row arrives.
        shown: estimated parameters on which the run contains information so far.
        nis: mean square of the whitened innovations of the last 10 s that were used; None if there
            are none.
        changes: changes of parameters detected since the previous estimate.
    """

    time: float
    now: States
    shown: frozenset[str]
    nis: float | None
    changes: tuple[Change, ...]


def lines_of(path: Path, patience: float) -> Iterator[bytes]:
    """Yield the lines of a growing file until it has not grown for `patience` seconds.

    The last line has no newline if the file ends within it.
    """
    with path.open("rb") as file:
        part, last = b"", clock.monotonic()
        while True:
            if found := file.readline():
                part, last = part + found, clock.monotonic()
                if part.endswith(b"\n"):
                    yield part
                    part = b""
            elif clock.monotonic() - last > patience:
                if part:
                    yield part
                return
            else:
                clock.sleep(_POLL)


_BEFORE = 2  # number of previous rows with which the next one is checked


class LiveRows:
    """Rows of a CSV file whose lines arrive one after another; the first line is the header.

    A line that is not a valid row after the previous ones is ignored with a warning.

    Arguments:
        lines: lines of the file, in order.
        reader: reader for lines of this file.
        read: function that converts the run from the reader, for example to some of its channels.
        warn: function that is called with a message for each ignored line.

    Raises:
        InputError: the column names are not those of a run with times.

    Attributes:
        kept: header and all valid rows so far, as the content of a file.
    """

    def __init__(
        self,
        lines: Iterator[bytes],
        reader: LineReader,
        read: Callable[[Run], Run],
        warn: Callable[[str], None],
    ) -> None:
        self.kept = bytearray()
        self._lines = enumerate(lines, 1)
        self._reader, self._of, self._warn = reader, read, warn
        self._header = next((line for _, line in self._lines if line.strip()), b"")
        reader.check_names(self._header)
        self.kept += self._header

    def run(self, *, partial: bool = False) -> Run:
        """Return the run of all rows so far; a `partial` run may still grow.

        Raises:
            InputError: the rows are not a run, for example because there is only one.
        """
        return self._of(self._reader.read(bytes(self.kept), partial=partial))

    def __iter__(self) -> Iterator[tuple[float, dict[str, float]]]:
        """Yield the time, s, and the values of each row, SI units; missing values are NaN."""
        before: list[bytes] = []
        for number, line in self._lines:
            if not line.strip():
                continue
            some = [*before, line]
            try:
                if not line.endswith(b"\n"):
                    raise InputError("the row is incomplete")
                # Read the row together with previous ones, to check that the times increase and
                # have the same unit.
                data = b"".join([self._header, *some])
                run = self._of(self._reader.read(data, number - len(before), partial=True))
                if run.times is None or len(run.times) != len(some):
                    raise InputError("the line contains more than one row")
            except InputError as error:
                self._warn(f"row {number} is ignored: {error}")
                continue
            before = some[-_BEFORE:]
            self.kept += line
            values = {
                name: float(column[-1])
                for name, column in run.values.items()
                if run.channels[name].quantity != "text"
            }
            yield float(run.times[-1]), values


def followed_live(
    rows: LiveRows,
    known_of: Callable[[Run], tuple[AbstractModel | FitResult, Unknown]],
    *,
    latency: float = 0.0,
    gate: float = GATE,
    every: float = 1.0,
) -> Iterator[Heard]:
    """Track a run while its rows arrive, and yield estimates.

    Arguments:
        rows: rows with commands and measurements.
        known_of: function that returns the model of the arm, or a fit of it, and the unknown
            quantities, from the run of the first two rows.
        latency: delay of the arrival of a row after its time stamp, s; estimates are predicted for
            the time of arrival.
        gate: innovation, in standard deviations, above which a measurement is not used.
        every: recorded time between two estimates, s.

    Raises:
        InputError: there are fewer than two rows, or the run cannot be tracked live.
    """
    coming = iter(rows)
    begun = list(itertools.islice(coming, 2))
    if len(begun) < 2:
        raise InputError(
            "the input ended before its second row: give a header and at least two rows"
        )
    first = rows.run(partial=True)
    tracker, what = _tracker_of(first, known_of, gate)
    recent: deque[tuple[float, float, int]] = deque()
    changes = 0

    def take(time: float, values: dict[str, float]) -> None:
        stop_if_asked()
        names = [*first.commands, *first.observations]
        tracker.update({"time": time, **{name: values[name] for name in names}})
        square = float(np.sum(tracker.innovation**2))
        recent.append((time, square, int(np.sum(tracker.used))))
        while recent[0][0] < time - LATELY:
            recent.popleft()

    def heard(time: float) -> Heard:
        nonlocal changes
        now = tracker.now(max(time + latency, tracker.filter.time))
        fresh, changes = tracker.changes[changes:], len(tracker.changes)
        shown = frozenset(
            path
            for path, size in what.estimated.items()
            if now.parameter_deviations[path][0] < SHOWN * size
        )
        count = sum(each[2] for each in recent)
        nis = sum(each[1] for each in recent) / count if count else None
        return Heard(time, now, shown, nis, fresh)

    said = -np.inf
    for k, (last, values) in enumerate(itertools.chain(begun, coming)):
        take(last, values)
        if k and last - said >= every - 1e-9:
            said = last
            yield heard(last)
    if last > said:
        yield heard(last)


def _tracker_of(
    first: Run,
    known_of: Callable[[Run], tuple[AbstractModel | FitResult, Unknown]],
    gate: float,
) -> tuple[Tracker, Unknown]:
    """Return the tracker for a run that begins with these rows, and its unknown quantities."""
    if first.winds:
        raise InputError(
            f"'{first.name}' has wind columns, but the wind is not known in advance: omit them, "
            "or track the run after it has ended"
        )
    assert first.times is not None
    source, given = known_of(first)
    model, what = model_and_unknown(source, first, given)
    result = source if isinstance(source, FitResult) else None
    names = list(first.observations)
    what = dataclasses.replace(what, biases=(*what.biases, *correlated_noise_of(first, names)))
    inputs = model.prepare(first)
    stated = first.definition.section(InitialSection)
    starts = bool(stated.first_row) or bool(stated.values())
    tracker = Tracker(
        model,
        noise=noise_of(first, names, result),
        unknown=what,
        time=float(first.times[0]),
        command=inputs.command.values[0],
        angles=inputs.initial.angle if starts else None,
        rates=inputs.initial.rate if starts else None,
        wind=first.definition.section(WindSection).velocity_m_per_s,
        held=first.definition.section(CommandSection).interpolation == "zoh",
        gate=gate,
    )
    return tracker, what
