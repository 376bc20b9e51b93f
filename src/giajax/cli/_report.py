"""`giajax report`: a result as a page for a browser."""

from pathlib import Path
from typing import Annotated

import typer

from ._options import Renamed
from ._registry import command


@command("""\b
Examples:
  giajax report giajax-out/run
  giajax report giajax-out/run --out for_the_group.html
  giajax report giajax-out/run --data elsewhere/run.csv

\b
RESULT is the folder of a fit, or its result.json. The page is one file that
opens without a network: the verdict, the parameters, what limits them, recorded
against fitted values, the arm as it moves, and where all of it comes from.""")
def report(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A fit; see below.")],
    data: Annotated[
        list[Path] | None,
        typer.Option(metavar="RUN.csv", help="A fitted run, if it has moved. Repeatable."),
    ] = None,
    rename: Renamed = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.html", help="The page (report.html beside the result)."),
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print errors only.")] = False,
) -> None:
    """Write a result as a page for a browser.

    One file that says first whether to believe the numbers.
    """
    from ..runs import check_output_files, parse_rename, write_files
    from ..tasks import fitted_runs, held_out_runs, stored_result

    folder, _ = stored_result(result)
    source = result / "result.json" if result.is_dir() else result
    page = folder / "report.html" if out is None else out
    check_output_files([page], force=force)
    renamed = parse_rename(rename or [])

    from ._jax import configure

    configure()
    from ..fitting import load_result
    from ..report import check_page, report_page

    check_page()
    fitted = load_result(result)
    runs = fitted_runs(fitted, data or [], rename=renamed)
    held_out = held_out_runs(fitted, data or [], rename=renamed) if fitted.held_out else []
    made = report_page(fitted, runs, held_out=held_out, source=source)
    write_files({page: made}, force=force)
    if not quiet:
        typer.echo(f"wrote {page} ({len(made) / 1e6:.1f} MB)")
