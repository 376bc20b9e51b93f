"""Sweep: the fits of a plan, each made once, and their table."""

import contextlib
import io
import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import polars as pl

from ..recordings import Definition
from ..runtime.execution import InProcess, run_tasks
from ..runtime.files import keep
from ..runtime.tasks import Outcome
from ..runtime.text import InputError
from ._fit_task import FitTask
from ._journal import checksums_of, locked
from ._plan import Case, Plan

if TYPE_CHECKING:
    from ..fitting import FitResult, HeldOut, PredictionErrors, RunFit

# Columns of a table, which has one row for each fit.
_BEFORE: dict[str, Any] = {"key": pl.String, "status": pl.String, "message": pl.String}
_AFTER: dict[str, Any] = {
    "cost": pl.Float64,
    "reduced_chi_square": pl.Float64,
    "verdict": pl.String,
    "iterations": pl.Int64,
    "seconds": pl.Float64,
    "worker": pl.String,
}


def table(
    columns: Sequence[str], cases: Sequence[Case], outcomes: Sequence[Outcome]
) -> pl.DataFrame:
    """Return the table of fits in the order of the plan.

    Its columns are key, status and message; the settings that vary; `value.PATH` and `error.PATH`
    of each parameter that a fit freed; statistics of the fit; and `validation.CHANNEL of RUN` and
    `held_out.CHANNEL of RUN`. Missing values are null.

    Arguments:
        columns: names of the settings that vary.
        cases: values of these settings for each fit.
        outcomes: outcome of each fit.
    """
    kinds = {name: _kind([case.get(name) for case in cases]) for name in columns}
    rows: list[dict[str, Any]] = []
    estimates: dict[str, Any] = {}
    predicted: dict[str, Any] = {}
    for case, outcome in zip(cases, outcomes, strict=True):
        # The status of the fit replaces that of the task.
        row = {name: getattr(outcome, name) for name in (*_BEFORE, "seconds", "worker")}
        for name, kind in kinds.items():
            row[name] = _as_text(case.get(name)) if kind is pl.String else case.get(name)
        for name, item in (outcome.value or {}).items():
            if name == "rmse":
                row |= item
                predicted |= dict.fromkeys(item, pl.Float64)
            elif name in ("values", "errors"):
                row |= {f"{name[:-1]}.{path}": number for path, number in item.items()}
                names = (f"{what}.{path}" for path in item for what in ("value", "error"))
                estimates |= dict.fromkeys(names, pl.Float64)
            else:
                row[name] = item
        rows.append(row)
    return pl.DataFrame(rows, schema={**_BEFORE, **kinds, **estimates, **_AFTER, **predicted})


def _kind(values: Sequence[Any]) -> Any:
    """Return the type of a column: numbers, Booleans, or else text."""
    given = [value for value in values if value is not None]
    if all(isinstance(value, bool) for value in given):
        return pl.Boolean
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        return pl.Float64
    return pl.String


def _as_text(value: Any) -> str | None:
    """Return text unchanged, and any other value as JSON."""
    return value if isinstance(value, str | None) else json.dumps(value)


