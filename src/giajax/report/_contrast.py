"""Results side by side as tables of text cells, and as plain data."""

import json
from typing import Any

from .._text import format_estimate
from ..fitting import Estimate
from ..study import Contrast

Rows = list[list[str]]

PLUS_MINUS = "\N{PLUS-MINUS SIGN}"


def contrast_tables(found: Contrast) -> tuple[tuple[list[str], Rows], tuple[list[str], Rows]]:
    """Headings and rows of two tables: of the parameters, and of the results as a whole."""
    names = [column.name for column in found.columns]
    headings = ["parameter", "unit", *names, *(f"{name} - {names[0]}" for name in names[1:])]
    rows = [
        [row.path, row.unit or "-", *map(estimate_cell, row.estimates)]
        + [_signed(difference) for difference in row.differences[1:]]
        for row in found.rows
    ]
    about = {
        "model": [column.model for column in found.columns],
        "status": [column.status.replace("_", " ") for column in found.columns],
        "verdict": [column.verdict for column in found.columns],
        "values": [str(column.values) for column in found.columns],
        "parameters": [str(column.parameters) for column in found.columns],
        "reduced chi-square": [_number(column.reduced_chi_square) for column in found.columns],
    }
    if any(column.bic is not None for column in found.columns):
        about["BIC, less the least"] = [_number(column.bic) for column in found.columns]
    if any(column.held_out is not None for column in found.columns):
        about["held out, times what it may be off"] = [_number(c.held_out) for c in found.columns]
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


def _signed(value: float | None) -> str:
    return "-" if value is None else f"{value:+.2g}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"
