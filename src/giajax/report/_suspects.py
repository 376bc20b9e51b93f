"""Display suspects, stepwise selection and systematic errors as tables of text cells."""

import json
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from ..fitting import Estimate, FitResult, Suspect, SystematicError
from ..runtime.text import format_estimate, format_number
from ..studies import (
    LEVEL,
    Contrast,
    ExplainedStep,
    Explanation,
    StepwiseSelection,
    Suspects,
    behind,
    promising,
    together,
)
from ._views import PageSection, RecordView, Table

Rows = list[list[str]]

SUSPECT_HEADINGS = (
    "suspect",
    "fixed value",
    "estimate",
    "error",
    "unit",
    "change in chi-square",
    "p-value",
    "remark",
)


def suspect_rows(found: Suspects, most: int = 10) -> Rows:
    """Return the most promising suspects, and all significant ones, under `SUSPECT_HEADINGS`."""
    shown = [row for row in found.promising if row.chi_square_drop and not row.explained_by]
    surely = sum(not row.explained_by for row in found.significant)
    return [_cells(row) for row in shown[: max(most, surely)]]


def first_suspects(result: FitResult, most: int = 3) -> Rows:
    """Return the first suspects of a result, in the form of `suspect_rows`."""
    return [_cells(row) for row in significant(result)[:most]]


def significant(result: FitResult) -> list[Suspect]:
    """Return the significant suspects of a result, the most promising first, a group as one.

    For an adequate model the list is empty, because one in twenty has a suspect by chance.
    """
    if result.verdict.status == "adequate":
        return []
    return [
        row
        for row in promising(result.suspects)
        if (row.p_value or 0.0) < LEVEL and not row.explained_by
    ]


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
    if row.begun:
        remarks.append("tested at the initial values of the fit")
    if others := dict.fromkeys([*row.alike, *row.together]):
        remarks.append(f"the data can hardly distinguish it from {', '.join(others)}")
    if row.kind == "switch" and estimate is not None:
        remarks.append("the estimate is the fraction of the change, from 0 to 1")
    if row.kind == "factor":
        remarks.append("the estimate is a common factor of all elements")
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
    """Return sentences for the table: the chi-square, and what the data cannot test."""
    sentences = [
        f"chi-square {found.chi_square:.5g} for {found.values} values and {found.parameters} "
        f"fitted parameters; {found.asked} tests, with p-values corrected for multiple testing"
    ]
    if not found.significant:
        sentences.append("no suspect is significant")
    notes: dict[str, list[str]] = {}
    for row in found.untestable:
        notes.setdefault(row.note, []).append(row.path)
    for note, paths in notes.items():
        sentences.append(f"not testable, {note}: {', '.join(paths)}")
    return sentences


def stepwise_table(found: StepwiseSelection) -> tuple[list[str], Rows]:
    """Return headings and a row for each fit: its addition, fit statistics, and parameters."""
    first = list(found.steps[0].result.free)
    held_out = any(step.held_out is not None for step in found.steps)
    judged = ["held-out error"] if held_out else []
    headings = ["added", "chi-square", "AIC", "BIC", *judged, *first]
    return headings, [
        [
            step.change,
            *(f"{number:.5g}" for number in (step.chi_square, step.aic, step.bic)),
            *([format_number(step.held_out, ".3g")] if held_out else []),
            *(_estimate(step.result.parameters.get(path)) for path in first),
        ]
        for step in found.steps
    ]


def explained_table(found: Explanation, rows: Sequence[ExplainedStep]) -> Table:
    """Return headings and a row for each fit: its change, fit statistics, and the parameters."""
    paths = [one.path for one in found.parameters]
    headings = ["step", "chi-square", "BIC", "p-value", "held-out error", *paths]
    return Table(
        headings,
        [
            [
                row.change,
                f"{row.chi_square:.5g}",
                f"{row.bic:.5g}",
                format_number(row.p_value, ".2g"),
                format_number(row.held_out, ".3g"),
                *(" +- ".join(format_estimate(*row.estimates[path])) for path in paths),
            ]
            for row in rows
        ],
    )


def explained_summary(found: Explanation) -> list[str]:
    """Return sentences on the findings, the end of the search, and its reliability."""
    added = ", ".join(found.added) or "nothing"
    last = found.steps[-1]
    sentences = [
        f"the data support {added} in addition to the first model; {found.ending}",
        f"verdict: {found.verdict}" + "".join(f"; {one}" for one in found.sentences[:1]),
        f"chi-square {last.chi_square:.5g} for {last.values} values and {last.parameters} fitted "
        "parameters",
    ]
    if judged := [step for step in found.steps if step.held_out is not None]:
        later = "".join(f" before {step.change}" for step in found.steps if step.kind == "data")
        off, off_first = judged[-1].held_out, judged[0].held_out
        sentences.append(
            f"the prediction error of the held-out data{later} is {off:.3g} times the noise of "
            f"these data ({off_first:.3g} times with the first model)"
        )
    if found.outliers:
        sentences.append(
            f"{found.outliers} outliers were found; the final fit uses the loss {found.loss}"
        )
    near = ", ".join(
        f"{found.tried[i].change} ({behind(found.steps, found.tried[i])[0]:+.2g})"
        for i in found.near
    )
    sentences.append(
        f"other tested models with a BIC within {found.nearness:g} of the selected model: {near}"
        if near
        else f"no other tested model has a BIC within {found.nearness:g} of the selected model"
    )
    if len(found.steps) > 1:
        for one in found.parameters:
            value, error = format_estimate(one.value, one.total_error)
            unit = f" {one.unit}" if one.unit else ""
            sentences.append(
                f"{one.path} = {value} +- {error}{unit}, where "
                f"{format_number(one.selection_error, '.2g')} of the error is due to the other "
                "models that fit nearly as well as the selected one"
            )
        sentences.append(
            "the errors are conditional on a model that was selected with the same data"
        )
    if found.axes:
        sentences.append("the runs with corrected columns are stored in the folder of explain.json")
    return sentences