def fitted(
    definition: Mapping[str, Any],
    inputs: Mapping[str, Sequence[Sequence[str | None]]],
    rename: Mapping[str, str],
    begin: Mapping[str, Any] | None,
    paths: Mapping[str, Sequence[str]],
    added: Mapping[str, str] | None = None,
    nuisances: bool | None = None,
) -> dict[str, Any]:
    """Run a fit as a task, without the checks of a single fit: gradient, tolerance and suspects.

    Arguments:
        definition: definition of the fit.
        inputs: for `data` and `validation`, the name of each file with the SHA-256 of its content
            and of its sidecar, None if there is none.
        rename: map from the column names of the files to the names in the column table.
        begin: final values of another fit, or None.
        paths: paths of the files, in the same order as in `inputs`.
        added: plug-ins, and sources of the registered classes that the fit names, with their
            SHA-256.
        nuisances: whether a run may have nuisance parameters. It is only a part of the key of the
            task, because earlier versions held them.
    """
    del nuisances
    check_precision()
    for part, files in inputs.items():
        for (_, *before), path in zip(files, paths[part], strict=True):
            if list(checksums_of([Path(path)]).values()) != before:
                raise InputError(f"{path} has changed since the sweep began: start the sweep again")
    task = FitTask(
        Definition.parse(definition, "the plan"),
        data=tuple(map(Path, paths["data"])),
        validation=tuple(map(Path, paths["validation"])),
        rename=rename,
        begin=begin,
    )
    result = task.run(check=False)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    estimates: dict[str, Any] = dict(result.free)
    for run, name in zip(result.runs, _names(result.runs), strict=True):
        estimates |= {f"{path} of {name}": item for path, item in run.parameters.items()}
    return {
        "status": result.status,
        "message": result.message,
        "values": {path: item.value for path, item in estimates.items()},
        "errors": {path: item.standard_error for path, item in estimates.items()},
        "cost": result.cost,
        "reduced_chi_square": result.reduced_chi_square,
        "verdict": result.verdict.status,
        "iterations": result.iterations,
        "rmse": _prediction(result),
    }


def _prediction(result: "FitResult") -> dict[str, float | None]:
    """Return the RMSE of data that were not fitted, in their units, by channel and run."""
    parts: dict[str, Sequence[PredictionErrors | HeldOut]]
    parts = {"validation": result.validation, "held_out": result.held_out}
    return {
        f"{part}.{channel} of {name}": errors.rmse
        for part, runs in parts.items()
        for run, name in zip(runs, _names(runs), strict=True)
        for channel, errors in run.channels.items()
    }


def _names(runs: "Sequence[RunFit | PredictionErrors | HeldOut]") -> list[str]:
    """Return the name of each run, with its path if several have the same name."""
    several = Counter(run.name for run in runs)
    return [run.name if several[run.name] == 1 else f"{run.name} ({run.path})" for run in runs]


def check_precision() -> None:
    """Refuse 32-bit precision, because stored fits do not contain their precision."""
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            "JAX computes in 32-bit precision, but a sweep requires 64-bit precision: call "
            'jax.config.update("jax_enable_x64", True) first'
        )


TABLE = "sweep.parquet"
"""File name of the table in the folder of a sweep."""

FITS = "fits"
"""Subfolder of a sweep that contains one file for each fit."""


def sweep(
    plan: str | Path | Mapping[str, Any] | Plan,
    *,
    out: str | Path | None = None,
    executor: Executor | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
    force: bool = False,
) -> "pl.DataFrame":
    """Fit one definition many times, with different values, runs or options each time.

    Each fit is written to its own file when it is finished. The same call continues after a crash
    or Ctrl-C, and after the plan has grown. Without an executor, the fits run in this process,
    which requires 64-bit precision: call `jax.config.update("jax_enable_x64", True)` first.

    Arguments:
        plan: file of a plan (`docs/sweep.md`), the content of such a file, or a `Plan`.
        out: folder for `sweep.parquet` and the fits. The default is the folder of the plan,
            otherwise `giajax-out/` and its name.
        executor, progress: as in `giajax.runtime.execution.run_tasks`.
        force: overwrite the table of another plan.

    Returns:
        The table, with one row for each fit in the order of the plan. A fit that failed has a row
        with its message. A fit that Ctrl-C prevented has the status "stopped".

    Raises:
        InputError: an invalid plan, a missing file, 32-bit precision, or a folder that another
            sweep is writing to, that contains the table of another plan, or that cannot be written.

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
    """Refuse to overwrite a table that contains fits which the plan does not have."""
    if not path.exists():
        return
    before: set[str] = set()
    with contextlib.suppress(OSError, pl.exceptions.PolarsError):
        before = set(pl.read_parquet(path, columns=["key"])["key"])
    if not before or not before <= keys:
        raise InputError(
            f"{path} is the table of another plan: give another folder, or --force to overwrite it"
        )
