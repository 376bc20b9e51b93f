"""`giajax fit`: estimation of the parameters of a model from recordings."""

import contextlib
import dataclasses
import math
import os
import re
import shlex
import shutil
import statistics
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, Unpack, cast

import typer

from ..runtime.plugins import plugins
from ..runtime.process import (
    CORES_VARIABLE,
    configure,
    is_stopped,
    stop_if_asked,
    stopped_status,
)
from ..runtime.text import InputError, time_in_words
from ._commands import (
    Cores,
    Figures,
    Force,
    HoldOut,
    Json,
    Paths,
    Quiet,
    Renamed,
    Scheduler,
    Texts,
    Workers,
    argument,
    command,
    command_after,
    forget_starts,
    print_table,
    say_written,
    terminal_width,
    workers_of_starts,
)
from ._model import DOUBTED
from ._studies import self_test as repeated_fit
from ._values import bounds, groups, plain_settings, priors, ties

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration, Setup
    from ..recordings import Definition, Run, TaskKeywords
    from ..tasks import FitTask

# The part of `giajax fit` after its options are read: fit with a journal, write, show.

# Shorter times are not announced; one line per minute is enough for longer ones.
_WORTH_A_WORD_S = 30.0
_BETWEEN_WORDS_S = 60.0

_LEAST = 2  # Number of steps that must have been timed, because the first one includes compilation.


