"""`giajax compare`: results side by side."""

from pathlib import Path
from typing import Annotated

import typer
from ._registry import command


@command("""\b
Examples:
  giajax compare giajax-out/monday giajax-out/tuesday
  giajax compare giajax-out/white giajax-out/correlated --json
  giajax compare giajax-out/a giajax-out/b giajax-out/c --out compare.html

\b
RESULT is the folder of a fit, or its result.json. Differences are from the first
result, in joint standard errors. BIC is shown where all were fitted to the same
values with the same noise and loss; where not, a line says so.""")
def compare(
    results: Annotated[
        list[Path], typer.Argument(metavar="RESULT...", help="At least two fits; see below.")
    ],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of tables.")] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.html", help="Write a page for a browser there.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Write over a file.")] = False,
) -> None:
    """Show what several fits say of the same parameters.

    Whether they agree to within their errors, and which describes the data better.
    """
    if len(results) < 2:
        raise typer.BadParameter("one result has nothing to be compared with: give two or more")
    from ..runs import check_output_files, write_files
    from ..tasks import stored_result

    # What is no result is told before JAX is imported, which takes seconds.
    for path in results:
        stored_result(path)
    if out is not None:
        check_output_files([out], force=force)
    from ._jax import configure

    configure()
    from ..fitting import load_result
    from ..report import check_page, compare_page, contrast_json, contrast_tables
    from ..study import contrast
    from ._output import print_table

    if out is not None:
        check_page()
    loaded = [load_result(path) for path in results]
    found = contrast(loaded, _names(results))
    if out is not None:
        write_files({out: compare_page(found, loaded)}, force=force)
    if as_json:
        typer.echo(contrast_json(found))
        return
    parameters, whole = contrast_tables(found)
    print_table(*parameters, left=2)
    print()
    print_table(*whole)
    for note in found.notes:
        print(f"\n{note}")
    if out is not None:
        print(f"\nwrote {out}")


def _names(paths: list[Path]) -> list[str]:
    """Names of the folders of results, or of files; whole paths where these are not different."""
    short = [_name(path) for path in paths]
    return short if len(set(short)) == len(short) and all(short) else [str(path) for path in paths]


def _name(path: Path) -> str:
    # A folder may have points in its name, such as those of a version.
    if path.is_dir():
        return path.name
    return path.parent.name if path.name == "result.json" else path.stem
