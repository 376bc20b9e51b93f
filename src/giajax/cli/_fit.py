"""`giajax fit`: parameters of a model from recordings of it."""

import functools
import inspect
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, cast, get_args, get_origin

import typer

from ..runtime.process import CORES_VARIABLE
from ._commands import command
from ._fit_run import finished, run_fit
from ._options import Cores, Renamed, Scheduler, Workers
from ._values import bounds, groups, plain_settings, priors, ties

if TYPE_CHECKING:
    from ..recordings import TaskKeywords
    from ..tasks import FitTask

# The options of settings: one for each that is declared to have one.

_READ: dict[str, Callable[[list[str]], Any]] = {
    "PATH=VALUE+-DEVIATION": priors,
    "PATH=LOW,HIGH": bounds,
    "PATH=EXPRESSION": ties,
    "PATH=RUN,RUN": groups,
}
"""What reads the values of an option, by what its help calls them."""


class _Option(NamedTuple):
    """The option of a setting: of which, its words, its kind of value, and its help."""

    setting: str
    words: str
    metavar: str
    kind: Any
    least: int | None
    help: str


def _kind(annotation: Any) -> Any:
    """What typer reads for a field: the type of a number or a switch, else words."""
    if annotation in (bool, int, float):
        return annotation
    if get_origin(annotation) in (list, dict):
        return list[str]
    parts = [] if get_origin(annotation) is Literal else get_args(annotation)
    return _kind(parts[0]) if parts else str


def _options() -> dict[str, _Option]:
    """The options by the name of the argument that they are of a command's function."""
    from ..recordings import FitSettings

    options = {}
    for name, field in FitSettings.model_fields.items():
        about: Any = field.json_schema_extra
        words = about["option"] or f"--{name.replace('_', '-')}"
        if words == "-":
            continue
        default, kind = field.default, _kind(field.annotation)
        options[words.partition("/")[0][2:].replace("-", "_")] = _Option(
            setting=name,
            words=words,
            metavar=about["metavar"],
            kind=kind,
            least=next((item.ge for item in field.metadata if hasattr(item, "ge")), None),
            help=str(field.description)
            if kind is bool or default in (None, [], {})
            else f"{str(field.description)[:-1]} ({default}).",
        )
    return options


def with_settings(function: Callable[..., None]) -> Callable[..., None]:
    """A command whose other arguments are settings of a fit, with an option for each of these."""

    @functools.wraps(function)
    def whole(**given: Any) -> None:
        function(**given)

    named = [
        parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY)
        for parameter in inspect.signature(function).parameters.values()
        if parameter.kind is not inspect.Parameter.VAR_KEYWORD
    ]
    # Behind what is fitted, before what is done with the result.
    after = next(i for i, parameter in enumerate(named) if parameter.name == "rename")
    for argument, option in reversed(_options().items()):
        about = typer.Option(
            option.words,
            metavar=option.metavar or None,
            min=option.least,
            help=option.help,
            show_default=False,
        )
        kind: Any = Annotated[option.kind | None, about]
        place = inspect.Parameter(argument, named[0].kind, default=None, annotation=kind)
        named.insert(after, place)
    whole.__signature__ = inspect.Signature(named)  # type: ignore[attr-defined]
    whole.__annotations__ = {parameter.name: parameter.annotation for parameter in named}
    return whole


def typed(given: Mapping[str, Any]) -> "TaskKeywords":
    """The settings that were typed, as keywords of `FitTask.on_top`."""
    said: Any = {}
    for argument, option in _options().items():
        value = given[argument]
        if value in (None, []):
            continue
        if option.metavar == "PATH=VALUE":
            value = plain_settings(value, option.words)
        said[option.setting] = _READ.get(option.metavar, lambda value: value)(value)
    return cast("TaskKeywords", said)


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
    complete=with_settings,
)
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
    rename: Renamed = None,
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
    **settings: Any,
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
        **typed(settings),
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
