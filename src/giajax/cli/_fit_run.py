"""`giajax fit` once its options are read: fit with a journal, write, show."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from .._signals import stopped_status
from ._bootstrap import self_test as repeated_fit
from ._fit_output import show_diagnosis, show_files, show_result, write_or_print
from ._many import forget_starts, workers_of_starts
from ._progress import Progress, in_windows, of_windows, stop_if_asked
from ._time_left import TimeLeft

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..tasks import FitTask

_STATUS = {"converged": 0, "not_converged": 1}

# With --strict, of a fit whose model does not describe the data.
_INADEQUATE = 3


def finished(folder: Path, as_json: bool, quiet: bool) -> int | None:
    """Say of a fit that has ended that there is nothing to go on with.

    Arguments:
        folder: to be gone on with.
        as_json, quiet: the options of these names.

    Returns:
        The status with which it ended; None where there is a journal, or no such result.
    """
    from ..tasks import read_journal, stored_result

    path = folder / "result.json"
    if read_journal(folder) is not None or not path.exists():
        return None
    _, record = stored_result(path)
    if record["status"] not in _STATUS:
        return None
    if as_json:
        typer.echo(path.read_text(encoding="utf-8"), nl=False)
    if not quiet:
        typer.echo(
            f"the fit in {folder} has ended, and there is nothing to go on with: "
            f"{record['message']}",
            err=as_json,
        )
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
    """Fit a task, write its result and show it.

    Arguments:
        task: what to fit to what.
        again: the result whose numbers are to come again.
        resume: go on with the journal in the task's folder.
        force, as_json, quiet, figures, report, self_test, strict, suspects, workers, scheduler:
            the options of these names.

    Returns:
        The exit status.
    """
    from ._jax import configure

    configure()
    from ..fitting import column_factors
    from ..report import (
        PAGE,
        check_figures,
        check_folder,
        check_page,
        report_page,
        write_figures,
        write_result,
    )
    from ..runs import write_files
    from ..study import choice_hint
    from ..tasks import begun, compared, stored_result, version_note

    task = begun(task, *((lambda _: stop_if_asked,) if quiet else (in_windows, of_windows)))
    ready = task.prepare()
    check_figures(ready.setup.model, task.definition)
    check_folder(task.out, ready.runs, ready.setup.config, force=force)
    if report:
        check_page(task.out / PAGE, force=force)
    before = None if again is None or task.resolved is None else stored_result(again)[1]
    starts = task.definition.fit.starts or 1
    with (
        ready.kept_in(task.out, resume=resume, force=force, complain=_complain) as journal,
        workers_of_starts(workers, scheduler, starts, task.out) as others,
    ):
        versions = journal.head["versions"] if before is None else before["versions"]
        if note := version_note(versions):
            _complain(note)
        progress = None if quiet else Progress(column_factors(ready.setup.model), _left(task))
        if progress is not None and resume:
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
            progress.end()
        files = write_or_print(
            result, lambda: write_result(result, ready.runs, task.out, figures=False)
        )
        journal.settle(result)
        goes_on = journal.path.exists()
        if not goes_on:
            forget_starts(task.out)
    if not (as_json or quiet):
        show_result(result, task.definition)
        if before is not None:
            print(f"{'again':<20}{compared(result, before)}")
    # The fit itself is shown and on disk by now: these tests compile a program of their own.
    asked = ready.diagnosed(result, suspects=suspects)
    if asked is not result:
        files = write_or_print(
            asked, lambda: write_result(asked, ready.runs, task.out, figures=False)
        )
    if as_json:
        typer.echo(asked.to_json(), nl=False)
    elif not quiet:
        show_diagnosis(asked)
    # What a person waits for is there; drawing takes a second or two.
    if figures:
        files += write_figures(result, ready.runs, task.out, held_out=ready.held_out_runs)
    if self_test:
        files += repeated_fit(result, ready.runs, task.out, shown=not (as_json or quiet))
    if report:
        page = report_page(
            asked, ready.runs, held_out=ready.held_out_runs, source=task.out / "result.json"
        )
        write_files({task.out / PAGE: page}, force=True)
        files.append(task.out / PAGE)
    if not (as_json or quiet):
        show_files(files)
        if goes_on:
            print(f"\n{_go_on(task)}{_with_more(result)}")
        if hint := choice_hint(ready.runs, [str(path) for path in task.data]):
            print(f"\n{hint}")
    if strict and result.verdict.status == "inadequate":
        return _INADEQUATE
    return _STATUS.get(result.status, stopped_status())


def _go_on(task: "FitTask") -> str:
    """How a fit that was stopped is gone on with."""
    return f"to go on with it: giajax fit --resume {shlex.quote(str(task.out))}"


def _with_more(result: "FitResult") -> str:
    """The option without which a fit that had its iterations would end again at once."""
    if result.status != "not_converged" or "budget_s" in result.config:
        return ""
    return f" --max-iterations {2 * result.config['max_iterations']}"


def _complain(sentence: str) -> None:
    typer.echo(f"giajax: {sentence}", err=True)


def _left(task: "FitTask") -> TimeLeft:
    """What says how long it may still take."""
    from ..fitting import MAX_ITERATIONS
    from ..runs import seconds_of

    settings = task.definition.fit
    return TimeLeft(
        settings.max_iterations or MAX_ITERATIONS,
        settings.starts or 1,
        None if settings.budget is None else seconds_of(settings.budget),
    )