@dataclasses.dataclass
class TimeLeft:
    """Estimate of the remaining time of a fit with a maximum number of trial steps.

    The number of steps to the optimum is not known in advance. The estimate is therefore the
    longest possible time. With several starts it is based on the duration of the previous starts.
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
        """Record that the next start begins."""
        self._before = time.monotonic()
        self._start_times.append(self._before)

    def after(self, number: int) -> str | None:
        """Return a sentence after a step, or None; step 0 is the evaluation of the start."""
        now = time.monotonic()
        taken, self._before = now - self._before, now
        if number > 0:
            self._steps.append(taken)
        if len(self._steps) < _LEAST or now - self._said < _BETWEEN_WORDS_S:
            return None
        seconds, sentence = self._estimate(number, now)
        if self.budget_s is not None and self.budget_s - (now - self._began) < seconds:
            seconds = max(self.budget_s - (now - self._began), 0.0)
            sentence = "at most {left} left until the budget ends the fit"
        if seconds < _WORTH_A_WORD_S:
            return None
        self._said = now
        return sentence.format(left=time_in_words(seconds))

    def _estimate(self, number: int, now: float) -> tuple[float, str]:
        """Return the remaining seconds and a sentence for them."""
        if len(self._start_times) > 1:
            each = (self._start_times[-1] - self._start_times[0]) / (len(self._start_times) - 1)
            whole = each * (self.starts - len(self._start_times) + 1)
            return max(whole - (now - self._start_times[-1]), 0.0), (
                f"about {{left}} left until the fits from all {self.starts} initial guesses are "
                "done, estimated from the previous fits"
            )
        steps = self.most - number + self.most * (self.starts - 1)
        each = statistics.median(self._steps)
        return steps * each, (
            f"at most {{left}} left: {steps} steps of {time_in_words(each)}, but most fits need "
            "far fewer steps"
        )


def _say(line: str) -> None:
    typer.echo(line, err=True)


class Progress:
    """One line per iteration on standard error, printed immediately.

    The values have the units of the final table; nuisance parameters are not shown. `left`
    estimates the remaining time.
    """

    def __init__(self, setup: "Setup", left: TimeLeft | None = None) -> None:
        from ..fitting import column_factors

        self._factors = column_factors(setup.model)
        self._left_out = setup.nuisances
        self._left = left
        self._widths: list[int] = []
        self._part = 1.0
        _say("compiling ...")

    def __call__(self, iteration: "Iteration") -> None:
        shown = {p: value for p, value in iteration.parameters.items() if p not in self._left_out}
        values = [
            f"{value * self._factors.get(path.partition('[')[0], 1.0):.5g}"
            for path, value in shown.items()
        ]
        if not self._widths:
            self._head(list(shown))
        step, taken = f"{iteration.step:.1e}", "yes" if iteration.accepted else "no"
        made = ["", ""] if iteration.number == 0 else [step, taken]
        if iteration.part != self._part:
            self._part = iteration.part
            rows = f"the first {100 * self._part:.2g} %" if self._part < 1 else "all"
            _say(f"fit to {rows} of the rows:")
        self._row([str(iteration.number), f"{iteration.cost:.6g}", *made, *values])
        if self._left is not None and (sentence := self._left.after(iteration.number)):
            _say(sentence)
        stop_if_asked(iteration)

    def announce(self, number: int, start: Mapping[str, float]) -> None:
        """Print which of several starts is next."""
        if self._left is not None:
            self._left.start()
        _say(f"start {number}")

    def _head(self, paths: list[str]) -> None:
        width = shutil.get_terminal_size().columns if sys.stderr.isatty() else math.inf
        names = [[path] for path in paths]
        if sum(_BEFORE) + sum(len(path) + _GAP for path in paths) > width:
            # Long names are split over several lines, so that four parameters fit in 80 columns.
            names = [re.split(r"(?<=[._])(?=.)", path) for path in paths]
        self._widths = list(_BEFORE)
        for parts in names:
            self._widths.append(max(9, *map(len, parts)))
            if sum(self._widths) + _GAP * (len(self._widths) - 1) > width:
                # Names and numbers are not truncated: only the first parameters that fit are shown.
                self._widths.pop()
                break
        shown = names[: len(self._widths) - len(_BEFORE)]
        depth = max(map(len, shown), default=1)
        rows = zip(*([""] * (depth - len(parts)) + parts for parts in shown), strict=True)
        *above, last = list(rows) or [()]
        for row in above:
            self._row(["", "", "", "", *row])
        self._row(["", "cost", "step", "taken", *last])
        if len(shown) < len(paths):
            _say(f"({len(paths) - len(shown)} more parameters do not fit in the terminal)")

    def _row(self, cells: list[str]) -> None:
        # If not all parameters are shown there are fewer widths than cells.
        columns = zip(cells, self._widths, strict=False)
        _say((" " * _GAP).join(cell.rjust(width) for cell, width in columns).rstrip())


# Widths of the columns before the parameters, and of the gap between columns.
_BEFORE, _GAP = (4, 11, 8, 5), 2


def _in_windows(setup: "Setup") -> Progress:
    """Announce the fit in windows, and return its progress."""
    _say(f"first fit in {len(setup.runs)} windows")
    return Progress(setup)


def _of_windows(result: "FitResult") -> None:
    _say(f"fit in windows: {result.message}; the fit of whole runs starts from this result")


def write_or_print(result: "FitResult", runs: "Sequence[Run]", folder: Path) -> list[Path]:
    """Write a result; if that fails (a full disk), print it to standard output.

    If standard output cannot take it, such as a file on the same disk, it goes to standard error. A
    failure to write other files than `result.json` is only reported.
    """
    from ..report import write_result

    write = partial(write_result, result, runs, folder, figures=False)
    try:
        try:
            return write()
        except KeyboardInterrupt:  # Write again, because the result must not be lost.
            write()
            raise
    except InputError as error:
        path, text = folder / "result.json", result.to_json()
        with contextlib.suppress(OSError):
            if path.read_bytes() == text.encode():
                _complain(f"the result was written, but {error}")
                return [path]
        for stream in (sys.stdout, sys.stderr):
            print(text, end="", file=stream, flush=True)
            if getattr(stream, "error", None) is None:
                break
        typer.echo(
            "the result is printed above because not all of its files could be written:", err=True
        )
        raise


@contextlib.contextmanager
def _beside_result() -> Iterator[None]:
    """Report errors when other files than `result.json` are written, such as on a full disk."""
    try:
        yield
    except InputError as error:
        _complain(f"the result was written, but {error}")


def show_result(result: "FitResult", definition: "Definition") -> None:
    """Print the estimates, the summary and the target figures."""
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
    """Print the first suspects, and the effects of the uncertainty of fixed parameters."""
    from ..report import SUSPECT_HEADINGS, first_suspects, systematic_table

    if rows := first_suspects(result):
        print("\neffects that the residuals suggest (run 'giajax suspects' to list all suspects):")
        print_table(SUSPECT_HEADINGS, rows)
    if any(error.stated for error in result.systematic):
        print("\neffect of uncertain fixed parameters on the estimates, in standard errors:")
        print_table(*systematic_table(result))


_STATUS = {"converged": 0, "not_converged": 1}

_INADEQUATE = 3  # Exit status with --strict if the model is inadequate or doubtful.


def finished(folder: Path, as_json: bool, quiet: bool) -> int | None:
    """Report that a completed fit cannot be continued, and return its exit status.

    The status is None if there is a journal, or no such result.
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
        ended = f"the fit in {folder} has ended and cannot be continued"
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
    """Fit a task, write and show its result; the arguments are options; return the status."""
    configure()
    from ..recordings import stored_result, write_files
    from ..report import (
        PAGE,
        check_figures,
        check_folder,
        check_page,
        report_page,
        write_figures,
        write_result,
    )  # fmt: skip
    from ..studies import choice_hint
    from ..tasks import compared, version_note, with_warm_start

    watched = (lambda _: stop_if_asked,) if quiet else (_in_windows, _of_windows)
    task = with_warm_start(task, *watched)
    ready, shown = task.prepare(), not (as_json or quiet)
    check_figures(ready.setup.model, task.definition)
    check_folder(task.out, ready.runs, ready.setup.config, force=force)
    if report:
        check_page(task.out / PAGE, force=force)
    for odd in () if quiet else ready.odd:
        _say(f"note: {odd.sentence}: {odd.advice}")
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
            progress = Progress(ready.setup, left)
            if resume:
                typer.echo(f"continuing from the end of {journal.path}", err=True)
        try:
            result = ready.run(
                stop_if_asked if progress is None else progress,
                None if progress is None else progress.announce,
                journal=journal.of,
                **others,
            )
        except KeyboardInterrupt:
            if journal.is_begun:
                _complain(f"the computed part of the fit is kept; {_go_on(task)}")
            raise
        if progress is not None:
            # Separate the iterations from the table by a blank line if both are on one screen.
            typer.echo("", err=True)
        files = write_or_print(result, ready.runs, task.out)
        journal.settle(result)
        goes_on = journal.path.exists()
        if not goes_on:
            forget_starts(task.out)
    # The fit itself is written before these tests, which compile another program.
    untested: list[str] = []
    asked = ready.diagnosed(
        result,
        suspects=suspects,
        announce=None if quiet else partial(typer.echo, err=True),
        complain=untested.append,
    )
    for sentence in untested:
        _complain(f"{sentence}: giajax suspects {shlex.quote(str(task.out))}")
    if asked is not result:
        with _beside_result():
            files = write_result(asked, ready.runs, task.out, figures=False)
    if shown:
        show_result(asked, task.definition)
        if before is not None:
            print(f"{'again':<20}{compared(asked, before)}")
    if as_json:
        typer.echo(asked.to_json(), nl=False)
    elif not quiet:
        show_diagnosis(asked)
    # The results are printed before figures are drawn, which takes a second or two.
    if figures:
        with _beside_result():
            files += write_figures(asked, ready.runs, task.out, held_out=ready.held_out_runs)
    if self_test:
        with _beside_result():
            files += repeated_fit(result, ready.runs, task.out, shown=shown)
    if report:
        with _beside_result():
            source, held_out = task.out / "result.json", ready.held_out_runs
            page = report_page(asked, ready.runs, held_out=held_out, source=source)
            write_files({task.out / PAGE: page}, force=True)
            files.append(task.out / PAGE)
    if shown:
        say_written(files[0].parent, [path.name for path in files])
        if goes_on:
            print(f"\n{_go_on(task, result)}")
        else:
            print(command_after("view" if task.out / PAGE in files else "report", task.out))
        if hint := choice_hint(ready.runs, [str(path) for path in task.data]):
            print(f"\n{hint}")
    if strict and asked.status == "converged" and asked.verdict.status in DOUBTED:
        return _INADEQUATE
    if untested and is_stopped():
        return stopped_status()
    return _STATUS.get(result.status, stopped_status())


