"""A sweep: the fits of a plan, each once, and their table."""

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

# The columns of a table, which has one row a fit.
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
    """The rows of fits, in the order of the plan, whose `columns` are what differs between them.

    Key, status and message; what differs; `value.PATH` and `error.PATH` of each parameter that a
    fit freed; how it went; and `validation.CHANNEL of RUN` and `held_out.CHANNEL of RUN`. What a
    fit does not have is null.
    """
    kinds = {name: _kind([case.get(name) for case in cases]) for name in columns}
    rows: list[dict[str, Any]] = []
    estimates: dict[str, Any] = {}
    predicted: dict[str, Any] = {}
    for case, outcome in zip(cases, outcomes, strict=True):
        # How a fit ended is more than that it did.
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
    """The type of a column: numbers, true or false, else text."""
    given = [value for value in values if value is not None]
    if all(isinstance(value, bool) for value in given):
        return pl.Boolean
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        return pl.Float64
    return pl.String


def _as_text(value: Any) -> str | None:
    """Text as it is, and what is not a text as JSON."""
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
    """A task: a fit without the checks that end a single one: gradient, tolerance and suspects.

    The inputs are the name of each file of `data` and `validation` with the SHA-256 of its content
    and of its sidecar, None where there is none; their paths have the same order. What was `added`
    are the plug-ins and the sources of registered classes that it names, with their SHA-256.
    Where something of the runs may be uncertain, the key says so: earlier fits held it.
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
    """RMSE of what was not fitted, in the unit of the recording, by channel and run."""
    parts: dict[str, Sequence[PredictionErrors | HeldOut]]
    parts = {"validation": result.validation, "held_out": result.held_out}
    return {
        f"{part}.{channel} of {name}": errors.rmse
        for part, runs in parts.items()
        for run, name in zip(runs, _names(runs), strict=True)
        for channel, errors in run.channels.items()
    }


def _names(runs: "Sequence[RunFit | PredictionErrors | HeldOut]") -> list[str]:
    """Of each run; of several that are called the same, with their paths."""
    several = Counter(run.name for run in runs)
    return [run.name if several[run.name] == 1 else f"{run.name} ({run.path})" for run in runs]


def check_precision() -> None:
    """Refuse 32-bit: what is kept of a fit does not say how precise it is."""
    import jax

    if not jax.config.read("jax_enable_x64"):
        raise InputError(
            "JAX computes in 32-bit, but a sweep needs 64-bit: call "
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
    """Fit one definition many times: with other values, runs or options each time.

    Each fit has a file of its own as soon as it is done. The same call goes on after a crash or
    Ctrl-C, and after the plan has grown. Without an executor the fits are done here, which wants
    64-bit: call `jax.config.update("jax_enable_x64", True)` first.

    Arguments:
        plan: the file of a plan (`docs/sweep.md`), the content of one, or a `Plan`.
        out: folder for `sweep.parquet` and the fits; by default what the plan says, else
            `giajax-out/` and its name.
        executor, progress: as of `giajax.runtime.execution.run_tasks`.
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
    if not path.exists():
        return
    before: set[str] = set()
    with contextlib.suppress(OSError, pl.exceptions.PolarsError):
        before = set(pl.read_parquet(path, columns=["key"])["key"])
    if not before or not before <= keys:
        raise InputError(
            f"{path} is the table of another plan: give another folder, or --force to overwrite it"
        )
