"""`giajax fit`: parameters of an arm from recordings of it."""

import dataclasses
import math
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration
    from ..runs import Definition

STATUS = {"converged": 0, "not_converged": 1, "interrupted": 130}

EXAMPLES = """\b
Examples:
  giajax fit --data run.csv
  giajax fit --data run.csv --start air.drag_coefficient=0.8 --loss huber
  giajax fit --data a.csv --data b.csv --fix joints.damping=0.05 --out both
  giajax fit --data run.csv --free joints.damping --free "links.mass[19]"
  giajax fit definition.toml --force

Parameters are called as `giajax parameters` lists them, in the units that it lists.
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
        typer.Option(metavar="FILE.toml", help="The fit definition, if not given as argument."),
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
    max_iterations: Annotated[
        int, typer.Option(metavar="N", min=1, help="Trial steps before the fit gives up.")
    ] = 50,
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
) -> None:
    """Fit parameters to runs.

    Without further options: drag coefficient, pitch and yaw stiffness and damping of an arm.
    The columns of the runs decide the model, their sidecars its constants.
    """
    from ..runs import Definition, parse_rename

    if definition is not None and config is not None:
        raise typer.BadParameter("give the fit definition as argument or by --config, not both")
    source = definition or config
    stated = Definition() if source is None else Definition.load(source)
    asked = {"free": free, "fix": _values(fix, "--fix"), "start": _values(start, "--start")}
    plain = {
        "channels": channels,
        "window_s": window,
        "starts": starts,
        "spread": spread,
        "seed": seed,
        "loss": loss,
    }
    given = {key: value for key, value in plain.items() if value is not None and value != []}
    stated = _on_top(stated, asked, given)
    paths = data or [_beside(source, name) for name in stated.fit.data or []]
    if not paths:
        where = f"{source} names no data" if source else "no data is given"
        raise typer.BadParameter(f"{where}: give at least one run with --data RUN.csv")
    renamed = parse_rename(rename or [])
    folder = out or stated.fit.out or Path("giajax-out") / (source or paths[0]).stem

    from ._jax import configure

    configure()
    from ..fitting import configuration, fit, prediction_errors
    from ..models import model_for
    from ..report import check_figures, check_folder, write_result
    from ..runs import read_runs
    from ..study import choice_hint, multi_start

    runs = read_runs(paths, stated, rename=renamed)
    others = [_beside(source, name) for name in stated.fit.validation or []]
    validation = read_runs(others, stated, rename=renamed)
    model = model_for(runs)
    wanted: dict[str, Any] = {
        "free": stated.fit.free,
        "start": stated.fit.start,
        "fix": stated.fit.fix,
        "loss": stated.fit.loss or "linear",
    }
    check_figures(model, stated)
    check_folder(folder, runs, configuration(model, runs, **wanted), force=force)
    progress = None if quiet else _Progress()
    wanted |= {"max_iterations": max_iterations, "progress": progress}
    count = stated.fit.starts or 1
    if count == 1:
        result = fit(model, runs, **wanted)
    else:
        result = multi_start(
            model,
            runs,
            starts=count,
            spread=stated.fit.spread or 0.3,
            seed=stated.fit.seed or 0,
            announce=None if progress is None else progress.announce,
            **wanted,
        )
    if progress is not None:
        progress.end()
    errors = [prediction_errors(result.model, run) for run in validation]
    result = dataclasses.replace(result, validation=errors)
    files = write_result(result, runs, folder)
    if as_json:
        typer.echo(result.to_json(), nl=False)
    elif not quiet:
        _show(result, stated, files)
        if hint := choice_hint(runs, [str(path) for path in paths]):
            print(f"\n{hint}")
    raise typer.Exit(STATUS[result.status])


def _values(pairs: list[str] | None, option: str) -> dict[str, float]:
    values: dict[str, float] = {}
    for pair in pairs or []:
        path, _, text = pair.partition("=")
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not path or not math.isfinite(value):
            raise typer.BadParameter(f"{option} '{pair}' must be PATH=VALUE, VALUE a number")
        if path in values:
            raise typer.BadParameter(f"{option} gives '{path}' twice: give it once")
        values[path] = value
    return values


def _on_top(stated: "Definition", asked: dict[str, Any], plain: dict[str, Any]) -> "Definition":
    """The definition with what the command line says on top, path by path."""
    from ..runs import Definition

    below = stated.fit
    free = below.free if asked["free"] is None else asked["free"]
    starts, fixes = dict(below.start or {}), dict(below.fix or {})
    # The command line's word on a parameter undoes what the definition says of the same one.
    for path in asked["fix"]:
        starts.pop(path, None)
        if not asked["free"] and free is not None:
            free = [name for name in free if name != path]
    for path in (*asked["start"], *(asked["free"] or [])):
        fixes.pop(path, None)
    said = {"start": starts | asked["start"], "fix": fixes | asked["fix"], "free": free, **plain}
    given = stated.given()
    return Definition.parse({**given, "fit": {**given.get("fit", {}), **said}}, "the command line")


def _beside(source: Path | None, name: str) -> Path:
    """The data of a definition, which are named relative to it."""
    return Path(name) if source is None else source.parent / name


class _Progress:
    """One line an iteration on standard error, as it happens."""

    def __init__(self) -> None:
        self._say("compiling ...")
        self._headed = False

    def __call__(self, iteration: "Iteration") -> None:
        values = [f"{value:.5g}" for value in iteration.parameters.values()]
        cells = [str(iteration.number), f"{iteration.cost:.6g}", f"{iteration.step:.1e}"]
        if not self._headed:
            self._head(list(iteration.parameters))
            self._headed = True
        taken = "yes" if iteration.accepted else "no"
        first = iteration.number == 0
        self._row([cells[0], cells[1], "" if first else cells[2], "" if first else taken, *values])

    def announce(self, number: int, start: Mapping[str, float]) -> None:
        """Say which of several starts is next."""
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
        import shutil
        import sys

        line = "  ".join(c.rjust(w) for c, w in zip(cells, self._widths, strict=True)).rstrip()
        if sys.stderr.isatty():
            line = line[: shutil.get_terminal_size().columns]
        self._say(line)

    def _say(self, line: str) -> None:
        typer.echo(line, err=True)


def _show(result: "FitResult", stated: "Definition", files: list[Path]) -> None:
    import shutil
    import sys

    from ..report import parameter_table, reached, summary

    # Nothing is wrapped where no person reads it: a row is a line, for grep and awk.
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    print(parameter_table(result, width))
    print()
    print(summary(result, width))
    figures = reached(result, stated)
    if figures:
        print()
    for figure in figures:
        print(f"{'reached' if figure.reached else 'MISSED':<9}{figure.path} {figure.sentence}")
    print()
    wrote = f"wrote {files[0].parent}: {', '.join(path.name for path in files)}"
    print(wrote if width is None else textwrap.fill(wrote, width, subsequent_indent="  "))
