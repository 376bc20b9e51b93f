"""The progress of a fit on standard error."""

import shutil
import sys
from collections.abc import Mapping
from typing import TYPE_CHECKING

import typer

from .._signals import is_stopped
from ._time_left import TimeLeft

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration, Setup


def stop_if_asked(iteration: "Iteration") -> None:
    """Stop a fit after a signal whose exception was lost, as in a callback of a library."""
    if is_stopped():
        raise KeyboardInterrupt


class Progress:
    """One line an iteration on standard error, as it happens.

    Arguments:
        factors: what the value of each parameter (SI) is multiplied by, by path: its unit is
            then that of the table at the end. 1 for others.
        left: says how long it may still take; None for no word about it.
    """

    def __init__(self, factors: Mapping[str, float], left: TimeLeft | None = None) -> None:
        self._factors = factors
        self._left = left
        self._say("compiling ...")
        self._headed = False

    def __call__(self, iteration: "Iteration") -> None:
        values = [
            f"{value * self._factors.get(path.partition('[')[0], 1.0):.5g}"
            for path, value in iteration.parameters.items()
        ]
        cells = [str(iteration.number), f"{iteration.cost:.6g}", f"{iteration.step:.1e}"]
        if not self._headed:
            self._head(list(iteration.parameters))
            self._headed = True
        taken = "yes" if iteration.accepted else "no"
        first = iteration.number == 0
        self._row([cells[0], cells[1], "" if first else cells[2], "" if first else taken, *values])
        if self._left is not None and (sentence := self._left.after(iteration.number)):
            self._say(sentence)
        stop_if_asked(iteration)

    def announce(self, number: int, start: Mapping[str, float]) -> None:
        """Say which of several starts is next."""
        if self._left is not None:
            self._left.start()
        self._say(f"start {number}")

    def end(self) -> None:
        """Keep a line between the iterations and the table, where both are on one screen."""
        self._say("")

    def _head(self, paths: list[str]) -> None:
        # joints.pitch_stiffness in two short lines, so that four parameters go into 80 columns.
        upper, lower = [], []
        for path in paths:
            before, _, name = path.rpartition(".")
            front, _, back = name.rpartition("_")
            upper.append(front or before)
            lower.append(back)
        self._widths = [4, 11, 8, 5] + [
            max(9, len(a), len(b)) for a, b in zip(upper, lower, strict=True)
        ]
        self._row(["", "", "", "", *upper])
        self._row(["", "cost", "step", "taken", *lower])

    def _row(self, cells: list[str]) -> None:
        line = "  ".join(c.rjust(w) for c, w in zip(cells, self._widths, strict=True)).rstrip()
        if sys.stderr.isatty():
            line = line[: shutil.get_terminal_size().columns]
        self._say(line)

    def _say(self, line: str) -> None:
        typer.echo(line, err=True)


def in_windows(setup: "Setup") -> Progress:
    """The progress of a fit in windows, which only says where that of whole runs begins."""
    from ..fitting import column_factors

    typer.echo(f"first in {len(setup.runs)} windows", err=True)
    return Progress(column_factors(setup.model))


def of_windows(result: "FitResult") -> None:
    """Say how a fit in windows ended."""
    typer.echo(f"in windows: {result.message}; whole runs from there", err=True)
