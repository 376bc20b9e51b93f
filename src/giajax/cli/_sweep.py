"""`giajax sweep`: a fit repeated with other values, runs or options."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..runtime.process import configure, stopped_status
from ._commands import (
    Force,
    ManyProgress,
    Quiet,
    Scheduler,
    Workers,
    argument,
    command,
    print_table,
)

if TYPE_CHECKING:
    import polars as pl

    from ..tasks import Plan

_ROWS = 20
_ENDINGS = ("converged", "not_converged", "failed", "stopped")


@command(
    """\b
Examples:
  giajax sweep plan.toml --dry-run
                            list the fits
  giajax sweep plan.toml --workers 4
                            use four processes
  giajax sweep plan.toml --out masses --scheduler tcp://head:8786
                            use a cluster, and write to the folder masses

\b
A plan gives a fit definition and the values that differ between fits:
  fit = "base_step.toml"
  [grid]
  loss = ["linear", "huber"]
  [grid.fix]
  "links.mass" = { from = 0.04, to = 0.06, count = 5 }

The same command continues a sweep that was stopped or killed, or whose plan
has been extended. DIR/sweep.parquet contains one row for each fit, and DIR/fits
contains one file for each fit.

\b
Exit status: 0 all fits were done; 1 a fit failed (its row gives the reason);
2 bad input or usage; 130 interrupted, 143 by SIGTERM.""",
    group="study",
)
def sweep(
    plan: Annotated[Path, argument("PLAN", "Plan of the fits; see below.")],
    out: Annotated[
        Path | None, "DIR", "Output folder for the table. [default: giajax-out/PLAN]"
    ] = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    dry_run: Annotated[bool, "List the fits without running them."] = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Fit one definition many times.

    Each fit uses different values, runs or options. The fits run on one core, on several cores
    (--workers), or on the machines of a cluster (--scheduler).
    """
    from ..runtime.execution import open_executor
    from ..tasks import TABLE, Plan, sweep as sweep_plan

    planned = Plan.load(plan)
    folder = planned.folder if out is None else out
    if dry_run:
        _list(planned, folder)
        return
    with open_executor(workers, scheduler) as executor:
        if scheduler is None and workers in (None, 1):
            configure()
        progress = None if quiet else ManyProgress("fits")
        table = sweep_plan(planned, out=folder, executor=executor, progress=progress, force=force)
    counts = {ending: int((table["status"] == ending).sum()) for ending in _ENDINGS}
    if not quiet:
        _show(table, planned.columns)
        said = ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)
        print(f"\n{len(table)} fits: {said}; values in SI units\nwrote {folder / TABLE}")
    if counts["stopped"]:
        typer.echo("giajax: the finished fits are kept: run the same command to continue", err=True)
        raise typer.Exit(stopped_status())
    raise typer.Exit(1 if counts["failed"] else 0)


def _list(plan: "Plan", folder: Path) -> None:
    """Print the fits of a plan, and which of them are done."""
    from ..runtime.tasks import read_outcome
    from ..tasks import FITS

    rows, known = [], 0
    for number, (case, task) in enumerate(zip(plan.cases, plan.tasks(), strict=True), 1):
        done = read_outcome(folder / FITS, task.key) is not None
        known += done
        values = (case.get(name) for name in plan.columns)
        rows.append((number, *values, "done" if done else ""))
    print_table(["fit", *plan.columns, ""], rows)
    print(f"\n{len(rows)} fits in {folder}, of which {known} are already done")


def _estimate(row: dict[str, Any], path: str) -> str | None:
    """Format value and error of a parameter, SI, or say that a fit does not determine it."""
    from ..runtime.text import format_estimate

    value = row[f"value.{path}"]
    if value is None:
        return None
    shown, error = format_estimate(value, row.get(f"error.{path}"))
    if error != "-":
        return f"{shown} \N{PLUS-MINUS SIGN} {error}"
    return f"{shown} (not determined)" if row["status"] == "converged" else shown


def _show(table: "pl.DataFrame", columns: list[str]) -> None:
    """Print the first rows: the differences, the estimates, and the verdicts.

    Only the file contains the values of single runs (`PATH of RUN`), which can be many.
    """
    values = [name.removeprefix("value.") for name in table.columns if name.startswith("value.")]
    paths = [path for path in values if " of " not in path]
    headings = [*columns, "status", *paths, "verdict"]
    rows = [
        [
            *(row[name] for name in (*columns, "status")),
            *(_estimate(row, path) for path in paths),
            row["verdict"],
        ]
        for row in table.head(_ROWS).rows(named=True)
    ]
    print_table(headings, rows, left=0)
    if len(table) > _ROWS:
        print(f"... and {len(table) - _ROWS} more fits")
    if len(values) > len(paths):
        print(
            f"... and {len(values) - len(paths)} values of individual runs, which are in the file"
        )
    failed = table.filter(table["status"] == "failed")["message"].unique(maintain_order=True)
    for message in failed.head(3):
        print(f"failed: {message}")
