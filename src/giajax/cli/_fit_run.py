"""`giajax fit` once its options are read: fit with a journal, write, show."""

import dataclasses
import shlex
import shutil
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from ..runtime.process import configure
from ..runtime.signals import stopped_status
from ..runtime.text import InputError, time_in_words
from ._options import (
    forget_starts,
    print_table,
    say_written,
    stop_if_asked,
    terminal_width,
    workers_of_starts,
)
from ._studies import self_test as repeated_fit

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration, Setup
    from ..recordings import Definition, Run
    from ..tasks import FitTask

# Who waits for less needs no word about it; a word a minute is enough for the others.
_WORTH_A_WORD_S = 30.0
_BETWEEN_WORDS_S = 60.0

_LEAST = 2  # steps that must have been timed: the first one compiles


@dataclasses.dataclass
class TimeLeft:
    """Says now and then how long a fit of at most so many trial steps may still take.

    Nobody knows how many steps are left until an optimum: what is said is how long it takes at
    most, or with several starts, how long at the pace of those before.
    """

    most: int
    starts: int = 1
    budget_s: float | None = None

    def __post_init__(self) -> None:
        self._began = self._before = time.monotonic()
        self._said = -float("inf")
        self._steps: list[float] = []
        self._start_times: list[float] = []

    def start(self) -> None:
        """One of several starts begins now."""
        self._before = time.monotonic()
        self._start_times.append(self._before)

    def after(self, number: int) -> str | None:
        """What to say after a step, if anything; step 0 is the evaluation of the start."""
        now = time.monotonic()
        taken, self._before = now - self._before, now
        if number > 0:
            self._steps.append(taken)
        if len(self._steps) < _LEAST or now - self._said < _BETWEEN_WORDS_S:
            return None
        seconds, sentence = self._estimate(number, now)
        if self.budget_s is not None and self.budget_s - (now - self._began) < seconds:
            seconds = max(self.budget_s - (now - self._began), 0.0)
            sentence = "at most {left} left: then its budget ends the fit"
        if seconds < _WORTH_A_WORD_S:
            return None
        self._said = now
        return sentence.format(left=time_in_words(seconds))

    def _estimate(self, number: int, now: float) -> tuple[float, str]:
        """Seconds, and a sentence for them."""
        if len(self._start_times) > 1:
            each = (self._start_times[-1] - self._start_times[0]) / (len(self._start_times) - 1)
            whole = each * (self.starts - len(self._start_times) + 1)
            return max(whole - (now - self._start_times[-1]), 0.0), (
                f"about {{left}} left for the starts up to {self.starts}, at the pace of those "
                "before"
            )
        steps = self.most - number + self.most * (self.starts - 1)
        each = statistics.median(self._steps)
        return steps * each, (
            f"at most {{left}} left: {steps} steps of {time_in_words(each)}, of which most fits "
            "need few"
        )


def _say(line: str) -> None:
    typer.echo(line, err=True)


class Progress:
    """One line an iteration on standard error, as it happens.

    Values (SI) are multiplied by the `factors` of their paths: their units are then those of the
    table at the end. `left` says how long it may still take.
    """

    def __init__(self, factors: Mapping[str, float], left: TimeLeft | None = None) -> None:
        self._factors = factors
        self._left = left
        self._widths: list[int] = []
        _say("compiling ...")

    def __call__(self, iteration: "Iteration") -> None:
        values = [
            f"{value * self._factors.get(path.partition('[')[0], 1.0):.5g}"
            for path, value in iteration.parameters.items()
        ]
        if not self._widths:
            self._head(list(iteration.parameters))
        step, taken = f"{iteration.step:.1e}", "yes" if iteration.accepted else "no"
        made = ["", ""] if iteration.number == 0 else [step, taken]
        self._row([str(iteration.number), f"{iteration.cost:.6g}", *made, *values])
        if self._left is not None and (sentence := self._left.after(iteration.number)):
            _say(sentence)
        stop_if_asked(iteration)

    def announce(self, number: int, start: Mapping[str, float]) -> None:
        """Say which of several starts is next."""
        if self._left is not None:
            self._left.start()
        _say(f"start {number}")

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
        _say(line)


def _in_windows(setup: "Setup") -> Progress:
    """The progress of a fit in windows, which only says where that of whole runs begins."""
    from ..fitting import column_factors

    _say(f"first in {len(setup.runs)} windows")
    return Progress(column_factors(setup.model))


def _of_windows(result: "FitResult") -> None:
    _say(f"in windows: {result.message}; whole runs from there")


def write_or_print(result: "FitResult", runs: "Sequence[Run]", folder: Path) -> list[Path]:
    """Write a result; where that cannot be (a full disk), it goes to standard output.

    Where that cannot take it either, such as a file on the same disk, it goes to standard error.
    """
    from ..report import write_result

    write = partial(write_result, result, runs, folder, figures=False)
    try:
        try:
            return write()
        except KeyboardInterrupt:  # once more, because this is what the fit was for
            write()
            raise
    except InputError:
        for stream in (sys.stdout, sys.stderr):
            try:
                print(result.to_json(), end="", file=stream, flush=True)
            except OSError:
                continue
            break
        typer.echo("the fit is above, because its files could not all be written:", err=True)
        raise


def show_result(result: "FitResult", definition: "Definition") -> None:
    """Print the estimates, the summary and the figures to reach."""
    from ..report import parameter_table, reached, summary

    width = terminal_width()
    print(parameter_table(result, width), summary(result, width), sep="\n\n")
    if figures := reached(result, definition):
        print()
    for figure in figures:
        word = "reached" if figure.reached else "MISSED"
        print(f"{word:<9}{figure.path} {figure.sentence}")
    sys.stdout.flush()


