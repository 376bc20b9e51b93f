"""`giajax fit` and `sweep`: parameters of a model from recordings of it, once or many times."""

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypedDict, Unpack, cast

import typer

from ..runtime.process import CORES_VARIABLE, configure
from ..runtime.signals import stopped_status
from ._commands import Paths, Texts, argument, command
from ._fit_run import finished, run_fit
from ._options import Cores, ManyProgress, Renamed, Scheduler, Workers, print_table
from ._values import bounds, groups, plain_settings, priors, ties

if TYPE_CHECKING:
    import polars as pl

    from ..recordings import TaskKeywords
    from ..tasks import FitTask, Plan

_NUMBERS = ("start", "fix", "uncertainty")
_READERS: dict[str, Callable[[list[str]], Any]] = {
    **{name: partial(plain_settings, option=f"--{name}") for name in _NUMBERS},
    **{"prior": priors, "bounds": bounds, "tie": ties, "group": groups},
}
"""What reads the words of an option, where they are not the value itself."""

_SETTINGS = {"prior": "priors", "tie": "ties", "group": "groups"}
_SETTINGS |= {"window": "window_s", "windows_first": "windows_first_s"}
"""Names of settings whose option is called otherwise."""


class _Settings(TypedDict):
    """The options of `giajax.recordings.FitSettings`, which would take pydantic to import."""

    free: Annotated[Texts, "PATH", "Fit it, and not the default list."]
    start: Annotated[Texts, "PATH=VALUE", "Start a parameter at a value."]
    fix: Annotated[Texts, "PATH=VALUE", "Hold a parameter at a value."]
    prior: Annotated[
        Texts, "PATH=VALUE+-DEVIATION", "Known before; PATH=VALUEx/FACTOR is log-normal."
    ]
    bounds: Annotated[Texts, "PATH=LOW,HIGH", "Bounds of a parameter, within those that it has."]
    tie: Annotated[Texts, "PATH=EXPRESSION", "Let it follow from others: links.mass=links.mass[0]."]
    per_run: Annotated[Texts, "PATH", "Fit a value of it for each run."]
    group: Annotated[Texts, "PATH=RUN,RUN", "Fit a value that these share."]
    uncertainty: Annotated[Texts, "PATH=VALUE", "Standard deviation of a held parameter."]
    channels: Annotated[Texts, "NAME", "Fit this channel only, without its unit: link20_z."]
    hold_out: Annotated[
        Texts, "NAME", "Judge by it, do not fit it: a run, a channel, last (fifth)."
    ]
    window: Annotated[float | None, "S", "Cut runs into windows, each with its own start."]
    windows_first: Annotated[float | None, "S", "Fit such windows first, then whole runs."]
    starts: Annotated[int | None, "N", "Fit from so many starts and keep the best end (1).", 1]
    spread: Annotated[float | None, "X", "How far the other starts are away, as a share (0.3)."]
    seed: Annotated[int | None, "N", "Of the other starts (0).", 0]
    loss: Annotated[
        str | None, "NAME", "How residuals count; for outliers huber, soft_l1, student_t (linear)."
    ]
    noise_model: Annotated[str | None, "NAME", "correlated where it is, or white (correlated)."]
    noise_per_run: Annotated[
        bool | None,
        "Estimate noise in each run, or (default) in all.",
        "--noise-per-run/--noise-pooled",
    ]
    solver: Annotated[str | None, "NAME", "Integration method (springs5), such as tsit5."]
    tolerance: Annotated[float | None, "TOL", "Of the integration (chosen by what it moves)."]
    max_iterations: Annotated[int | None, "N", "Trial steps before the fit gives up (50).", 1]
    budget: Annotated[str | None, "TIME", "End with the best so far after 90s, 10m, 2h."]


def _typed(given: _Settings) -> "TaskKeywords":
    """The settings that were typed, as keywords of `FitTask.on_top`."""
    said: Any = {
        _SETTINGS.get(name, name): _READERS[name](value) if name in _READERS else value
        for name, value in cast("dict[str, Any]", given).items()
        if value not in (None, [])
    }
    return said


