"""The page about several results."""

from collections.abc import Sequence
from typing import Any

from ...fitting import FitResult
from ...studies import Contrast, ContrastRow
from .. import BLUE, GREEN, GREY, INK, VERMILLION, contrast_tables
from .._style import ORANGE, PURPLE, SKY
from .._views import Table
from ._render import rendered, some_of
from ._report import opening

# Width of the picture of one parameter and height of a result in it, pixels.
_WIDTH, _HEIGHT = 360.0, 15.0

_COLOURS = (BLUE, VERMILLION, GREEN, INK, GREY, PURPLE, ORANGE, SKY)

_DIFFERENT = 3.0  # so many joint standard errors are a difference


def compare_page(found: Contrast, results: Sequence[FitResult]) -> bytes:
    """As of `giajax.report.compare_page`."""
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
        parameters=Table(*parameters, 2),
        whole=Table(*whole, 1),
        pictures=[(row.path, bars) for row in found.rows if len(bars := _bars(row, names)) > 1],
        height=_HEIGHT * len(names) + 6,
        width=_WIDTH,
        apart=apart,
        notes=found.notes,
    )


def _verdict(found: Contrast, apart: Sequence[str]) -> tuple[str, str]:
    """A grade, which colours it, and one sentence."""
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
        "No parameter that both determine differs from the first result by more than "
        f"{_DIFFERENT:g} joint standard errors"
    )
    if alone:
        return (
            "doubtful",
            f"{agree}, but it has no parameter in common with {', '.join(some_of(alone))}",
        )
    if any(column.status != "converged" for column in found.columns):
        return "doubtful", f"{agree}, but not every fit has converged"
    return "good", agree


def _apart(found: Contrast) -> list[str]:
    """Sentences on the parameters that differ."""
    names = [column.name for column in found.columns]
    return [
        f"{row.path} of {names[index]} is {abs(difference):.2g} joint standard errors "
        f"{'above' if difference > 0 else 'below'} that of {names[0]}"
        for row in found.rows
        for index, difference in enumerate(row.differences)
        if difference is not None and abs(difference) > _DIFFERENT
    ]


def _bars(row: ContrastRow, names: Sequence[str]) -> list[dict[str, Any]]:
    """Values with two standard errors on an axis of their own, in pixels; held ones are ticks."""
    known = [
        (index, one.value, 2 * (one.standard_error or 0.0))
        for index, one in enumerate(row.estimates)
        if one is not None and isinstance(one.value, float)
    ]
    if not any(width for _, _, width in known):
        return []
    low = min(value - width for _, value, width in known)
    high = max(value + width for _, value, width in known)
    scale = (_WIDTH - 20) / ((high - low) or 1.0)
    return [
        {
            "low": 10 + (value - width - low) * scale,
            "middle": 10 + (value - low) * scale,
            "high": 10 + (value + width - low) * scale,
            "across": _HEIGHT * (index + 0.5) + 3,
            "colour": _COLOURS[index % len(_COLOURS)],
            "text": f"{names[index]}: {value:.6g}",
        }
        for index, value, width in known
    ]
