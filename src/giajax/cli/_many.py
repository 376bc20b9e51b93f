"""What commands with many tasks have in common: who does them, and how far they are."""

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .._signals import is_stopped, stopped_status
from .._text import time_in_words

if TYPE_CHECKING:
    from ..execution import Outcome

Workers = Annotated[
    int | None,
    typer.Option(metavar="N", min=1, help="Compute in so many processes of this machine (1)."),
]
"""The option `--workers`."""

Scheduler = Annotated[
    str | None,
    typer.Option(
        metavar="ADDRESS", help="Compute on a cluster of dask.distributed: tcp://host:8786."
    ),
]
"""The option `--scheduler`."""

# A line so often; for the first tasks, whose programs are compiled, none says how long it takes.
_BETWEEN_S = 5.0
_LEAST = 2


def end_if_stopped(folder: Path | None) -> None:
    """End a command that was stopped, after it has written what it had, and say how to go on.

    Arguments:
        folder: of the files of its tasks; None where they were not kept.
    """
    if is_stopped():
        how = "with --force" if folder is not None else "with --folder DIR, and --force,"
        typer.echo(f"giajax: stopped: the same command {how} goes on another time", err=True)
        raise typer.Exit(stopped_status())


class ManyProgress:
    """`progress` of `giajax.execution.run_tasks`: a line on standard error now and then.

    Arguments:
        what: tasks are called, in the plural: "fits".
    """

    def __init__(self, what: str) -> None:
        self._what = what
        self._first: tuple[int, float] | None = None
        self._said = self._began = time.monotonic()
        self._failed = 0

    def __call__(self, outcome: "Outcome", done: int, total: int) -> None:
        now = time.monotonic()
        self._failed += outcome.status == "failed"
        if self._first is None:
            self._first = done, now
            if done > 1:
                typer.echo(f"{done - 1} of {total} {self._what} are there already", err=True)
        if done < total and now - self._said < _BETWEEN_S:
            return
        self._said = now
        words = f"{done} of {total} {self._what} done"
        if self._failed:
            words += f", {self._failed} of them failed"
        # The first one compiles what the others share.
        first, began = self._first
        if done == total:
            words += f", in {time_in_words(now - self._began)}"
        elif done - first >= _LEAST:
            left = (now - began) / (done - first) * (total - done)
            words += f", about {time_in_words(left)} left"
        typer.echo(words, err=True)
