"""`giajax explain`: stepwise search for effects that runs need beyond the assumed model."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Unpack

import typer

from ..runtime.process import configure, is_stopped, stop_if_asked, stopped_status
from ..runtime.text import InputError
from ._commands import (
    Figures,
    Force,
    Json,
    Paths,
    Quiet,
    Renamed,
    argument,
    command,
    say_progress,
    say_written,
)
from ._fit import Progress, Settings, named_task, resumes, show_result, typed
from ._on_result import show

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..tasks import FitTask

FITS, FIRST, JOURNAL = "fits", "first.json", "explain.jsonl"
PAGE = "explain.html"


@command(
    """\b
Examples:
  giajax explain --data run.csv --out why
                            find the effects that the model omits
  giajax explain --data run.csv --out why --budget 15m --tries 1
                            find the best model within 15 minutes
  giajax explain --data a.csv --data b.csv --validation c.csv
                            explain two runs, and validate on a third run
  giajax explain --data run.csv --free air.drag_coefficient --loss huber
                            start from a fit with other options
  giajax explain --resume why
                            continue a stopped explanation

The command fits the model as `giajax fit` does and tests the residuals. In each
step, it then adds each of the most likely suspects to the model, fits these
models, keeps the best one, and removes effects that are no longer needed.
Each step is validated on the last fifth of each run, or on the --validation runs. The final
model is fitted to all runs of --data. All other options are those of `giajax fit`.

DIR contains the final result in the format of `giajax fit`, explain.json with
the steps, the parameters and the models that fit nearly as well as the final
model, explain.html, and each fit in DIR/fits. After Ctrl-C or at the end of
--budget, the same files are written for the last step, and --resume DIR
continues from this step. --force repeats the whole explanation.

