"""`giajax compare`, `choose` and `report`: what results say, side by side or one on a page."""

import json
from pathlib import Path
from typing import Annotated

import typer

from ..runtime.process import configure
from ._commands import ForceFile, Json, Paths, Renamed, Texts, argument, command, print_table
from ._on_result import OnResult, on_result


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
    results: Annotated[list[Path], argument("RESULT...", "At least two fits; see below.")],
    as_json: Annotated[bool, "--json", "Print JSON instead of tables."] = False,
    out: Annotated[Path | None, "FILE.html", "Write a page for a browser there."] = None,
    force: ForceFile = False,
) -> None:
    """Show what several fits say of the same parameters.

    Whether they agree to within their errors, and which describes the data better.
    """
    if len(results) < 2:
        raise typer.BadParameter("one result has nothing to be compared with: give two or more")
    from ..recordings import check_output_files, stored_result, write_files

    # What is no result is refused before JAX is imported, which takes seconds.
    for path in results:
        stored_result(path)
    if out is not None:
        check_output_files([out], force=force)
    configure()
    from ..fitting import load_result
    from ..report import check_page, compare_page, contrast_json, contrast_tables
    from ..studies import contrast

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
    # A folder may have points in its name, such as those of a version.
    homes = [path.parent if path.name == "result.json" else path for path in paths]
    short = [path.name if path.is_dir() else path.stem for path in homes]
    return short if len(set(short)) == len(short) and all(short) else [str(path) for path in paths]


_ENDS = {"not_converged": "NOT CONVERGED"}


@command("""\b
Examples:
  giajax choose --data loops.csv
  giajax choose --data loops.csv --held-out other.csv
  giajax choose --data loops.csv --only preisach --only modified_prandtl_ishlinskii

The best model on the held-out loops comes first; fits that did not converge come last,
whatever their errors. AIC and BIC are of the fitted part, each less
that of the best; a large difference on the held-out part and a small one here means a model that
describes what it saw and no more.""")
def choose(
    data: Annotated[list[Path], "RUN.csv", "A run to fit to."],
    held_out: Annotated[Paths, "RUN.csv", "A run to judge by."] = None,
    fraction: Annotated[float, "F", "Without --held-out: last part of each run to judge by."] = 0.3,
    only: Annotated[Texts, "NAME", "Compare only these."] = None,
    rename: Renamed = None,
    as_json: Json = False,
    quiet: Annotated[bool, "No progress."] = False,
) -> None:
    """Fit several hysteresis models and compare them on loops that they were not fitted to."""
    from ..recordings import parse_rename, read_run

    renamed = parse_rename(rename or [])
    runs = [read_run(path, rename=renamed) for path in data]
    others = [read_run(path, rename=renamed) for path in held_out or []]
    configure()
    from ..studies import choose_hysteresis

    say = None if quiet else (lambda name: typer.echo(f"fitting {name} ...", err=True))
    choice = choose_hysteresis(runs, others, fraction=fraction, candidates=only, progress=say)
    ended = [one for one in choice.candidates if one.converged] or choice.candidates
    least_aic, least_bic = min(one.aic for one in ended), min(one.bic for one in ended)
    keys = ("model", "parameters", "held_out_rmse", "rmse", "delta_aic", "delta_bic", "status")
    rows = [
        (
            *(one.name, one.parameters, one.held_out_rmse, one.rmse),
            *(one.aic - least_aic, one.bic - least_bic, one.status),
        )
        for one in choice.candidates
    ]
    if as_json:
        facts = [dict(zip(keys, row, strict=True)) for row in rows]
        typer.echo(json.dumps({"unit": choice.unit, "candidates": facts}, indent=2))
        return
    unit = f" {choice.unit}" if choice.unit else ""
    headings = ["model", "parameters", f"held out{unit}", f"fitted{unit}", "AIC", "BIC", "fit"]
    formats = ("", "", ".3g", ".3g", "+.1f", "+.1f", "")
    cells = [list(map(format, row, formats)) for row in rows]
    print_table(headings, [[*row[:-1], _ENDS.get(row[-1], row[-1])] for row in cells])


@on_result(
    """\b
Examples:
  giajax report giajax-out/run
  giajax report giajax-out/run --out for_the_group.html
  giajax report giajax-out/run --data elsewhere/run.csv

\b
RESULT is the folder of a fit, or its result.json. The page is one file that
opens without a network: the verdict, the parameters, what limits them, recorded
against fitted values, the arm as it moves, and where all of it comes from.""",
    out=("FILE.html", "The page (report.html beside the result)."),
    force="Write over a file.",
)
def report(given: OnResult) -> None:
    """Write a result as a page for a browser.

    One file that says first whether to believe the numbers.
    """
    from ..recordings import check_output_files, write_files
    from ..tasks import held_out_runs

    page = given.home / "report.html" if given.out is None else given.out
    check_output_files([page], force=given.force)
    from ..report import check_page, report_page

    check_page()
    fitted = given.fitted
    held_out = []
    if fitted.held_out:
        held_out = held_out_runs(fitted, given.data or [], rename=given.renamed, folder=given.home)
    source = given.result / "result.json" if given.result.is_dir() else given.result
    made = report_page(fitted, given.runs, held_out=held_out, source=source)
    write_files({page: made}, force=given.force)
    if not given.quiet:
        typer.echo(f"wrote {page} ({len(made) / 1e6:.1f} MB)")