def show_diagnosis(result: "FitResult") -> None:
    """Print the first suspects, and what stated uncertainties of held numbers do."""
    from ..report import SUSPECT_HEADINGS, first_suspects, systematic_table

    if rows := first_suspects(result):
        print("\nwhat the residuals ask for (giajax suspects shows all of it):")
        print_table(SUSPECT_HEADINGS, rows)
    if any(error.stated for error in result.systematic):
        print("\nwhat a held number moves, in standard errors:")
        print_table(*systematic_table(result))


_STATUS = {"converged": 0, "not_converged": 1}

_INADEQUATE = 3  # with --strict, of a fit whose model does not describe the data


def finished(folder: Path, as_json: bool, quiet: bool) -> int | None:
    """Say of a fit that has ended that there is nothing to go on with; the status of its end.

    It is None where there is a journal, or no such result.
    """
    from ..recordings import stored_result
    from ..tasks import read_journal

    path = folder / "result.json"
    if read_journal(folder) is not None or not path.exists():
        return None
    _, record = stored_result(path)
    if record["status"] not in _STATUS:
        return None
    if as_json:
        typer.echo(path.read_text(encoding="utf-8"), nl=False)
    if not quiet:
        ended = f"the fit in {folder} has ended, and there is nothing to go on with"
        typer.echo(f"{ended}: {record['message']}", err=as_json)
    return _STATUS[record["status"]]


def run_fit(
    task: "FitTask",
    *,
    again: Path | None,
    resume: bool,
    force: bool,
    as_json: bool,
    quiet: bool,
    figures: bool,
    report: bool,
    self_test: bool,
    strict: bool,
    suspects: bool,
    workers: int | None,
    scheduler: str | None,
) -> int:
    """Fit a task, write its result and show it, by the options of these names; the exit status."""
    configure()
    from ..fitting import column_factors
    from ..recordings import stored_result, write_files
    from ..report import PAGE, check_figures, check_folder, check_page, report_page, write_figures
    from ..studies import choice_hint
    from ..tasks import compared, version_note, with_warm_start

    watched = (lambda _: stop_if_asked,) if quiet else (_in_windows, _of_windows)
    task = with_warm_start(task, *watched)
    ready, shown = task.prepare(), not (as_json or quiet)
    check_figures(ready.setup.model, task.definition)
    check_folder(task.out, ready.runs, ready.setup.config, force=force)
    if report:
        check_page(task.out / PAGE, force=force)
    before = None if again is None or task.resolved is None else stored_result(again)[1]
    settings = task.definition.fit
    with (
        ready.open_journal(task.out, resume=resume, force=force, complain=_complain) as journal,
        workers_of_starts(workers, scheduler, settings.starts, task.out) as others,
    ):
        versions = journal.head["versions"] if before is None else before["versions"]
        if note := version_note(versions):
            _complain(note)
        progress = None
        if not quiet:
            left = TimeLeft(settings.max_iterations, settings.starts, settings.budget_s)
            progress = Progress(column_factors(ready.setup.model), left)
            if resume:
                typer.echo(f"going on where {journal.path} ends", err=True)
        try:
            result = ready.run(
                stop_if_asked if progress is None else progress,
                None if progress is None else progress.announce,
                journal=journal.of,
                **others,
            )
        except KeyboardInterrupt:
            if journal.is_begun:
                _complain(f"what was computed is kept: {_go_on(task)}")
            raise
        if progress is not None:
            # A line between the iterations and the table, where both are on one screen.
            typer.echo("", err=True)
        files = write_or_print(result, ready.runs, task.out)
        journal.settle(result)
        goes_on = journal.path.exists()
        if not goes_on:
            forget_starts(task.out)
    if shown:
        show_result(result, task.definition)
        if before is not None:
            print(f"{'again':<20}{compared(result, before)}")
    # The fit itself is shown and on disk by now: these tests compile a program of their own.
    asked = ready.diagnosed(result, suspects=suspects)
    if asked is not result:
        files = write_or_print(asked, ready.runs, task.out)
    if as_json:
        typer.echo(asked.to_json(), nl=False)
    elif not quiet:
        show_diagnosis(asked)
    # What a person waits for is there; drawing takes a second or two.
    if figures:
        files += write_figures(result, ready.runs, task.out, held_out=ready.held_out_runs)
    if self_test:
        files += repeated_fit(result, ready.runs, task.out, shown=shown)
    if report:
        source, held_out = task.out / "result.json", ready.held_out_runs
        page = report_page(asked, ready.runs, held_out=held_out, source=source)
        write_files({task.out / PAGE: page}, force=True)
        files.append(task.out / PAGE)
    if shown:
        say_written(files[0].parent, [path.name for path in files])
        if goes_on:
            print(f"\n{_go_on(task, result)}")
        if hint := choice_hint(ready.runs, [str(path) for path in task.data]):
            print(f"\n{hint}")
    if strict and result.verdict.status == "inadequate":
        return _INADEQUATE
    return _STATUS.get(result.status, stopped_status())


def _go_on(task: "FitTask", result: "FitResult | None" = None) -> str:
    """How a fit that was stopped is gone on with."""
    how = f"to go on with it: giajax fit --resume {shlex.quote(str(task.out))}"
    # A fit that had its iterations would end again at once.
    if result and result.status == "not_converged" and "budget_s" not in result.config:
        how += f" --max-iterations {2 * result.config['max_iterations']}"
    return how


def _complain(sentence: str) -> None:
    _say(f"giajax: {sentence}")
