"""`giajax fit`: parameters of a model from recordings of it.

This file is longer than 200 lines because every option of the command stands in it with its help.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ._fit_output import show_files, show_result, write_or_print
from ._progress import Progress
from ._values import plain_settings

if TYPE_CHECKING:
    from ..tasks import FitTask

STATUS = {"converged": 0, "not_converged": 1, "interrupted": 130}

EXAMPLES = """\b
Examples:
  giajax fit --data run.csv
  giajax fit --data run.csv --start air.drag_coefficient=0.8 --loss huber
  giajax fit --data a.csv --data b.csv --fix joints.damping=0.05 --out both
  giajax fit --data run.csv --free joints.damping --free "links.mass[19]"
  giajax fit definition.toml --force

Parameters are called as `giajax parameters` lists them, in the units that it lists;
one with several elements has one VALUE for all, or one for each: camera.origin=0.1,0,0.
The table and the summary go to standard output, progress to standard error.

\b
Exit status: 0 converged; 1 ended without convergence (the result is
written and says so); 2 bad input or usage; 130 interrupted (the best point
so far is written)."""


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
        typer.Option(
            metavar="PATH", help="Fit this parameter; replaces the default list. Repeatable."
        ),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=VALUE", help="Hold a parameter at a value. Repeatable."),
    ] = None,
    start: Annotated[
        list[str] | None,
        typer.Option(metavar="PATH=VALUE", help="Start a parameter at a value. Repeatable."),
    ] = None,
    uncertainty: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PATH=VALUE",
            help="Standard deviation of a held parameter, for the systematic errors. Repeatable.",
        ),
    ] = None,
    channels: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Fit this channel only, without its unit: link20_z. Repeatable."
        ),
    ] = None,
    window: Annotated[
        float | None,
        typer.Option(
            metavar="S", help="Cut the runs into windows of this length, each with its own start."
        ),
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
    rename: Annotated[
        list[str] | None,
        typer.Option(metavar="OLD=NEW", help="Read column OLD of the runs as NEW. Repeatable."),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Integration method, such as tsit5, springs5."),
    ] = None,
    tolerance: Annotated[
        float | None,
        typer.Option(metavar="TOL", help="Tolerance of the integration (1e-7)."),
    ] = None,
    max_iterations: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Trial steps before the fit gives up (50)."),
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
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
    suspects: Annotated[
        bool,
        typer.Option(
            "--suspects/--no-suspects",
            help="Where the model is inadequate, ask what the residuals ask for.",
        ),
    ] = True,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw pictures of the result.")
    ] = True,
) -> None:
    """Fit parameters to runs.

    Without further options: drag coefficient, pitch and yaw stiffness and damping of an arm.
    The columns of the runs decide the model, their sidecars its constants.
    """
    from ..runs import parse_rename

    task = _task(definition, config).on_top(
        data=data or None,
        free=free or None,
        start=plain_settings(start, "--start"),
        fix=plain_settings(fix, "--fix"),
        uncertainty=plain_settings(uncertainty, "--uncertainty"),
        channels=channels or None,
        window_s=window,
        starts=starts,
        spread=spread,
        seed=seed,
        loss=loss,
        solver=solver,
        tolerance=tolerance,
        max_iterations=max_iterations,
        out=out,
        rename=parse_rename(rename or []),
        origin="the command line",
    )
    if not task.data:
        where = f"{task.source} names no data" if task.source else "there is no data"
        raise typer.BadParameter(f"{where}: give at least one run with --data RUN.csv")

    from ._jax import configure

    configure()
    from ..fitting import column_factors
    from ..report import check_figures, check_folder, write_figures, write_result
    from ..study import choice_hint

    ready = task.prepare()
    check_figures(ready.setup.model, task.definition)
    check_folder(task.out, ready.runs, ready.setup.config, force=force)
    progress = None if quiet else Progress(column_factors(ready.setup.model))
    announce = None if progress is None else progress.announce
    result = ready.run(progress, announce, suspects=suspects)
    if progress is not None:
        progress.end()
    files = write_or_print(
        result, lambda: write_result(result, ready.runs, task.out, figures=False)
    )
    if as_json:
        typer.echo(result.to_json(), nl=False)
    elif not quiet:
        show_result(result, task.definition)
    # What a person waits for is there; drawing takes a second or two.
    if figures:
        files += write_figures(result, ready.runs, task.out)
    if not (as_json or quiet):
        show_files(files)
        if hint := choice_hint(ready.runs, [str(path) for path in task.data]):
            print(f"\n{hint}")
    raise typer.Exit(STATUS[result.status])


def _task(definition: Path | None, config: Path | None) -> "FitTask":
    from ..runs import Definition
    from ..tasks import FitTask

    if definition is not None and config is not None:
        raise typer.BadParameter(
            "there are two fit definitions: give one, as argument or by --config, not both"
        )
    source = definition or config
    return FitTask(Definition()) if source is None else FitTask.load(source)
