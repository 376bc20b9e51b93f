"""A run that is still being recorded, tracked while its lines come."""

import dataclasses
import time as clock
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np

from ...fitting import FitResult
from ...models import AbstractModel
from ...recordings import Channel, Run, table_of_lines
from ...runtime.text import InputError
from ._rounds import GATE
from ._track import SHOWN, Change, States, Unknown, arm_model, noise_of
from ._tracker import Tracker

_POLL = 0.2  # s
_RECENT = 10.0  # s, of which innovations are averaged


@dataclasses.dataclass(frozen=True)
class Heard:
    """What is known at one time of a run that is being recorded.

    Attributes:
        time: the stamp of the last row, s.
        now: what is expected of that time.
        shown: estimated parameters of which the run has shown something.
        nis: mean square of the innovations of the last 10 s, as numbers of deviation 1.
        changes: of parameters, that were found since the one before.
    """

    time: float
    now: States
    shown: frozenset[str]
    nis: float
    changes: tuple[Change, ...]


def lines_of(path: Path, patience: float) -> Iterator[bytes]:
    """Complete lines of a file that grows, until it has not grown for so long (s)."""
    with path.open("rb") as file:
        part, last = b"", clock.monotonic()
        while True:
            if found := file.readline():
                part, last = part + found, clock.monotonic()
                if part.endswith(b"\n"):
                    yield part
                    part = b""
            elif clock.monotonic() - last > patience:
                if part.strip():
                    yield part
                return
            else:
                clock.sleep(_POLL)


def followed_live(
    lines: Iterator[bytes],
    read: Callable[[bytes], Run],
    known_of: Callable[[Run], tuple[AbstractModel | FitResult, Unknown]],
    *,
    path: Path,
    rename: Mapping[str, str] | None = None,
    gate: float = GATE,
    every: float = 1.0,
) -> Iterator[Heard]:
    """Track a run while its lines come, the first of which names the columns.

    Arguments:
        lines: of a CSV file, in their order.
        read: makes a run of lines.
        known_of: gives the arm, or a fit of it, and what is unknown beside the motion, of the
            first rows.
        path: what errors call the file.
        rename: as of `giajax.read_run`.
        gate: deviations; a measurement that is farther off does not count.
        every: of the recorded time, s, something is said.

    Raises:
        InputError: lines that are no run, or a run that cannot be tracked while it is recorded.
    """
    begun = [line for _, line in zip(range(3), lines, strict=False)]
    if len(begun) < 3:
        raise InputError(f"{path} has ended before its second row: give a header line and rows")
    header = begun[0]
    first = read(b"".join(begun))
    if first.times is None:
        raise InputError(f"{path} has no time_s, by which it is tracked: give it")
    if first.winds:
        raise InputError(
            f"{path} has columns of a wind, which is not known before it blows: leave them out, or "
            "track the run once it has ended"
        )
    source, what = known_of(first)
    result = source if isinstance(source, FitResult) else None
    names = [*first.commands, *first.observations]
    command = np.zeros(arm_model(source).arm.count)
    for name in first.commands:
        channel = Channel.named(name)
        if channel.kind == "joint_command" and channel.index and channel.index <= len(command):
            command[channel.index - 1] = first.values[name][0]
    tracker = Tracker(
        source,
        noise=noise_of(first, list(first.observations), result),
        unknown=what,
        time=float(first.times[0]),
        command=command,
        gate=gate,
    )
    recent: deque[tuple[float, float, int]] = deque()
    changes = 0

    def row(time: float, values: Mapping[str, np.ndarray], k: int) -> None:
        there = {name: float(values[name][k]) for name in names if np.isfinite(values[name][k])}
        tracker.update({"time": time, **there})
        seen = sum(name in tracker.arm.channels for name in there)
        recent.append((time, float(np.sum(tracker.innovation**2)), seen))
        while recent[0][0] < time - _RECENT:
            recent.popleft()

    def heard(time: float) -> Heard:
        nonlocal changes
        now = tracker.now()
        fresh, changes = tracker.changes[changes:], len(tracker.changes)
        shown = frozenset(
            path
            for path, size in what.estimated.items()
            if now.parameter_deviations[path][0] < SHOWN * size
        )
        count = sum(each[2] for each in recent)
        nis = sum(each[1] for each in recent) / max(count, 1)
        return Heard(time, now, shown, nis, fresh)

    for k, last in enumerate(first.times.tolist()):
        row(last, first.values, k)
    said = last
    yield heard(last)
    for line in lines:
        if not line.strip():
            continue
        table = table_of_lines(header + line, path, rename)
        if table.times is None or not np.isfinite(table.times[0]) or table.times[0] <= last:
            raise InputError(
                f"{path}: a row comes with no time after {last:g} s: times must increase"
            )
        last = float(table.times[0])
        row(last, table.values, 0)
        if last - said >= every - 1e-9:
            said = last
            yield heard(last)
    if last > said:
        yield heard(last)
