"""Two models on the same recordings, from the same first rows."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..fitting import fit, prediction_errors
from ..models import AbstractModel
from ..runs import Definition, Run


def compare(
    model: AbstractModel,
    runs: Sequence[Run],
    other: AbstractModel | None = None,
    *,
    refit_initial: bool = False,
) -> list[list[Any]]:
    """Errors of prediction, channel by channel.

    Arguments:
        model: what predicts.
        runs: what was recorded; each starts as its definition says.
        other: another model for the same runs.
        refit_initial: fit the initial state of each run first, for each model by itself.

    Returns:
        Rows: run, channel, unit, number of values, RMSE, largest error, and with another model
        its RMSE and the ratio of the first to it; errors in the unit of the recording.

    Raises:
        InputError: as `giajax.predict` and `giajax.fit`.
    """
    rows = []
    for run in runs:
        errors = _errors(model, run, refit_initial)
        others = None if other is None else _errors(other, run, refit_initial)
        for name, found in errors.items():
            row = [run.name, name, found["unit"], found["n"], found["rmse"], found.get("largest")]
            if others is not None:
                reference = others[name]["rmse"]
                row += [reference, found["rmse"] / reference if reference else np.nan]
            rows.append(row)
    return rows if len(runs) == 1 else [*rows, *_pooled(rows)]


def _pooled(rows: Sequence[list[Any]]) -> list[list[Any]]:
    """One row a channel for all runs together."""
    by_channel: dict[tuple[str, str], list[list[Any]]] = {}
    for row in rows:
        by_channel.setdefault((row[1], row[2]), []).append(row)
    pooled = []
    for (name, unit), those in by_channel.items():
        counts = np.asarray([row[3] for row in those])

        def together(column: int, those: Any = those, counts: Any = counts) -> float:
            squares = np.asarray([row[column] for row in those]) ** 2
            return float(np.sqrt(np.sum(counts * squares) / np.sum(counts)))

        largest = [row[5] for row in those]
        worst = None if None in largest else max(largest)
        row = [f"all {len(those)}", name, unit, int(counts.sum()), together(4), worst]
        if len(those[0]) > 6:
            row += [together(6), together(4) / together(6)]
        pooled.append(row)
    return pooled


def _errors(model: AbstractModel, run: Run, refit: bool) -> dict[str, dict[str, Any]]:
    if not refit:
        return prediction_errors(model, run)["channels"]
    free = Definition.parse({"initial": {"free": True}})
    run = dataclasses.replace(run, definition=run.definition.merged_with(free))
    return fit(model, run, free=[], check=False).runs[0]["channels"]