\b
Exit status: 0 the final fit converged; 1 it did not; 2 bad input or usage;
130 interrupted, 143 by SIGTERM.""",
    group="study",
    pictures=True,
    settings_after="data",
    old={"--config": "DEFINITION", "--page": "--report", "--no-page": "--no-report"},
)
def explain(
    definition: Annotated[
        Path | None, argument("DEFINITION", "Fit definition; see 'giajax fit'.")
    ] = None,
    data: Annotated[Paths, "RUN.csv", "A run to explain."] = None,
    validation: Annotated[Paths, "RUN.csv", "A run for validation."] = None,
    rename: Renamed = None,
    max_steps: Annotated[int | None, "N", "Maximum number of steps. [default: 10]", 0] = None,
    tries: Annotated[
        int | None, "N", "Number of suspects fitted in each step. [default: 3]", 1
    ] = None,
    resume: Annotated[Path | None, "DIR", "Continue the explanation in this folder."] = None,
    out: Annotated[Path | None, "DIR", "Output folder. [default: giajax-out/RUN-explained]"] = None,
    force: Force = False,
    report: Annotated[bool, "Write explain.html."] = True,
    figures: Figures = True,
    as_json: Json = False,
    quiet: Quiet = False,
    **settings: Unpack[Settings],
) -> None:
    """Find the effects that a model lacks, and fit them.

    Tests for camera delay, wind, friction, swapped axes, outliers and every other effect that the
    model supports.
    """
    from ..recordings import parse_rename, write_files
    from ..report import check_page

    said = typed(settings)
    budget = said.pop("budget", None)
    if resume is not None:
        if definition or data or validation or rename or force or out is not None or said:
            raise typer.BadParameter(
                "--resume takes data and settings from the folder: omit the other options"
            )
        task, folder = _resumed(resume), resume
    else:
        task = named_task(definition, None, None, bool(data)).on_top(
            **said,
            data=data or None,
            validation=validation or None,
            rename=parse_rename(rename) if rename else None,
            origin="the command line",
        )
        if not task.data:
            raise typer.BadParameter("no data are given: give at least one run with --data RUN.csv")
        named = task.out
        folder = named.with_name(f"{named.name}-explained") if out is None else out
        task = task.on_top(out=folder)
    if budget:
        task = task.on_top(budget=budget, origin="the command line")
    seconds = task.definition.fit.budget_s
    if report:
        try:
            check_page(folder / PAGE, force=force or resume is not None)
        except InputError as error:
            raise InputError(f"{error}, or omit the page with --no-report") from None
    configure()
    from ..fitting import Budget
    from ..report import report_page, write_result
    from ..studies import explain as explained
    from ..tasks import locked

    left = None if seconds is None else Budget(seconds)
    ready = task.prepare()
    with locked(folder):
        first = _begun(ready, folder, resumed=resume is not None, force=force, quiet=quiet)
        late = first.reason == "budget"
        found = explained(
            first,
            ready.runs,
            validation=ready.validation,
            held_out=ready.held_out_runs,
            max_steps=max_steps,
            tries=tries,
            budget_s=None if left is None else 0.0 if late else max(left.left(), 0.0),
            folder=folder,
            say=say_progress(quiet),
        )
        record, result = found.record, found.result
        files = write_result(result, found.runs, folder, figures=figures and not is_stopped())
        written = {folder / record.file: record.to_json().encode()}
        write_files(written, force=True)
        if report:
            # The report has a section for each record beside the result.
            source = folder / "result.json"
            written[folder / PAGE] = report_page(result, found.runs, source=source)
            write_files(written, force=True)
    if as_json:
        typer.echo(record.to_json(), nl=False)
    elif not quiet:
        show(record, result)
        print()
        show_result(result, task.definition)
        say_written(folder, [path.name for path in (*written, *files)])
    if record.ended in ("budget", "interrupted"):
        # A first fit that was stopped is not stored, so it cannot be continued.
        begun = (folder / FITS / FIRST).exists()
        how = f"; to continue: {resumes('explain', folder)}" if begun else ""
        typer.echo(f"giajax: {record.ending}{how}", err=True)
    if is_stopped():
        raise typer.Exit(stopped_status())
    raise typer.Exit(0 if result.status == "converged" else 1)


def _resumed(folder: Path) -> "FitTask":
    """Return the task of a stopped explanation; raise an InputError if there is none."""
    from ..tasks import FitTask

    if not (folder / FITS / FIRST).exists():
        raise InputError(
            f"{folder} contains no explanation to continue: give the folder of an explanation"
        )
    return FitTask.again(folder / FITS / FIRST, home=folder).on_top(out=folder)


def _begun(ready: Any, folder: Path, *, resumed: bool, force: bool, quiet: bool) -> "FitResult":
    """Return the first fit of a task; it is computed and stored unless it is resumed."""
    from ..fitting import load_result
    from ..recordings import make_folder, write_files
    from ..report import check_folder

    path = folder / FITS / FIRST
    if resumed:
        return load_result(path)
    if path.exists() and not force:
        raise InputError(
            f"{folder} already contains an explanation: continue with "
            f"{resumes('explain', folder)}, give another --out, or use --force to start again"
        )
    if not force and any((folder / FITS).glob("*")):
        raise InputError(
            f"{folder / FITS} contains files that do not belong to an explanation: give another "
            "--out, or use --force to keep these files and write into the same folder"
        )
    check_folder(folder, ready.runs, ready.setup.config, force=force)
    for old in (path, folder / JOURNAL, *(folder / FITS).glob("[0-9][0-9][0-9].json")):
        old.unlink(missing_ok=True)
    result = ready.run(stop_if_asked if quiet else Progress(ready.setup))
    if result.status == "interrupted" or result.reason == "budget":
        return result
    # The budget did not end this fit, and must not apply when the explanation is continued.
    config = {name: item for name, item in result.config.items() if name != "budget_s"}
    if uncertainty := ready.definition.fit.uncertainty:
        config["uncertainty"] = dict(uncertainty)
    result = dataclasses.replace(result, config=config)
    make_folder(folder / FITS)
    write_files({path: result.to_json().encode()}, force=True)
    # Return the fit in the form in which a continued explanation reads it.
    return load_result(path)
