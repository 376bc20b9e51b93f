"""Page that compares several results."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...fitting import FitResult
from ...studies import Contrast, ContrastRow
from .. import BLUE, GREEN, GREY, INK, VERMILLION, contrast_tables
from .._style import ORANGE, PURPLE, SKY
from ._render import rendered, some_of
from ._report import opening

# Width and margins of the picture of one parameter, and height of a result in it, pixels.
_WIDTH, _MARGIN, _HEIGHT = 360.0, 24.0, 15.0

_COLOURS = (BLUE, VERMILLION, GREEN, INK, GREY, PURPLE, ORANGE, SKY)

_DIFFERENT = 3.0  # minimum difference in units of the joint standard error


def compare_page(found: Contrast, results: Sequence[FitResult]) -> bytes:
    """Return the page of `giajax.report.compare_page`."""
    parameters, whole = contrast_tables(found)
    names = [column.name for column in found.columns]
    apart = _apart(found)
    grade, headline = _verdict(found, apart)
    return rendered(
        "compare.html",
        plots=False,
        title=", ".join(some_of(names)),
        grade=grade,
        headline=headline,
        names=names,
        colours=[_COLOURS[index % len(_COLOURS)] for index in range(len(names))],
        openings=list(zip(names, map(opening, results), strict=True)),
        parameters=parameters,
        whole=whole,
        pictures=[
            (row.path, row.unit, *drawn) for row in found.rows if (drawn := _drawn(row, names))
        ],
        bottom=_HEIGHT * len(names) + 6,
        width=_WIDTH,
        apart=apart,
        notes=found.notes,
    )


def _verdict(found: Contrast, apart: Sequence[str]) -> tuple[str, str]:
    """Return a grade, which determines the colour, and one sentence."""
    if apart:
        return "doubtful", "The results differ by more than their errors"
    others = list(enumerate(found.columns))[1:]
    alone = [
        column.name
        for index, column in others
        if all(row.differences[index] is None for row in found.rows)
    ]
    if len(alone) == len(others):
        return "doubtful", (
            "No parameter is determined both by the first result and by another result, so "
            "nothing is compared"
        )
    agree = (
        "No parameter that both results determine differs from the first result by more than "
        f"{_DIFFERENT:g} joint standard errors"
    )
    if alone:
        return (
            "doubtful",
            f"{agree}, but the first result has no parameter in common with "
            f"{', '.join(some_of(alone))}",
        )
    if any(column.status != "converged" for column in found.columns):
        return "doubtful", f"{agree}, but not every fit has converged"
    return "good", agree


def _apart(found: Contrast) -> list[str]:
    """Return sentences on the parameters that differ."""
    names = [column.name for column in found.columns]
    return [
        f"{row.path} of {names[index]} is {abs(difference):.2g} joint standard errors "
        f"{'above' if difference > 0 else 'below'} that of {names[0]}"
        for row in found.rows
        for index, difference in enumerate(row.differences)
        if difference is not None and abs(difference) > _DIFFERENT
    ]


def _drawn(
    row: ContrastRow, names: Sequence[str]
) -> tuple[list[dict[str, Any]], list[tuple[float, str]]] | None:
    """Return the marks of each result in the picture of a parameter, and its ticks, in pixels.

    A value has a bar of two standard errors, a held value is a tick, and a free parameter that is
    not determined is a word. None if fewer than two results have a value, or none has an error.
    """
    known = {
        index: (one.value, 2 * (one.standard_error or 0.0))
        for index, one in enumerate(row.estimates)
        if one is not None
        and isinstance(one.value, float)
        and (one.standard_error is not None or not one.free)
    }
    if len(known) < 2 or not any(width for _, width in known.values()):
        return None
    low = min(value - width for value, width in known.values())
    high = max(value + width for value, width in known.values())
    scale = (_WIDTH - 2 * _MARGIN) / ((high - low) or 1.0)
    marks = []
    for index, one in enumerate(row.estimates):
        about: dict[str, Any] = {
            "across": _HEIGHT * (index + 0.5) + 3,
            "colour": _COLOURS[index % len(_COLOURS)],
            "word": "",
            "middle": None,
        }
        if index in known:
            value, width = known[index]
            places = [_MARGIN + (at - low) * scale for at in (value - width, value, value + width)]
            about |= dict(zip(("low", "middle", "high"), places, strict=True))
            assert one is not None
            about |= {"held": not one.free, "text": f"{names[index]}: {value:.6g} {row.unit}"}
        elif one is not None:
            about["word"] = "not determined" if isinstance(one.value, float) else "an array"
        marks.append(about)
    return marks, [(_MARGIN + (tick - low) * scale, f"{tick:.6g}") for tick in _ticks(low, high)]


def _ticks(low: float, high: float) -> list[float]:
    """Return about four round numbers within an interval."""
    rough = ((high - low) or abs(high) or 1.0) / 4
    power = 10.0 ** np.floor(np.log10(rough))
    step = float(power * next(each for each in (1, 2, 5, 10) if each * power >= rough * (1 - 1e-9)))
    first, last = np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9)
    # Adding 0.0 turns -0.0 into 0.0.
    return [float(step * k) + 0.0 for k in np.arange(first, last + 1)]