def _go_on(task: "FitTask", result: "FitResult | None" = None) -> str:
    """Return a sentence on how to continue a stopped fit."""
    how = f"to continue the fit: {resumes('fit', task.out)}"
    # A fit that has used all its iterations would end again immediately.
    if result and result.status == "not_converged" and "budget_s" not in result.config:
        how += f" --max-iterations {2 * result.config['max_iterations']}"
    return how


def resumes(command: str, folder: Path) -> str:
    """Return the command that continues the stopped computation of a folder."""
    added = (f"--plugin {shlex.quote(str(path))}" for path in plugins())
    return " ".join([f"giajax {command} --resume {shlex.quote(str(folder))}", *added])


def _complain(sentence: str) -> None:
    _say(f"giajax: {sentence}")


_NUMBERS = ("start", "fix", "uncertainty")
_READERS: dict[str, Callable[[list[str]], Any]] = {
    **{name: partial(plain_settings, option=f"--{name}") for name in _NUMBERS},
    **{"prior": priors, "bounds": bounds, "tie": ties, "group": groups},
}
"""Parsers of the options whose text differs from their value."""

_SETTINGS = {"prior": "priors", "tie": "ties", "group": "groups"}
_SETTINGS |= {"window": "window_s", "windows_first": "windows_first_s"}
"""Settings whose option has a different name."""


