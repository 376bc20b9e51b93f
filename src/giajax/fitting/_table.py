"""Estimates as a table: for a terminal, and for a notebook."""

import html
from collections.abc import Mapping
from typing import NamedTuple

from .._text import format_bounds, format_estimate, wrapped
from ._records import Estimate

# A remark that would be squeezed into fewer columns than this goes below its row instead.
_LEAST_REMARK = 36

_NUMBERS = ("value", "error")


class _Row(NamedTuple):
    """The cells of one estimate; their names are the headings."""

    parameter: str
    value: str
    error: str
    unit: str
    bounds: str
    remark: str


def estimate_table(estimates: Mapping[str, Estimate], width: int | None = None) -> str:
    """Value, standard error, unit, bounds and remark of each estimate, a line each.

    Arguments:
        estimates: by path.
        width: columns that there are. Where the remarks do not fit, each goes below its row.
            Without a width nothing is wrapped: a row is a line, for grep and awk.

    Returns:
        The lines, without a newline at the end.
    """
    headings = _Row(*_Row._fields)
    rows = _rows(estimates)
    sizes = {name: max(len(getattr(row, name)) for row in (headings, *rows)) for name in _short()}
    before = sum(sizes.values()) + 2 * len(sizes)
    longest = max(len(row.remark) for row in (headings, *rows))
    below = width is not None and width - before < min(longest, _LEAST_REMARK)
    lines: list[str] = []
    for row in (headings._replace(remark="") if below else headings, *rows):
        cells = [_aligned(name, getattr(row, name), size) for name, size in sizes.items()]
        start = "  ".join(cells)
        if below:
            lines += [start.rstrip(), *wrapped(row.remark, width, "    ", "    ")]
        else:
            lines += wrapped(row.remark, width, start + "  ", " " * before) or [start.rstrip()]
    return "\n".join(lines)


def estimate_html(estimates: Mapping[str, Estimate]) -> str:
    """The same table as HTML."""
    head = "".join(f"<th>{heading}</th>" for heading in _Row._fields)
    body = "".join(
        "<tr>" + "".join(f"<td>{html.escape(cell)}</td>" for cell in row) + "</tr>"
        for row in _rows(estimates)
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _short() -> tuple[str, ...]:
    """The columns beside that of the remarks."""
    return _Row._fields[:-1]


def _aligned(name: str, cell: str, size: int) -> str:
    return cell.rjust(size) if name in _NUMBERS else cell.ljust(size)


def _rows(estimates: Mapping[str, Estimate]) -> list[_Row]:
    rows = []
    for path, estimate in estimates.items():
        value, error = format_estimate(estimate.value, estimate.standard_error)
        bounds = format_bounds(estimate.lower, estimate.upper)
        rows.append(_Row(path, value, error, estimate.unit or "-", bounds, estimate.remark))
    return rows
