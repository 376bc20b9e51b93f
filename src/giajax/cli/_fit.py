"""`giajax fit`: parameters of a model from recordings of it."""

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.process import CORES_VARIABLE
from ._commands import command
from ._fit_run import finished, run_fit
from ._options import Cores, Renamed, Scheduler, Workers
from ._values import bounds as limits, groups, plain_settings, priors, ties

if TYPE_CHECKING:
    from ..tasks import FitTask

# Which task the arguments of `giajax fit` name, before its options are put on top.


def named_task(
    definition: Path | None,
    config: Path | None,
    again: Path | None,
    resume: Path | None,
    has_data: bool,
) -> "FitTask":
    """The task of a fit definition, of a result, of a journal, or of data alone.

    Arguments:
        definition, config: the fit definition as argument and as option; at most one of them.
        again: the result whose numbers are to come again.
        resume: the folder whose journal is to be gone on with.
        has_data: whether there is data on the command line.
    """
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


@command("""\b
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
that converges.""")
def fit(
    definition: Annotated[
        Path | None,
        typer.Argument(metavar="FILE.toml", help="Fit definition: what to fit to what."),
    ] = None,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A run to fit. Repeat it to fit several together."),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(metavar="FILE.toml", help="The fit definition, if it is no argument."),
    ] = None,
    free: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Fit it, and not the default list. Repeatable."),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=VALUE", help="Hold a parameter at a value. Repeatable."),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=VALUE", help="Start a parameter at a value. Repeatable."),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=VALUE+-DEVIATION",
            help="What is known of it before; PATH=VALUEx/FACTOR is log-normal. Repeatable.",
        ),
    ] = None,
    bounds: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=LOW,HIGH", help="Bounds of a parameter. Repeatable."),
    ] = None,
    tie: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=EXPRESSION",
            help="Let a parameter follow from others, as in links.mass=links.mass[0]. Repeatable.",
        ),
    ] = None,
    per_run: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH", help="Fit a value of it for each run. Repeatable."),
    ] = None,
    group: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=RUN,RUN", help="Fit a value that these share. Repeatable."),
    ] = None,
    uncertainty: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=VALUE", help="Standard deviation of a held parameter. Repeatable."
        ),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Fit this channel only, without its unit: link20_z. Repeatable."
        ),
    ] = None,
    hold_out: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Judge by this and do not fit it: a run, a channel, or last (fifth). Repeatable.",
        ),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(metavar="S", help="Cut runs into windows, each with its own start."),
    ] = None,
    windows_first: Annotated[
        float | None,
        typer.Option(metavar="S", help="Fit such windows first, and whole runs from there."),
    ] = None,
    starts: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Fit from so many starts and keep the best end."),
    ] = None,
    spread: Annotated[
        float | None,
        typer.Option(metavar="X", help="How far the other starts are away; 0.3 is 30 percent."),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", min=0, help="Of the other starts.")
    ] = None,
    loss: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="linear (default), or huber or soft_l1 for outliers."),
    ] = None,
    noise_model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="correlated (default: looks for a memory of the noise), or white."
        ),
    ] = None,
    noise_per_run: Annotated[
        bool | None,
        typer.Option(
            "--noise-per-run/--noise-pooled",
            show_default=False,
            help="Estimate the noise in each run by itself, or (default) in all together.",
        ),
    ] = None,
    rename: Renamed = None,
    solver: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Integration method (springs5), such as tsit5."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="TOL", help="Tolerance of the integration (chosen by what it moves)."),
    ] = None,
    max_iterations: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Trial steps before the fit gives up (50)."),
    ] = None,
    budget: Annotated[
        str | None,
        typer.Option(
            metavar="TIME", help="End with the best so far when it is over: 90s, 10m, 2h."
        ),
    ] = None,
    begin: Annotated[
        Path | None,
        typer.Option("--from", metavar="RESULT", help="Start where another fit ended."),
    ] = None,
    again: Annotated[
        Path | None,
        typer.Option(
            metavar="RESULT", help="The fit of a result once more: same data, same numbers."
        ),
    ] = None,
    cores: Cores = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Go on with the fit whose journal is in this folder."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Where the result goes (giajax-out/RUN, by the run's name)."
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write over the result of another fit.")
    ] = False,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print result.json instead of the tables.")
    ] = False,
    strict: Annotated[
        bool,
        typer.Option("--strict", help="End with status 3 where the model does not fit the data."),
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    suspects: Annotated[
        bool,
        typer.Option(
            "--suspects/--no-suspects", help="Of an inadequate model, ask what it leaves out."
        ),
    ] = True,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw pictures of the result.")
    ] = True,
    self_test: Annotated[
        bool,
        typer.Option(
            "--self-test", help="Repeat the fit with noise drawn anew: are its errors right?"
        ),
    ] = False,
    report: Annotated[
        bool, typer.Option("--report", help="Write report.html, a page for a browser, too.")
    ] = False,
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
        data=data or None,
        free=free or None,
        start=plain_settings(start, "--start"),
        fix=plain_settings(fix, "--fix"),
        priors=priors(prior),
        bounds=limits(bounds),
        ties=ties(tie),
        per_run=per_run or None,
        groups=groups(group),
        uncertainty=plain_settings(uncertainty, "--uncertainty"),
        channels=channels or None,
        hold_out=hold_out or None,
        window_s=window,
        windows_first_s=windows_first,
        starts=starts,
        spread=spread,
        seed=seed,
        loss=loss,
        noise_model=noise_model,
        noise_per_run=noise_per_run,
        solver=solver,
        tolerance=tolerance,
        max_iterations=max_iterations,
        budget=budget,
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
