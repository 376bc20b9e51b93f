"""`giajax influence`: what each part of the data does to each parameter of a fit."""

from pathlib import Path
from typing import Annotated

import typer

from .._errors import InputError
from ._many import ManyProgress, Scheduler, Workers, end_if_stopped
from ._options import Renamed
from ._registry import command


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
    from ..runs import check_output_files, parse_rename, write_files
    from ..tasks import fitted_runs, stored_result

    home, _ = stored_result(result)
    path = home / "influence.json" if out is None else out
    picture = path.with_suffix(".png")
    if picture == path:
        raise InputError(f"--out {path} is the name of a picture: give that of a .json file")
    check_output_files([path, *([picture] if figures else [])], force=force)
    renamed = parse_rename(rename or [])

    from ._jax import configure

    configure()
    from ..execution import open_executor
    from ..fitting import load_result
    from ..repetitions import influence as ask
    from ..report import influence_figure, influence_summary, influence_table, to_png
    from ._output import print_table

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