def named_task(
    definition: Path | None,
    config: Path | None,
    again: Path | None,
    resume: Path | None,
    has_data: bool,
) -> "FitTask":
    """The task of a fit definition, of a result, of a journal, or of data alone."""
    from ..recordings import Definition
    from ..tasks import FitTask

    if definition is not None and config is not None:
        raise typer.BadParameter(
            "there are two fit definitions: give one, as argument or by --config, not both"
        )
    source = definition or config
    if again is not None:
        if source is not None or has_data or resume is not None:
            raise typer.BadParameter(
                "--again takes data and settings from the result: leave out the others"
            )
        return FitTask.again(again)
    if source is not None:
        return FitTask.load(source)
    if resume is not None and not has_data:
        return FitTask.resumed(resume)
    return FitTask(Definition())


@command(
    """\b
Examples:
  giajax fit --data run.csv
  giajax fit --data run.csv --start air.drag_coefficient=0.8 --loss huber
  giajax fit --data a.csv --data b.csv --fix joints.damping=0.05 --out both
  giajax fit --data run.csv --free joints.damping --free "links.mass[19]"
  giajax fit --data run.csv --free links.mass --tie "links.mass=links.mass[0]"
  giajax fit --data a.csv --data b.csv --per-run camera.delay \\
      --prior camera.delay=0+-0.05 --bounds joints.damping=0.01,1
  giajax fit --data a.csv --data b.csv --hold-out b --strict
  giajax fit --data run.csv --hold-out last:0.3
  giajax fit definition.toml --force
  giajax fit long.toml --budget 2h --cores 4
  giajax fit long.toml --starts 100 --workers 4
  giajax fit --resume giajax-out/long
  giajax fit --again giajax-out/run/result.json
  giajax fit --data other.csv --from giajax-out/run

Parameters are called as `giajax parameters` lists them, in the units that it lists;
one with several elements has one VALUE for all, or one for each: camera.origin=0.1,0,0.
The table and the summary go to standard output, progress to standard error.

\b
Exit status: 0 converged; 1 ended without convergence (the result is
written and says so); 2 bad input or usage; 3 with --strict, where the model
does not describe the data; 130 interrupted, 143 by SIGTERM (the best point so
far is written). A second Ctrl-C ends at once.

\b
While it runs, DIR/journal.jsonl has every step. After a crash, Ctrl-C or the
end of a budget, --resume DIR goes on from there to the same numbers.
With --workers or --scheduler other processes fit the starts after the first
that converges.""",
    settings_after="config",
)
def fit(
    definition: Annotated[Path | None, argument("FILE.toml", "What to fit to what.")] = None,
    data: Annotated[Paths, "RUN.csv", "A run to fit, together with others."] = None,
    config: Annotated[Path | None, "FILE.toml", "The fit definition, if it is no argument."] = None,
    rename: Renamed = None,
    begin: Annotated[Path | None, "RESULT", "Start where another fit ended.", "--from"] = None,
    again: Annotated[Path | None, "RESULT", "A fit once more: same data, same numbers."] = None,
    cores: Cores = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Annotated[Path | None, "DIR", "Go on with the fit whose journal is there."] = None,
    out: Annotated[Path | None, "DIR", "Where the result goes (giajax-out/RUN)."] = None,
    force: Annotated[bool, "Write over the result of another fit."] = False,
    as_json: Annotated[bool, "--json", "Print result.json instead of the tables."] = False,
    strict: Annotated[bool, "End with status 3 where the model does not fit the data."] = False,
    quiet: Annotated[bool, "Print errors only."] = False,
    suspects: Annotated[bool, "Of an inadequate model, ask what it leaves out."] = True,
    figures: Annotated[bool, "Draw pictures of the result."] = True,
    self_test: Annotated[bool, "Repeat it with noise drawn anew: are its errors right?"] = False,
    report: Annotated[bool, "Write report.html, a page for a browser, too."] = False,
    **settings: Unpack[_Settings],
) -> None:
    """Fit parameters to runs.

    Without further options: drag coefficient, pitch and yaw stiffness and damping of an arm.
    The columns of the runs decide the model, their sidecars its constants.
    """
    from ..recordings import parse_rename

    if cores is not None:
        os.environ[CORES_VARIABLE] = str(cores)
    if resume is not None and (status := finished(resume, as_json, quiet)) is not None:
        raise typer.Exit(status)
    task = named_task(definition, config, again, resume, bool(data)).on_top(
        **_typed(settings),
        data=data or None,
        begin=begin,
        out=out,
        rename=parse_rename(rename or []),
        origin="the command line",
    )
    if not task.data:
        where = f"{task.source} names no data" if task.source else "there is no data"
        raise typer.BadParameter(f"{where}: give at least one run with --data RUN.csv")

    if resume is not None and task.out.resolve() != resume.resolve():
        if out is not None:
            raise typer.BadParameter("a fit that is resumed goes on in its folder: leave out --out")
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


