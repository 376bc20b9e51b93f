"""A sweep: the fits of a plan, each once, and their table."""

import contextlib
import io
from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from .._files import keep
from ..execution import InProcess, Outcome, run_tasks
from ..tasks import locked
from ._fit import check_precision
from ._plan import Plan
from ._table import table

if TYPE_CHECKING:
    import polars as pl

TABLE = "sweep.parquet"
"""Name of the table of a sweep in its folder."""

FITS = "fits"
"""Folder in it of the fits, a file each."""


def sweep(
    plan: str | Path | Mapping[str, Any] | Plan,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
    force: bool = False,
) -> "pl.DataFrame":
    """Fit one definition many times: with other values, runs or options each time.

    Each fit has a file of its own as soon as it is done. The same call goes on after a crash or
    Ctrl-C, and after the plan has grown. Without an executor the fits are done here, which wants
    64-bit: call `jax.config.update("jax_enable_x64", True)` first.

    Arguments:
        plan: the file of a plan (`docs/sweep.md`), the content of one, or a `Plan`.
        out: folder for `sweep.parquet` and the fits; by default what the plan says, else
            `giajax-out/` and its name.
        executor: any of `concurrent.futures`; see `giajax.execution.open_executor`.
        progress: as of `giajax.execution.run_tasks`.
        force: write over the table of another plan.

    Returns:
        The table, one row a fit in the order of the plan. A fit that could not be done is a row
        with its message; one that Ctrl-C came before has the status "stopped".

    Raises:
        InputError: a plan that cannot be, a file that is missing, 32-bit, or a folder that another
            sweep is writing to, that holds the table of another plan, or that cannot be written.

    Example:
        >>> import giajax
        >>> table = giajax.sweep("plan.toml")  # doctest: +SKIP
        >>> table.filter(table["status"] == "failed")["message"]  # doctest: +SKIP
    """
    if isinstance(plan, str | Path):
        plan = Plan.load(plan)
    elif not isinstance(plan, Plan):
        plan = Plan.parse(plan)
    folder = plan.folder if out is None else Path(out)
    tasks = plan.tasks()
    if executor is None or isinstance(executor, InProcess):
        check_precision()
    with locked(folder):
        if not force:
            _check_none_is_lost(folder / TABLE, {task.key for task in tasks})
        outcomes = run_tasks(tasks, executor=executor, folder=folder / FITS, progress=progress)
        rows = table(plan.columns, plan.cases, outcomes)
        content = io.BytesIO()
        rows.write_parquet(content)
        keep(folder / TABLE, content.getvalue())
    return rows


def _check_none_is_lost(path: Path, keys: set[str]) -> None:
    """Refuse to write over a table with fits that the plan does not have."""
    import polars as pl

    if not path.exists():
        return
    before: set[str] = set()
    with contextlib.suppress(OSError, pl.exceptions.PolarsError):
        before = set(pl.read_parquet(path, columns=["key"])["key"])
    if not before or not before <= keys:
        raise InputError(
            f"{path} is the table of another plan: give another folder, or --force to write over it"
        )
