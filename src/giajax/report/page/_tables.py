"""Tables of the page of one result, as rows of text for a template."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from ...fitting import (
    FitResult,
    HeldOut,
    PredictionErrors,
    column_factors,
    in_column_units,
)
from ...runtime.text import (
    format_bounds,
    format_estimate,
    format_number,
    format_range,
    with_run_column,
)
from ...studies import distinct_optima, lost_starts, together
from .. import Table
from .._text import correlation_text

# The colour of a correlation is a mixture of white and one of these.
_POSITIVE, _NEGATIVE = (213, 94, 0), (0, 114, 178)


class Cell(NamedTuple):
    """A correlation as text, its colours, and its two parameters."""

    text: str
    background: str
    ink: str
    about: str


def correlation_cells(result: FitResult) -> list[list[Cell]]:
    """Return the lower half of the correlation matrix, a row for each parameter after the first."""
    paths = result.correlation.parameters
    return [
        [_cell(value, f"{paths[i]} and {paths[j]}") for j, value in enumerate(row[:i])]
        for i, row in enumerate(result.correlation.matrix)
    ]


def _cell(value: float | None, about: str) -> Cell:
    # In memory it is NaN; in a file it is null.
    if value is None or not math.isfinite(value):
        return Cell("?", "#ffffff", "#222222", about)
    size = min(abs(value), 1.0)
    end = _POSITIVE if value > 0 else _NEGATIVE
    mixed = "".join(f"{round(255 + (part - 255) * size):02x}" for part in end)
    ink = "#ffffff" if size > 0.6 else "#222222"
    return Cell(correlation_text(value), f"#{mixed}", ink, f"{about}: {value:+.4f}")


def parameter_rows(result: FitResult) -> list[dict[str, Any]]:
    """Return fitted, derived and held parameters, in the units of the columns.

    Each is text, by its name in the template. `exact` is the value at full precision.
    """
    factors = column_factors(result.model)
    stated = together(result.systematic)
    rows = []
    for path, one in in_column_units(result.shown, result.model).items():
        # An element and a group of runs have the factor of the parameter.
        factor = factors.get(path.partition(" of ")[0].partition("[")[0], 1.0)
        value, error = format_estimate(one.value, one.standard_error)
        systematic, both = _times(stated.get(path), factor), None
        if systematic is not None and one.standard_error is not None:
            both = float(np.hypot(systematic, one.standard_error))
        ends: list[float] = []
        if one.interval is not None and None not in one.interval:
            ends = sorted(end * factor for end in one.interval)
        row: dict[str, Any] = {"path": path, "value": value, "exact": json.dumps(one.value)}
        row |= {"statistical": error, "systematic": format_number(systematic, ".2g")}
        row |= {"both": format_number(both, ".2g"), "unit": one.unit or "-"}
        row["interval"] = format_range(ends) if ends else "-"
        row |= {"bounds": format_bounds(one.lower, one.upper), "sources": _sources(one.sources)}
        rows.append(row | {"remark": one.remark, "free": one.free})
    _, names = with_run_column(("parameter",), [[row["path"]] for row in rows])
    return [row | {"names": name} for row, name in zip(rows, names, strict=True)]


def _sources(sources: Mapping[str, float | None]) -> str:
    """Return recordings with the effect of each on the error, the most important one first."""
    weights = {name: np.inf if factor is None else factor for name, factor in sources.items()}
    ordered = sorted(weights, key=lambda name: -weights[name])
    return ", ".join(
        f"{name} (alone)" if np.isinf(weights[name]) else f"{name} (x{weights[name]:.3g})"
        for name in ordered
    )


def noise_table(result: FitResult) -> Table:
    """Return a table of the RMSE and the noise of each channel of each run."""
    rows = []
    for run in result.runs:
        for name, c in run.channels.items():
            noise = c.compared_noise
            size = [c.unit or "-", str(c.n), _number(c.rmse), _number(noise)]
            ratio = f"{c.rmse / noise:.2f}" if c.rmse is not None and noise else "-"
            memory = "-"
            if c.correlated:
                memory = f"{c.correlated:.3g} over {c.correlation_time_s:.3g} s"
            rows.append([run.name, name, *size, ratio, memory])
    headings = [
        "run",
        "channel",
        "unit",
        "values",
        "RMSE",
        "noise",
        "RMSE / noise",
        "correlated noise",
    ]
    return Table(headings, rows, 3)


def held_out_table(result: FitResult) -> Table:
    """Return a table of the held-out data and their prediction errors."""
    return _errors(result.held_out, "error / expected error", lambda c: _number(c.size, "-"))


def validation_table(result: FitResult) -> Table:
    """Return a table of the runs that were not fitted and their prediction errors."""
    return _errors(result.validation, "largest error", lambda c: _number(c.largest))


def _errors(
    records: Sequence[HeldOut | PredictionErrors], last: str, cell: Callable[[Any], str]
) -> Table:
    rows = [
        [record.name, name, c.unit or "-", str(c.n), _number(c.rmse), cell(c)]
        for record in records
        for name, c in record.channels.items()
    ]
    return Table(["run", "channel", "unit", "values", "RMSE", last], rows, 3)


def _free(result: FitResult) -> tuple[dict[str, float], list[str]]:
    """Return the factors of the free parameters to column units by path, and their headings."""
    factors = column_factors(result.model)
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    # An element of an array has the factor of the array.
    paths = {path: factors.get(path.partition("[")[0], 1.0) for path in result.free}
    return paths, [f"{path} ({units[path]})" if units[path] else path for path in paths]


def starts_table(result: FitResult) -> Table:
    """Return a table of the end of each start, in the units of the columns."""
    paths, headings = _free(result)
    rows = [
        [start.status, format_number(start.misfit, ".6g")]
        + [_number(_times((start.parameters or {}).get(path), paths[path])) for path in paths]
        for start in result.starts
    ]
    return Table(["ended", "misfit", *headings], rows, 1)


def optima_table(result: FitResult) -> Table:
    """Return a table of the optima that were reached, in column units, and of failed starts."""
    paths, headings = _free(result)
    rows = [
        [f"optimum {place}", str(optimum.reached), f"{optimum.worse:.3g}"]
        + [_number(optimum.values[path] * factor) for path, factor in paths.items()]
        for place, optimum in enumerate(distinct_optima(result), 1)
    ]
    nothing = ["-"] * (1 + len(paths))
    rows += [[why, str(count), *nothing] for why, count in lost_starts(result).items()]
    return Table(["optimum or reason", "starts", "decrease of log-likelihood", *headings], rows, 1)


def own_table(result: FitResult) -> Table:
    """Return a table of the parameters of single runs, such as initial states, in column units."""
    factors = column_factors(result.model)
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    rows = []
    for run in result.runs:
        for path, own in run.parameters.items():
            factor = factors.get(path.partition("[")[0], 1.0)
            numbers = format_estimate(own.value * factor, _times(own.standard_error, factor))
            # The state of a run is not a parameter of the model, which would give its unit.
            unit = units.get(path, "SI") or "-"
            rows.append([run.name, path, *numbers, unit, own.remark or "-"])
    return Table(["run", "parameter", "value", "error", "unit", "remark"], rows, 2)


def file_rows(result: FitResult) -> Table:
    """Return a table of the fitted files with their checksums."""
    rows = {run.path: run.sha256 for run in result.runs if run.path}
    rows |= {record.path: record.sha256 for record in result.held_out if record.path}
    listed = {**rows, **result.task.get("inputs", {})}
    # A missing sidecar is listed, too, because its absence is part of the input.
    files = [[str(path), str(sha or "file did not exist")] for path, sha in listed.items()]
    return Table(["file", "SHA-256"], files, 2)


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _number(value: float | None, missing: str = "not finite") -> str:
    return format_number(value, ".4g", missing)
