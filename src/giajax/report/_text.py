"""A result as text: the parameter table and what else a reader must know."""

import math
import textwrap
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..fitting import Estimate, FitResult
from ..study import SAME_END, misfit
from ._units import in_column_units, units_note

# A remark that would be squeezed into fewer columns than this goes below its row instead.
_LEAST_REMARK = 36

# Digits of a value that has no standard error to say how many it deserves.
_DIGITS = 6

# Below this a number is written with an exponent: nobody counts five zeros.
_LEAST_FIXED = 1e-4

# More lines of residuals than this are summed up.
_MANY = 8

# The messages of the two others begin with their status.
_SHOUTED = {"not_converged": "NOT CONVERGED: "}


def format_estimate(value: Any, standard_error: float | None) -> tuple[str, str]:
    """A value and its standard error with the digits that they deserve.

    The error has two significant digits and the value ends at the same decimal place.

    Example:
        >>> format_estimate(1.0496623, 0.0060814)
        ('1.0497', '0.0061')
    """
    if value is None:
        return "-", "-"
    if isinstance(value, list):
        low, high = min(value), max(value)
        text = f"{low:.{_DIGITS}g}"
        return (text if low == high else f"{text} .. {high:.{_DIGITS}g}"), "-"
    if standard_error is None or not math.isfinite(standard_error) or standard_error <= 0:
        return f"{value:.{_DIGITS}g}", "-"
    # Through the rounded number: 0.0999 becomes 0.10, not 0.100.
    exponent = int(f"{standard_error:.1e}".partition("e")[2])
    decimals = 1 - exponent
    if max(abs(value), standard_error) >= _LEAST_FIXED and -4 <= decimals <= 7:
        places = max(decimals, 0)
        return (
            f"{round(value, decimals):.{places}f}",
            f"{round(standard_error, decimals):.{places}f}",
        )
    digits = 0 if value == 0 else math.floor(math.log10(abs(value))) - exponent + 1
    return f"{value:.{min(max(digits, 0), 15)}e}", f"{standard_error:.1e}"


def parameter_table(result: FitResult, width: int | None = None) -> str:
    """The free and the fixed parameters: value, standard error, unit, bounds and remark.

    Arguments:
        result: the result of a fit.
        width: columns that there are. Where the remarks do not fit, each goes below its row.
            Without a width nothing is wrapped: a row is a line, for grep and awk.
    """
    headings = ["parameter", "value", "error", "unit", "bounds", "remark"]
    estimates = in_column_units(_shown(result), result.model)
    rows = [_row(path, estimate) for path, estimate in estimates.items()]
    widths = [max(len(row[i]) for row in [headings, *rows]) for i in range(5)]
    before = sum(widths) + 2 * len(widths)
    longest = max(len(row[5]) for row in [headings, *rows])
    below = width is not None and width - before < min(longest, _LEAST_REMARK)
    lines: list[str] = []
    for row in [headings[:5] if below else headings, *rows]:
        cells = [
            cell.rjust(size) if column in (1, 2) else cell.ljust(size)
            for column, (cell, size) in enumerate(zip(row[:5], widths, strict=True))
        ]
        start, remark = "  ".join(cells), "".join(row[5:])
        if below:
            lines += [start.rstrip(), *_wrap(remark, width, "    ", "    ")]
        else:
            lines += _wrap(remark, width, start + "  ", " " * before) or [start.rstrip()]
    return "\n".join(lines)


def summary(result: FitResult, width: int | None = None) -> str:
    """How the fit ended, how well it describes the data, and what its values rest on."""
    label = 20
    lines: list[str] = []
    for name, text in summary_rows(result):
        lines += _wrap(text, width, name.ljust(label), " " * label)
    return "\n".join(lines)


def summary_rows(result: FitResult) -> list[tuple[str, str]]:
    """The summary as pairs of a label (which may be empty) and a sentence."""
    rows = [("status", _SHOUTED.get(result.status, "") + result.message)]
    rows += _labelled("units", [note] if (note := units_note(_shown(result), result.model)) else [])
    rows.append(("cost", _number(result.cost)))
    rows.append(("reduced chi-square", _number(result.reduced_chi_square)))
    rows += _labelled("starts", _starts(result))
    residuals = [text for run in result.runs for text in _residuals(run)]
    if len(residuals) > _MANY:
        residuals = _over_runs(result.runs, "residuals of")
    rows += _labelled("residuals", residuals)
    own = [run["parameters"] for run in result.runs if run.get("parameters")]
    if own:
        text = f"{sum(map(len, own))} values of {len(own)} runs alone were fitted, too"
        rows.append(("initial states", f"{text}; result.json has them"))
    validation = [text for run in result.validation for text in _errors(run)]
    if len(validation) > _MANY:
        validation = _over_runs(result.validation, "prediction of")
    rows += _labelled("validation", validation)
    strongest = _strongest_correlation(result)
    if strongest:
        rows.append(("correlation", strongest))
    rows.append(("gradient check", _gradient(result)))
    rows.append(("solver tolerance", _tolerance(result)))
    for index, condition in enumerate(result.conditions):
        rows.append(("conditions" if index == 0 else "", condition))
    seconds = result.seconds
    rows.append(
        ("time", f"{seconds['run']:.2g} s, and {seconds['compile']:.2g} s to compile or load")
    )
    return rows


def _labelled(label: str, texts: Sequence[str]) -> list[tuple[str, str]]:
    return [(label if index == 0 else "", text) for index, text in enumerate(texts)]


