"""The table of a sweep: one row a fit, with a schema. Imports no JAX."""

import json
from collections.abc import Sequence
from typing import Any

import polars as pl

from ..execution import Outcome
from ._columns import Case

_BEFORE: dict[str, Any] = {
    "key": pl.String,
    "status": pl.String,
    "message": pl.String,
}
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
    """The rows of fits, in the order of the plan.

    Arguments:
        columns: what differs between them.
        cases: its values, of each fit.
        outcomes: what came of each.

    Returns:
        Key, status and message; what differs; `value.PATH` and `error.PATH` of each parameter that
        a fit freed; how it went; and `validation.CHANNEL of RUN` and `held_out.CHANNEL of RUN`.
        What a fit does not have is null.
    """
    found = [outcome.value or {} for outcome in outcomes]
    paths = list(dict.fromkeys(path for value in found for path in value.get("values", ())))
    swept = {name: [case.get(name) for case in cases] for name in columns}
    kinds = {name: _kind(values) for name, values in swept.items()}
    data: dict[str, list[Any]] = {
        "key": [outcome.key for outcome in outcomes],
        # How a fit ended is more than that it did.
        "status": [
            value.get("status", outcome.status)
            for value, outcome in zip(found, outcomes, strict=True)
        ],
        "message": [
            value.get("message", outcome.message)
            for value, outcome in zip(found, outcomes, strict=True)
        ],
    }
    for name, values in swept.items():
        text = kinds[name] is pl.String
        data[name] = [_as_text(value) if text else value for value in values]
    for path in paths:
        data[f"value.{path}"] = [value.get("values", {}).get(path) for value in found]
        data[f"error.{path}"] = [value.get("errors", {}).get(path) for value in found]
    for name in ("cost", "reduced_chi_square", "verdict", "iterations"):
        data[name] = [value.get(name) for value in found]
    data["seconds"] = [outcome.seconds for outcome in outcomes]
    data["worker"] = [outcome.worker for outcome in outcomes]
    predicted = list(dict.fromkeys(name for value in found for name in value.get("rmse", {})))
    for name in predicted:
        data[name] = [value.get("rmse", {}).get(name) for value in found]
    estimates = {f"{what}.{path}": pl.Float64 for path in paths for what in ("value", "error")}
    errors = dict.fromkeys(predicted, pl.Float64)
    return pl.DataFrame(data, schema={**_BEFORE, **kinds, **estimates, **_AFTER, **errors})


def _kind(values: Sequence[Any]) -> Any:
    """The type of a column: numbers, true or false, else text."""
    given = [value for value in values if value is not None]
    if all(isinstance(value, bool) for value in given):
        return pl.Boolean
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in given):
        return pl.Float64
    return pl.String


def _as_text(value: Any) -> str | None:
    """Text as it is, and what is no text as JSON."""
    return value if isinstance(value, str | None) else json.dumps(value)