_ROWS = 20
_ENDINGS = ("converged", "not_converged", "failed", "stopped")


@command("""\b
Examples:
  giajax sweep plan.toml --dry-run
  giajax sweep plan.toml --workers 4
  giajax sweep plan.toml --out masses --scheduler tcp://head:8786

\b
A plan names a fit definition and what differs between its fits:
  fit = "base_step.toml"
  [grid]
  loss = ["linear", "huber"]
  [grid.fix]
  "links.mass" = { from = 0.04, to = 0.06, count = 5 }

\b
The same command goes on where a sweep was stopped or killed, and after the plan
has grown. DIR/sweep.parquet has one row a fit, DIR/fits a file of each.

\b
Exit status: 0 each fit was done; 1 one could not be (its row says why);
2 bad input or usage; 130 interrupted, 143 by SIGTERM.""")
def sweep(
    plan: Annotated[Path, argument("PLAN.toml", "What to fit; see below.")],
    out: Annotated[Path | None, "DIR", "Where the table goes (giajax-out/PLAN)."] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    dry_run: Annotated[bool, "List what would be fitted, and fit nothing."] = False,
    force: Annotated[bool, "Write over the table of another plan."] = False,
    quiet: Annotated[bool, "Print errors only."] = False,
) -> None:
    """Fit one definition many times: with other values, runs or options each time.

    On one core, on several (--workers), or on the machines of a cluster (--scheduler).
    """
    from ..runtime.execution import open_executor
    from ..tasks import TABLE, Plan, sweep as sweep_plan

    planned = Plan.load(plan)
    folder = planned.folder if out is None else out
    if dry_run:
        _list(planned, folder)
        return
    with open_executor(workers, scheduler) as executor:
        if scheduler is None and workers in (None, 1):
            configure()
        progress = None if quiet else ManyProgress("fits")
        table = sweep_plan(planned, out=folder, executor=executor, progress=progress, force=force)
    counts = {ending: int((table["status"] == ending).sum()) for ending in _ENDINGS}
    if not quiet:
        _show(table, planned.columns)
        said = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)
        print(f"\n{len(table)} fits: {said}\nwrote {folder / TABLE}")
    if counts["stopped"]:
        typer.echo("giajax: what is done is kept: the same command goes on", err=True)
        raise typer.Exit(stopped_status())
    raise typer.Exit(1 if counts["failed"] else 0)


def _list(plan: "Plan", folder: Path) -> None:
    """The fits of a plan, and which of them are done."""
    from ..runtime.tasks import read_outcome
    from ..tasks import FITS

    rows, known = [], 0
    for number, (case, task) in enumerate(zip(plan.cases, plan.tasks(), strict=True), 1):
        done = read_outcome(folder / FITS, task.key) is not None
        known += done
        values = (case.get(name) for name in plan.columns)
        rows.append((number, *values, "done" if done else ""))
    print_table(["fit", *plan.columns, ""], rows)
    print(f"\n{len(rows)} fits into {folder}, {known} of them done already")


def _show(table: "pl.DataFrame", columns: list[str]) -> None:
    """The first rows: what differs, what was found, and how well it describes the data."""
    values = [name for name in table.columns if name.startswith("value.")]
    shown = [*columns, "status", *values, "verdict"]
    rows = table.head(_ROWS).select(shown).rows()
    headings = [name.removeprefix("value.") if name in values else name for name in shown]
    print_table(headings, rows, left=0)
    if len(table) > _ROWS:
        print(f"... and {len(table) - _ROWS} more")
    failed = table.filter(table["status"] == "failed")["message"].unique(maintain_order=True)
    for message in failed.head(3):
        print(f"failed: {message}")
