"""The correlation matrix as coloured cells of a table."""

import math
from typing import NamedTuple

from ...fitting import FitResult

# A correlation's colour is mixed of white and one of these.
_POSITIVE, _NEGATIVE = (213, 94, 0), (0, 114, 178)


class Cell(NamedTuple):
    """A correlation: as text, its colours, and what it is between."""

    text: str
    background: str
    ink: str
    about: str


def correlation_cells(result: FitResult) -> list[list[Cell]]:
    """The lower half of the correlation matrix, a row for each parameter after the first."""
    paths = result.correlation.parameters
    return [
        [
            _cell(value, f"{paths[i]} and {paths[j]}")
            for j, value in enumerate(result.correlation.matrix[i][:i])
        ]
        for i in range(len(paths))
    ]


def _cell(value: float | None, about: str) -> Cell:
    # In memory it is not a number where in a file it is null.
    if value is None or not math.isfinite(value):
        return Cell("?", "#ffffff", "#222222", about)
    size = min(abs(value), 1.0)
    end = _POSITIVE if value > 0 else _NEGATIVE
    mixed = "".join(f"{round(255 + (part - 255) * size):02x}" for part in end)
    # Three digits where two would round to one, which no correlation here is.
    text = f"{value:.{3 if size >= 0.995 else 2}f}"
    return Cell(text, f"#{mixed}", "#ffffff" if size > 0.6 else "#222222", f"{about}: {value:+.4f}")