class Settings(TypedDict):
    """Options of `giajax.recordings.FitSettings`, repeated here because pydantic loads slowly."""

    free: Annotated[Texts, "PATH", "Fit this parameter instead of the default parameters."]
    start: Annotated[Texts, "PATH=VALUE", "Initial value of a parameter."]
    fix: Annotated[Texts, "PATH=VALUE", "Fix a parameter at a value."]
    prior: Annotated[
        Texts,
        "PATH=VALUE+-DEVIATION",
        "Normal prior of a parameter; PATH=VALUEx/FACTOR for a log-normal prior.",
    ]
    bounds: Annotated[Texts, "PATH=LOW,HIGH", "Narrower bounds for a parameter."]
    tie: Annotated[
        Texts,
        "PATH=EXPRESSION",
        "Express a parameter in terms of others: links.mass=links.mass[0].",
    ]
    per_run: Annotated[Texts, "PATH", "Fit a separate value of this parameter for each run."]
    group: Annotated[Texts, "PATH=RUN,RUN", "Fit a common value of a parameter for these runs."]
    uncertainty: Annotated[Texts, "PATH=VALUE", "Standard deviation of a fixed parameter."]
    nuisances: Annotated[
        bool | None,
        "Fit the nuisance parameters of camera and arm with priors, or hold them fixed. "
        "[default: fit]",
        "--nuisances/--no-nuisances",
    ]
    channels: Annotated[
        Texts, "CHANNEL", "Fit only this channel, named without the unit, such as link20_z."
    ]
    hold_out: HoldOut
    window: Annotated[
        float | None,
        "S",
        "Split the runs into windows of this length with separate initial states.",
    ]
    windows_first: Annotated[
        float | None,
        "S",
        "First fit windows of this length, then fit the whole runs starting from that result.",
    ]
    starts: Annotated[
        int | None,
        "N",
        "Number of fits with different initial guesses; the best fit is kept. [default: 1]",
        1,
    ]
    spread: Annotated[
        float | None,
        "X",
        "Relative spread of the initial guesses about the first one. [default: 0.3]",
    ]
    seed: Annotated[
        int | None,
        "N",
        "Seed of the random numbers for all initial guesses except the first. [default: 0]",
        0,
    ]
    loss: Annotated[
        str | None,
        "NAME",
        "Loss function; huber, soft_l1 and student_t reduce the effect of outliers. "
        "[default: linear]",
    ]
    noise_model: Annotated[
        str | None, "NAME", "Noise model: correlated or white. [default: correlated]"
    ]
    noise_per_run: Annotated[
        bool | None,
        "Estimate the noise separately for each run, or jointly for all runs. [default: jointly]",
        "--noise-per-run/--noise-pooled",
    ]
    solver: Annotated[
        str | None, "NAME", "Integration method, such as tsit5 or springs5. [default: springs5]"
    ]
    tolerance: Annotated[
        float | None,
        "TOL",
        "Tolerance of the numerical integration. [default: chosen automatically]",
    ]
    max_iterations: Annotated[int | None, "N", "Maximum number of trial steps. [default: 50]", 1]
    budget: Annotated[
        str | None, "TIME", "Time limit such as 90s, 10m or 2h; the best result so far is kept."
    ]


def typed(given: Settings) -> "TaskKeywords":
    """Return the given settings as keywords of `FitTask.on_top`."""
    said: Any = {
        _SETTINGS.get(name, name): _READERS[name](value) if name in _READERS else value
        for name, value in cast("dict[str, Any]", given).items()
        if value not in (None, [])
    }
    return said


def named_task(
    definition: Path | None,
    again: Path | None,
    resume: Path | None,
    has_data: bool,
) -> "FitTask":
    """Return the task of a fit definition, of a result, of a journal, or of data only."""
    from ..recordings import Definition
    from ..tasks import FitTask

    if again is not None:
        if definition is not None or has_data or resume is not None:
            raise typer.BadParameter(
                "--again takes data and settings from the result: omit the other options"
            )
        return FitTask.again(again)
    if definition is not None:
        return FitTask.load(definition)
    if resume is not None and not has_data:
        return FitTask.resumed(resume)
    return FitTask(Definition())


