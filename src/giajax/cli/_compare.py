"""`giajax compare`, `choose` and `report`: comparison of results, and report of one result."""

import json
import sys
from pathlib import Path
from typing import Annotated

import typer

from ..runtime.process import configure
from ._commands import (
    Force,
    HoldOut,
    Json,
    Paths,
    Quiet,
    Renamed,
    Texts,
    argument,
    check_quiet,
    command,
    command_after,
    print_table,
)
from ._on_result import OnResult, on_result


@command(
    """\b
Examples:
  giajax compare giajax-out/monday giajax-out/tuesday
                            test whether two fits agree to within their errors
  giajax compare giajax-out/white giajax-out/correlated --json
                            print the comparison as JSON
  giajax compare giajax-out/a giajax-out/b giajax-out/c --page compare.html
                            compare three fits, and write a page with figures

RESULT is the folder of a fit, or its result.json. Differences are relative to
the first result and are divided by the combined standard error. BIC is shown if
all fits have the same data, noise and loss function. Otherwise, a note explains
why BIC is missing.""",
    group="fit",
    old={"--out": "--page"},
)
def compare(
    results: Annotated[list[Path], argument("RESULT", "Two or more fits; see below.")],
    as_json: Json = False,
    page: Annotated[Path | None, "FILE.html", "Write a page for a browser."] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Compare the estimates of several fits.

    Shows whether the estimates agree to within their errors, and which fit describes the data
    better.
    """
    check_quiet(quiet, written=page, as_json=as_json, by="--page FILE.html or --json")
    if len(results) < 2:
        raise typer.BadParameter(
            "one result is given, but a comparison needs at least two: give another one"
        )
    from ..recordings import check_output_files, stored_result, write_files

    # Reject files that are not results before JAX is imported, which takes seconds.
    for path in results:
        stored_result(path)
    if page is not None:
        check_output_files([page], force=force)
    configure()
    from ..fitting import load_result
    from ..report import check_page, compare_page, contrast_json, contrast_tables
    from ..studies import contrast

    if page is not None:
        check_page()
    loaded = [load_result(path) for path in results]
    found = contrast(loaded, _names(results))
    if page is not None:
        write_files({page: compare_page(found, loaded)}, force=force)
    if as_json:
        typer.echo(contrast_json(found))
    if as_json or quiet:
        return
    parameters, whole = contrast_tables(found)
    print_table(parameters.headings, parameters.rows, left=parameters.words)
    print()
    print_table(whole.headings, whole.rows)
    for note in found.notes:
        print(f"\n{note}")
    if page is not None:
        print(f"\nwrote {page}")


def _names(paths: list[Path]) -> list[str]:
    """Return the names of result folders or files, or whole paths if names are not unique."""
    # A folder name may contain dots, such as those of a version number.
    homes = [path.parent if path.name == "result.json" else path for path in paths]
    short = [path.name if path.is_dir() else path.stem for path in homes]
    return short if len(set(short)) == len(short) and all(short) else [str(path) for path in paths]


_ENDS = {"not_converged": "NOT CONVERGED"}


@command(
    """\b
Examples:
  giajax choose --data loops.csv
                            validate on the last part of the loops
  giajax choose --data loops.csv --validation other.csv
                            validate on another recording
  giajax choose --data loops.csv --operator preisach --operator bouc_wen
                            compare only these two models
  giajax choose --data loops.csv --hold-out last:0.5
                            validate on the last half of the loops

The models are sorted by their prediction error on the held-out loops. Models
whose fit did not converge come last. By default, the last 30 % of each run are held
out, unless a run for validation is given. AIC and BIC are computed from the fitted
part of the data and are shown relative to the smallest AIC and BIC of the models
whose fit converged. A BIC close to the smallest, combined with an error on the
held-out loops far above the smallest, indicates overfitting.""",
    group="study",
    old={
        "--held-out": "--validation",
        "--fraction": "--hold-out last:F",
        "--only": "--operator",
        "--quiet": "--no-progress",
    },
)
def choose(
    data: Annotated[list[Path], "RUN.csv", "A run to fit the models to."],
    validation: Annotated[Paths, "RUN.csv", "A run for validation."] = None,
    hold_out: HoldOut = None,
    operator: Annotated[Texts, "NAME", "Include only the model with this operator."] = None,
    rename: Renamed = None,
    as_json: Json = False,
    no_progress: Annotated[bool, "Do not print the progress."] = False,
) -> None:
    """Compare hysteresis models on held-out loops.

    Each model is first fitted to the remaining loops.
    """
    from ..recordings import parse_rename, read_run

    renamed = parse_rename(rename or [])
    runs = [read_run(path, rename=renamed) for path in data]
    others = [read_run(path, rename=renamed) for path in validation or []]
    configure()
    from ..studies import choose_hysteresis

    watched = sys.stderr.isatty() and not no_progress
    say = (lambda name: typer.echo(f"fitting {name} ...", err=True)) if watched else None
    choice = choose_hysteresis(
        runs, others, hold_out=hold_out or (), candidates=operator, progress=say
    )
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
    errors = [f"RMSE held out{unit}", f"RMSE fitted{unit}"]
    headings = ["model", "parameters", *errors, "delta AIC", "delta BIC", "status"]
    formats = ("", "", ".3g", ".3g", "+.1f", "+.1f", "")
    cells = [list(map(format, row, formats)) for row in rows]
    print_table(headings, [[*row[:-1], _ENDS.get(row[-1], row[-1])] for row in cells])


@on_result(
    """\b
Examples:
  giajax report giajax-out/run
                            write report.html beside the result
  giajax report giajax-out/run --page for_the_group.html
                            write the page to another file
  giajax report giajax-out/run --data elsewhere/run.csv
                            read a run file that was moved after the fit

RESULT is the folder of a fit, or its result.json. The page is a single file
that opens without a network connection. It contains the verdict, the parameters
and their limits, the recorded and fitted values, an animation of the arm, and
the provenance.""",
    group="first",
    page="Output file for the page. [default: report.html beside the result]",
    old={"--out": "--page"},
)
def report(given: OnResult) -> None:
    """Write an HTML report of a fit.

    It begins with the verdict on the fit.
    """
    from ..recordings import check_output_files, write_files
    from ..tasks import held_out_runs

    page = given.home / "report.html" if given.page is None else given.page
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
        typer.echo(command_after("view", given.result))