RecordView(
    place=0,
    record=Explanation,
    table=lambda found, result, most: explained_table(found, found.steps),
    sentences=lambda found, most: explained_summary(found),
    section=lambda found, result, folder: PageSection(
        id="explained",
        name="Explanation",
        heading="Model extensions supported by the data",
        early=True,
        table=explained_table(found, [*found.steps, *(found.tried[i] for i in found.near)]),
        sentences=explained_summary(found),
        note="One row for each step, followed by one row for each other model that fits nearly as "
        "well as the selected one. Chi-square and BIC are computed with the white noise "
        "of the last step.",
    ),
)


def _estimate(one: Estimate | None) -> str:
    return "-" if one is None else " +- ".join(format_estimate(one.value, one.standard_error))


def systematic_table(result: FitResult) -> tuple[list[str], Rows]:
    """Return headings and the effect of each held number on each parameter, in standard errors.

    Below them are the statistical error, the error due to the stated uncertainties, and their sum
    in quadrature, in the unit of the parameter.
    """
    statistical = {path: one.standard_error for path, one in result.free.items()}
    rows = [_held(error, statistical) for error in result.systematic]
    below: dict[str, Iterable[float | None]] = {"statistical error": statistical.values()}
    if stated := together(result.systematic):
        systematic = [stated.get(path, 0.0) for path in statistical]
        below["systematic error"] = systematic
        below["both"] = [
            None if error is None else float(np.hypot(error, other))
            for error, other in zip(statistical.values(), systematic, strict=True)
        ]
    for name, errors in below.items():
        rows.append([name, "", "", *(format_number(value, ".3g") for value in errors)])
    return ["fixed parameter", "value", "change", *statistical], rows


def _held(error: SystematicError, statistical: Mapping[str, float | None]) -> list[str]:
    cells = []
    for path, one in statistical.items():
        shift = error.shifts[path]
        if not one:
            cells.append(format_number(shift, ".3g"))
            continue
        # Shifts of less than a millionth of a standard error are rounding errors.
        cells.append("0" if abs(shift) < 1e-6 * one else f"{shift / one:+.2g}")
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


def contrast_tables(found: Contrast) -> tuple[Table, Table]:
    """Return two tables: of the parameters, and of the results."""
    names = [column.name for column in found.columns]
    headings = ["parameter", "unit", *names, *(f"{name} - {names[0]}" for name in names[1:])]
    rows = [
        [row.path, row.unit or "-", *map(estimate_cell, row.estimates)]
        + [format_number(difference, "+.2g") for difference in row.differences[1:]]
        for row in found.rows
    ]
    columns = found.columns
    about = {
        "model": [column.model for column in columns],
        "status": [column.status.replace("_", " ") for column in columns],
        "verdict": [column.verdict for column in columns],
        "values": [str(column.values) for column in columns],
        "parameters": [str(column.parameters) for column in columns],
        "reduced chi-square": [format_number(column.reduced_chi_square) for column in columns],
    }
    if any(column.bic is not None for column in columns):
        about["BIC minus lowest BIC"] = [format_number(column.bic) for column in columns]
    if any(column.held_out is not None for column in columns):
        words = "held out: error / expected error"
        about[words] = [format_number(column.held_out) for column in columns]
    whole = Table(["", *names], [[name, *cells] for name, cells in about.items()])
    return Table.of_parameters(headings, rows, 2), whole


def contrast_json(found: Contrast) -> str:
    """Return the same tables as JSON, at full precision."""

    def facts(one: Estimate | None) -> dict[str, Any] | None:
        if one is None:
            return None
        return {"value": one.value, "standard_error": one.standard_error, "free": one.free}

    whole = {
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
    return json.dumps(whole, indent=2, allow_nan=False)


def estimate_cell(one: Estimate | None) -> str:
    """Return value and error of an estimate, or that it was held or tied."""
    if one is None:
        return "-"
    value, error = format_estimate(one.value, one.standard_error)
    if error != "-":
        return f"{value} {PLUS_MINUS} {error}"
    # The remark of a tied parameter includes the expression, which is too long for a cell.
    return f"{value} ({'not determined' if one.free else one.remark.partition(':')[0] or 'held'})"
