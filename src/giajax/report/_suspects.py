"""Suspects, stepwise selection and systematic errors as tables of text cells."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..fitting import Estimate, FitResult, Suspect, SystematicError
from ..runtime.text import format_estimate, format_number
from ..studies import LEVEL, Contrast, Step, StepwiseSelection, Suspects, promising, together

Rows = list[list[str]]

SUSPECT_HEADINGS = ("suspect", "held at", "estimate", "error", "unit", "chi-square", "p", "remark")


def suspect_rows(found: Suspects, most: int = 10) -> Rows:
    """The most promising suspects, a row each under `SUSPECT_HEADINGS`.

    Arguments:
        found: the tests.
        most: rows; significant ones are shown in any case.
    """
    shown = found.promising[: max(most, len(found.significant))]
    return [_cells(row) for row in shown if row.chi_square_drop]


def first_suspects(result: FitResult, most: int = 3) -> Rows:
    """The first suspects that a result carries, as `suspect_rows`."""
    shown = [row for row in promising(result.suspects) if (row.p_value or 0.0) < LEVEL]
    return [_cells(row) for row in shown[:most]]


def _cells(row: Suspect) -> list[str]:
    value, estimate, error = row.value, row.estimate, row.estimate_error
    if isinstance(estimate, list) and isinstance(error, list):
        pairs = [format_estimate(a, b) for a, b in zip(estimate, error, strict=True)]
        shown = ", ".join(pair[0] for pair in pairs), ", ".join(pair[1] for pair in pairs)
    elif estimate is None:
        shown = "-", "-"
    else:
        shown = format_estimate(estimate, error if isinstance(error, float) else None)
    remarks = [row.note] if row.note else []
    if row.alike:
        remarks.append(f"the data can hardly tell it from {', '.join(row.alike)}")
    if row.kind == "switch" and estimate is not None:
        remarks.append("estimate: how much of the change, 0 to 1")
    if row.kind == "factor":
        remarks.append("a factor on all of its elements")
    return [
        row.path,
        _plain(value),
        *shown,
        row.unit or "-",
        f"-{row.chi_square_drop:.4g}",
        format_number(row.p_value, ".2g"),
        "; ".join(remarks),
    ]


def suspect_summary(found: Suspects) -> list[str]:
    """Sentences beside the table: what chi-square is, and what the data cannot tell."""
    sentences = [
        f"chi-square {found.chi_square:.5g} of {found.values} values and {found.parameters} "
        f"fitted parameters; {found.asked} tests, p-values corrected for their number"
    ]
    if not found.significant:
        sentences.append("no suspect is significant: nothing that can be freed is asked for")
    notes: dict[str, list[str]] = {}
    for row in found.untestable:
        notes.setdefault(row.note, []).append(row.path)
    for note, paths in notes.items():
        sentences.append(f"not testable, {note}: {', '.join(paths)}")
    return sentences


def stepwise_table(found: StepwiseSelection) -> tuple[list[str], Rows]:
    """Headings and a row for each fit: what it has more, how good it is, and its parameters."""
    first = list(found.steps[0].result.free)
    held_out = any(step.held_out is not None for step in found.steps)
    headings = ["added", "chi-square", "AIC", "BIC", *(["held out"] if held_out else []), *first]
    return headings, [_step_row(step, first, held_out=held_out) for step in found.steps]


def _step_row(step: Step, paths: Sequence[str], *, held_out: bool) -> list[str]:
    numbers = [step.chi_square, step.aic, step.bic]
    cells = [step.change, *(f"{number:.5g}" for number in numbers)]
    if held_out:
        cells.append(format_number(step.held_out, ".3g"))
    for path in paths:
        estimate = step.result.parameters.get(path)
        if estimate is None:
            cells.append("-")
            continue
        cells.append(" +- ".join(format_estimate(estimate.value, estimate.standard_error)))
    return cells


def systematic_table(result: FitResult) -> tuple[list[str], Rows]:
    """Headings and rows: what each held number does to each fitted parameter, in standard errors.

    Below them the statistical error, that of what was stated, and both in quadrature, in the unit
    of the parameter.
    """
    free = list(result.free)
    rows = [_held(result, error, free) for error in result.systematic]
    stated = together(result.systematic)
    statistical = [result.free[path].standard_error for path in free]
    rows.append(["statistical error", "", "", *_errors(statistical)])
    if stated:
        systematic = [stated.get(path, 0.0) for path in free]
        both = [
            None if error is None else float(np.hypot(error, other))
            for error, other in zip(statistical, systematic, strict=True)
        ]
        rows.append(["systematic error", "", "", *_errors(systematic)])
        rows.append(["both", "", "", *_errors(both)])
    return ["held", "at", "changed by", *free], rows


def _errors(values: Sequence[float | None]) -> list[str]:
    return [format_number(value, ".3g") for value in values]


def _held(result: FitResult, error: SystematicError, free: Sequence[str]) -> list[str]:
    cells = []
    for path in free:
        one = result.free[path].standard_error
        shift = error.shifts[path]
        cells.append(f"{shift / one:+.2g}" if one else format_number(shift, ".3g"))
    change = f"{error.uncertainty:.3g}{f' {error.unit}' if error.unit else ''}"
    return [error.path, _plain(error.value), change if error.stated else "1 %", *cells]


def _plain(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, list):
        low, high = min(value), max(value)
        return f"{low:.4g}" if low == high else f"{low:.4g} .. {high:.4g}"
    return f"{value:.4g}"


PLUS_MINUS = "\N{PLUS-MINUS SIGN}"


def contrast_tables(found: Contrast) -> tuple[tuple[list[str], Rows], tuple[list[str], Rows]]:
    """Headings and rows of two tables: of the parameters, and of the results as a whole."""
    names = [column.name for column in found.columns]
    headings = ["parameter", "unit", *names, *(f"{name} - {names[0]}" for name in names[1:])]
    rows = [
        [row.path, row.unit or "-", *map(estimate_cell, row.estimates)]
        + [format_number(difference, "+.2g") for difference in row.differences[1:]]
        for row in found.rows
    ]
    about = {
        "model": [column.model for column in found.columns],
        "status": [column.status.replace("_", " ") for column in found.columns],
        "verdict": [column.verdict for column in found.columns],
        "values": [str(column.values) for column in found.columns],
        "parameters": [str(column.parameters) for column in found.columns],
        "reduced chi-square": [
            format_number(column.reduced_chi_square) for column in found.columns
        ],
    }
    if any(column.bic is not None for column in found.columns):
        about["BIC, less the least"] = [format_number(column.bic) for column in found.columns]
    if any(column.held_out is not None for column in found.columns):
        about["held out, times what it may be off"] = [
            format_number(c.held_out) for c in found.columns
        ]
    return (headings, rows), (["", *names], [[name, *cells] for name, cells in about.items()])


def contrast_facts(found: Contrast) -> dict[str, Any]:
    """The same as data for JSON, in all digits."""

    def facts(one: Estimate | None) -> dict[str, Any] | None:
        if one is None:
            return None
        return {"value": one.value, "standard_error": one.standard_error, "free": one.free}

    return {
        "results": [vars(column) for column in found.columns],
        "parameters": [
            {
                "path": row.path,
                "unit": row.unit,
                "estimates": [facts(one) for one in row.estimates],
                "differences": list(row.differences),
            }
            for row in found.rows
        ],
        "notes": list(found.notes),
    }


def contrast_json(found: Contrast) -> str:
    """The same as text."""
    return json.dumps(contrast_facts(found), indent=2, allow_nan=False)


def estimate_cell(one: Estimate | None) -> str:
    """Value and error; of what was held or tied, that it was."""
    if one is None:
        return "-"
    value, error = format_estimate(one.value, one.standard_error)
    if error != "-":
        return f"{value} {PLUS_MINUS} {error}"
    # The remark of what was tied says to what, too, which is no text for a cell.
    return f"{value} ({'not determined' if one.free else one.remark.partition(':')[0] or 'held'})"