def _starts(result: FitResult) -> list[str]:
    """How many starts ended where the result is."""
    if not result.starts:
        return []
    best = misfit(result)
    values = sum(channel["n"] for run in result.runs for channel in run["channels"].values())
    ends = [start["misfit"] for start in result.starts if start.get("misfit") is not None]
    near = sum(end - best < SAME_END * values for end in ends)
    text = f"{near} of {len(result.starts)} ended here"
    others = sorted((end - best) / values for end in ends if end - best >= SAME_END * values)
    if others:
        text += f"; the others are worse by {others[0]:.2g} to {others[-1]:.2g} in log-likelihood "
        text += "per value"
    return [text]


def _over_runs(runs: Sequence[dict[str, Any]], what: str) -> list[str]:
    """One line a channel for many runs: smallest, median and largest RMSE."""
    table: dict[tuple[str, str], list[float]] = {}
    for run in runs:
        for name, record in run["channels"].items():
            if record["rmse"] is not None:
                table.setdefault((name, record["unit"]), []).append(record["rmse"])
    lines = []
    for (name, unit), values in table.items():
        low, middle, high = np.quantile(values, [0.0, 0.5, 1.0])
        shown = f"{_rmse(low)} to {_rmse(high)}, median {_rmse(middle)}"
        lines.append(f"{what} {len(values)} runs: {name} RMSE {shown}{f' {unit}' if unit else ''}")
    return lines


def _errors(run: dict[str, Any]) -> list[str]:
    """RMSE of the prediction of a run that was not fitted."""
    by_unit: dict[str, list[str]] = {}
    for name, record in run["channels"].items():
        by_unit.setdefault(record["unit"], []).append(f"{name} {_rmse(record['rmse'])}")
    return [
        f"{run['name']}: RMSE {', '.join(shown)}{f' {unit}' if unit else ''}"
        for unit, shown in by_unit.items()
    ]


def _shown(result: FitResult) -> dict[str, Estimate]:
    """The free parameters, what follows from them, and those that somebody chose to hold."""
    chosen = [path.partition("[")[0] for path in result.config.get("fix", {})]
    held = {path: result.parameters[path] for path in chosen if path in result.parameters}
    return {**result.free, **result.derived, **held}


def _row(path: str, estimate: Estimate) -> list[str]:
    value, error = format_estimate(estimate.value, estimate.standard_error)
    bounds = _bounds(estimate.lower, estimate.upper)
    return [path, value, error, estimate.unit or "-", bounds, estimate.remark]


def _bounds(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return "-"
    if upper is None:
        return f"> {lower:g}"
    return f"< {upper:g}" if lower is None else f"{lower:g} .. {upper:g}"


def _number(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.5g}"


def _rmse(value: float | None) -> str:
    return "not finite" if value is None else f"{value:.3g}"


def _residuals(run: dict[str, Any]) -> list[str]:
    """One line for a few channels, one line per unit for many."""
    channels = run["channels"]
    by_unit: dict[str, list[str]] = {}
    for name, record in channels.items():
        by_unit.setdefault(record["unit"], []).append(name)
    lines = []
    for unit, names in by_unit.items():
        known = {name: channels[name]["rmse"] for name in names}
        known = {name: rmse for name, rmse in known.items() if rmse is not None}
        values = sum(channels[name]["n"] for name in names)
        noise = sorted({channels[name]["noise"] for name in names})
        if len(names) <= 4:
            shown = ", ".join(f"{name} {_rmse(known.get(name))}" for name in names)
        elif known:
            worst = max(known, key=lambda name: known[name])
            best = min(known, key=lambda name: known[name])
            shown = f"{_rmse(known[best])} ({best}) to {_rmse(known[worst])} ({worst})"
        else:
            shown = "not finite"
        against = f"{noise[0]:.3g}" + (f" to {noise[-1]:.3g}" if noise[-1] > noise[0] else "")
        lines.append(
            f"{run['name']}: RMSE {shown}{f' {unit}' if unit else ''}; noise {against}; "
            f"{len(names)} channel{'s' * (len(names) > 1)}, {values} values"
        )
    return lines


def _strongest_correlation(result: FitResult) -> str:
    paths, matrix = result.correlation["parameters"], result.correlation["matrix"]
    pairs = [
        (abs(matrix[i][j]), i, j)
        for i in range(len(paths))
        for j in range(i)
        if matrix[i][j] is not None
    ]
    if not pairs:
        return ""
    _, i, j = max(pairs)
    return f"at most {matrix[i][j]:+.3f}, between {paths[j]} and {paths[i]}"


# A fit with derivatives wrong by this much may stop anywhere. In 64-bit a good one has 1e-5.
_WRONG_DERIVATIVES = 1e-2


def _gradient(result: FitResult) -> str:
    check = result.gradient_check
    if check is None:
        return "not done"
    relative = check["relative_difference"]
    if relative > _WRONG_DERIVATIVES:
        return f"derivatives DISAGREE with differences, by {relative:.1e} (relative)"
    return f"derivatives agree with differences to {relative:.1e} (relative)"


def _tolerance(result: FitResult) -> str:
    effect = result.tolerance_effect
    largest = None if effect is None else effect["largest_in_standard_errors"]
    if largest is None:
        return "effect not known"
    return f"halving it moves no parameter by more than {largest:.1e} standard errors"


def _wrap(text: str, width: int | None, first: str, others: str) -> Sequence[str]:
    if not text:
        return []
    if width is None:
        return [first + text]
    return textwrap.wrap(
        text,
        width=max(width, len(others) + 20),
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )
