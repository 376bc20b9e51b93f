"""`giajax bootstrap`: a fit repeated with data that might have been recorded instead."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ..runtime.text import InputError
from ._commands import command
from ._options import ManyProgress, Renamed, Scheduler, Workers, end_if_stopped

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..recordings import Run
    from ..studies import Bootstrap

# `giajax bootstrap`: a fit repeated with data that might have been recorded instead.

# Repetitions of a self-test: the spread within 7 %, in about a minute for a fit of some seconds.
_SELF_TEST = 96


@command("""\b
Examples:
  giajax bootstrap giajax-out/run
  giajax bootstrap giajax-out/run --size 400 --workers 2
  giajax bootstrap giajax-out/run --block --out blocks.json
  giajax bootstrap giajax-out/run --whole --size 100 --folder repetitions

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. Writes bootstrap.json and bootstrap.png beside the result, where
giajax report finds them. Ctrl-C keeps what was done; with --folder DIR the same
command and --force go on from there.""")
def bootstrap(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A fit; see below.")],
    size: Annotated[int, typer.Option(metavar="N", min=2, help="Repetitions.")] = 200,
    block: Annotated[
        bool, typer.Option("--block", help="With blocks of the residuals, not noise of a model.")
    ] = False,
    whole: Annotated[
        bool, typer.Option("--whole", help="Fit each as the data were, noise and all.")
    ] = False,
    seed: Annotated[int, typer.Option(metavar="N", min=0, help="Of all random numbers.")] = 0,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A fitted run, if it has moved. Repeatable."),
    ] = None,
    rename: Renamed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    folder: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep each task there; what is there is not done again."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Where it goes (bootstrap.json beside RESULT)."),
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw the repetitions.")
    ] = True,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Repeat a fit with noise drawn anew: are its errors right, and does it come back?

    Bias, spread and intervals of the repetitions, and how often the 95 % interval holds the truth.
    """
    from ..recordings import check_output_files, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    home, _ = stored_result(result)
    path = home / "bootstrap.json" if out is None else out
    picture = path.with_suffix(".png")
    if picture == path:
        raise InputError(f"--out {path} is the name of a picture: give that of a .json file")
    check_output_files([path, *([picture] if figures else [])], force=force)
    renamed = parse_rename(rename or [])

    from ..runtime.process import configure

    configure()
    from ..fitting import load_result
    from ..report import bootstrap_figure, to_png
    from ..runtime.execution import open_executor
    from ..studies import bootstrap as repeat

    fitted = load_result(result)
    runs = fitted_runs(fitted, data or [], rename=renamed)
    with open_executor(workers, scheduler) as executor:
        found = repeat(
            fitted,
            runs,
            size=size,
            method="block" if block else "parametric",
            whole=whole,
            seed=seed,
            executor=executor,
            folder=folder,
            progress=None if quiet else ManyProgress("parts"),
        )
    files = {path: found.to_json().encode()}
    if figures:
        files[picture] = to_png(bootstrap_figure(found))
    write_files(files, force=force)
    if as_json:
        typer.echo(found.to_json(), nl=False)
    elif not quiet:
        show_bootstrap(found)
        typer.echo(f"\nwrote {', '.join(map(str, files))}")
    end_if_stopped(folder)


def show_bootstrap(found: "Bootstrap") -> None:
    """Print the table and the sentences of a bootstrap."""
    from ..report import bootstrap_summary, bootstrap_table
    from ._options import print_table

    print_table(*bootstrap_table(found))
    print()
    print("\n".join(bootstrap_summary(found)))


def self_test(
    result: "FitResult", runs: "Sequence[Run]", folder: Path, *, shown: bool
) -> list[Path]:
    """Repeat a fit that has just ended, write it beside the result and show it.

    Arguments:
        result, runs: the fit.
        folder: of its files.
        shown: whether a person reads.

    Returns:
        The files; none where nothing could be repeated, which a sentence says.
    """
    from ..recordings import write_files
    from ..report import bootstrap_figure, to_png
    from ..studies import bootstrap as repeat

    if shown:
        typer.echo("\nself-test: the fit repeated with noise drawn anew", err=True)
    try:
        found = repeat(
            result, runs, size=_SELF_TEST, progress=ManyProgress("parts") if shown else None
        )
    except InputError as error:
        typer.echo(f"giajax: no self-test: {error}", err=True)
        return []
    files = {
        folder / "bootstrap.json": found.to_json().encode(),
        folder / "bootstrap.png": to_png(bootstrap_figure(found)),
    }
    write_files(files, force=True)
    if shown:
        print()
        show_bootstrap(found)
    return list(files)


# `giajax influence`: what each part of the data does to each parameter of a fit.


@command("""\b
Examples:
  giajax influence giajax-out/run
  giajax influence giajax-out/both --exact --workers 2
  giajax influence giajax-out/run --spans 20 --out spans.json

\b
RESULT is the folder of a fit, or its result.json. The runs are read again from
where they were. Writes influence.json and influence.png beside the result, where
giajax report finds them.""")
def influence(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A fit; see below.")],
    exact: Annotated[
        bool, typer.Option("--exact", help="Fit without each marker, channel and span, too.")
    ] = False,
    spans: Annotated[
        int, typer.Option(metavar="N", min=1, help="Spans of time of each run; 1 for none.")
    ] = 10,
    most: Annotated[int, typer.Option(metavar="N", min=1, help="Rows of the table.")] = 20,
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A fitted run, if it has moved. Repeatable."),
    ] = None,
    rename: Renamed = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    folder: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Keep each task there; what is there is not done again."),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.json", help="Where it goes (influence.json beside RESULT)."),
    ] = None,
    figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw a map.")] = True,
    force: Annotated[bool, typer.Option("--force", help="Write over files.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Tell what each run, marker, channel and span of time does to each parameter.

    Without it, how far would the parameter move, and how large would its error be?
    """
    from ..recordings import check_output_files, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    home, _ = stored_result(result)
    path = home / "influence.json" if out is None else out
    picture = path.with_suffix(".png")
    if picture == path:
        raise InputError(f"--out {path} is the name of a picture: give that of a .json file")
    check_output_files([path, *([picture] if figures else [])], force=force)
    renamed = parse_rename(rename or [])

    from ..runtime.process import configure

    configure()
    from ..fitting import load_result
    from ..report import influence_figure, influence_summary, influence_table, to_png
    from ..runtime.execution import open_executor
    from ..studies import influence as ask
    from ._options import print_table

    fitted = load_result(result)
    runs = fitted_runs(fitted, data or [], rename=renamed)
    with open_executor(workers, scheduler) as executor:
        found = ask(
            fitted,
            runs,
            exact=exact,
            spans=spans,
            executor=executor,
            folder=folder,
            progress=None if quiet else ManyProgress("parts"),
        )
    files = {path: found.to_json().encode()}
    if figures:
        files[picture] = to_png(influence_figure(found))
    write_files(files, force=force)
    if as_json:
        typer.echo(found.to_json(), nl=False)
    elif not quiet:
        print_table(*influence_table(found, most), left=2)
        if len(found.parts) > most:
            print(f"and {len(found.parts) - most} more, which move less (--most)")
        print()
        print("\n".join(influence_summary(found)))
        typer.echo(f"\nwrote {', '.join(map(str, files))}")
    end_if_stopped(folder)