@command(
    """\b
Examples:
  giajax fit --data run.csv
                            fit the default parameters of the model
  giajax fit --data run.csv --start air.drag_coefficient=0.8 --loss huber
                            use another initial guess and a robust loss
  giajax fit --data a.csv --data b.csv --fix joints.damping=0.05 --out both
                            fit two runs with one parameter fixed
  giajax fit --data run.csv --free joints.damping --free "links.mass[19]"
                            fit only these parameters
  giajax fit --data run.csv --free links.mass --tie "links.mass=links.mass[0]"
                            fit the same mass for all links
  giajax fit --data a.csv --data b.csv --per-run camera.delay \\
      --prior camera.delay=0+-0.05 --bounds joints.damping=0.01,1
                            fit a delay for each run, with a prior
  giajax fit --data a.csv --data b.csv --hold-out b --strict
                            validate on a held-out run
  giajax fit --data run.csv --hold-out last:0.3
                            validate on the last 30 % of the run
  giajax fit definition.toml --force
                            run a fit definition
  giajax fit long.toml --budget 2h --cores 4
                            find the best result within two hours
  giajax fit long.toml --starts 100 --workers 4
                            use 100 initial guesses and four processes
  giajax fit --resume giajax-out/long
                            continue a fit that was stopped
  giajax fit --again giajax-out/run/result.json
                            repeat a fit with the same data and settings
  giajax fit --data other.csv --from giajax-out/run
                            fit another run with a warm start

`giajax parameters` lists the names and units of parameters. A parameter with
several elements takes one VALUE for all elements, or one for each of them, such as
camera.origin=0.1,0,0.
The table and the summary are printed to standard output. The progress is
printed to standard error.

\b
Exit status: 0 converged; 1 ended without convergence (the result is
written and marked as not converged); 2 bad input or usage; 3 with --strict,
if the model is inadequate or doubtful; 4 another error; 130 interrupted,
143 by SIGTERM, 129 if the terminal was closed (the best result so far is
written). A second Ctrl-C ends the program at once.

DIR/journal.jsonl records every step. After a crash, Ctrl-C or the
end of a budget, --resume DIR continues from the last step and gives the same
result as a fit that was not stopped.
With --workers or --scheduler, other processes fit from the remaining initial
guesses after the first fit has converged.""",
    group="first",
    pictures=True,
    settings_after="data",
    old={"--config": "DEFINITION"},
)
def fit(
    definition: Annotated[
        Path | None, argument("DEFINITION", "Fit definition, a TOML file.")
    ] = None,
    data: Annotated[Paths, "RUN.csv", "A run to fit."] = None,
    rename: Renamed = None,
    begin: Annotated[
        Path | None, "RESULT", "Warm start from the result of another fit.", "--from"
    ] = None,
    again: Annotated[Path | None, "RESULT", "Repeat a fit with the same data and settings."] = None,
    cores: Cores = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Annotated[
        Path | None, "DIR", "Continue the fit whose journal is in this folder."
    ] = None,
    out: Annotated[
        Path | None, "DIR", "Output folder for the result. [default: giajax-out/RUN]"
    ] = None,
    force: Force = False,
    as_json: Json = False,
    strict: Annotated[bool, "Exit with status 3 if the model is inadequate or doubtful."] = False,
    quiet: Quiet = False,
    suspects: Annotated[bool, "Test fixed and omitted parameters after the fit."] = True,
    figures: Figures = True,
    self_test: Annotated[
        bool, "Check the standard errors by repeated fits to data with new noise."
    ] = False,
    report: Annotated[bool, "Also write report.html."] = False,
    **settings: Unpack[Settings],
) -> None:
    """Fit parameters to runs.

    Without further options, fits the drag coefficient, the pitch and yaw stiffness, and the damping
    of an arm. The columns of the runs determine the model. The sidecars of the runs determine the
    constants of the model.
    """
    from ..recordings import parse_rename

    if cores is not None:
        os.environ[CORES_VARIABLE] = str(cores)
    if resume is not None and (status := finished(resume, as_json, quiet)) is not None:
        raise typer.Exit(status)
    task = named_task(definition, again, resume, bool(data)).on_top(
        **typed(settings),
        data=data or None,
        begin=begin,
        out=out,
        rename=parse_rename(rename) if rename else None,
        origin="the command line",
    )
    if not task.data:
        where = f"{task.source} specifies no data" if task.source else "no data are given"
        raise typer.BadParameter(f"{where}: give at least one run with --data RUN.csv")

    if resume is not None and task.out.resolve() != resume.resolve():
        if out is not None:
            raise typer.BadParameter("a resumed fit continues in its folder: omit --out")
        task = task.on_top(out=resume)
    raise typer.Exit(
        run_fit(
            task,
            again=again,
            resume=resume is not None,
            force=force,
            as_json=as_json,
            quiet=quiet,
            figures=figures,
            report=report,
            self_test=self_test,
            strict=strict,
            suspects=suspects,
            workers=workers,
            scheduler=scheduler,
        )
    )
