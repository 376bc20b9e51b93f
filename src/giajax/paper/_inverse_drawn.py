"""What the eight cells of table 3 say of an arm, and what they leave open, in a picture."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ..report import BLUE, GREY, INK, VERMILLION, new_figure, plain
from ._inverse_search import CELLS, ROUNDING, SearchEnd
from ._readings import READINGS

_COLOURS = {"memory": BLUE, "own": VERMILLION}

# Of a share of a direction that is worth a word.
_WORTH = 0.25


def nearest(ends: Sequence[SearchEnd]) -> SearchEnd:
    """The search that ended nearest to the printed cells."""
    sizes = [rms(end) if np.isfinite(rms(end)) else np.inf for end in ends]
    return ends[int(np.argmin(sizes))]


def rms(end: SearchEnd) -> float:
    """Root mean square of the errors of the cells, percentage points."""
    return float(np.sqrt(np.mean(end.misfit**2)))


def directions(end: SearchEnd) -> tuple[np.ndarray, np.ndarray]:
    """Singular values and right singular vectors of the Jacobian.

    Where joints remember, derivatives may be no slopes of the cells: columns that are far
    from differences are replaced by these.

    Arguments:
        end: of a search.

    Returns:
        Percentage points a unit of the logarithms, shape (8,), and a row of shares for each
        direction, shape (free, free): of those beyond the eighth nothing is known.
    """
    jacobian = np.where(rough(end), end.checked, end.jacobian)
    if not np.all(np.isfinite(jacobian)):
        count = jacobian.shape[1]
        return np.full(len(CELLS), np.nan), np.full((count, count), np.nan)
    _, sizes, rows = np.linalg.svd(jacobian, full_matrices=True)
    # The largest share of each is positive.
    return sizes, rows * np.sign(rows[np.arange(len(rows)), np.abs(rows).argmax(axis=1)])[:, None]


def rough(end: SearchEnd) -> np.ndarray:
    """Which derivatives are off from differences by more than a tenth and a point."""
    off = np.abs(end.jacobian - end.checked).max(axis=0)
    return np.asarray(off > np.maximum(0.1 * np.abs(end.checked).max(axis=0), 1.0))


def in_words(row: np.ndarray, names: Sequence[str]) -> str:
    """A direction as a product of powers, those with a share that is worth a word."""
    order = [at for at in np.argsort(-np.abs(row)) if abs(row[at]) >= _WORTH]
    return " ".join(f"{names[at]}^{row[at]:.2f}" for at in order)


def drawn(ends: Sequence[SearchEnd], title: str) -> Figure:
    """Singular values of all searches, and the directions of the nearest."""
    figure = new_figure(11, 5.4, title)
    left, right = figure.subplots(1, 2)
    for end in ends:
        left.plot(
            np.arange(1, len(CELLS) + 1),
            directions(end)[0],
            color=_COLOURS[end.reading],
            marker="o",
            markersize=3.5,
            linewidth=0.8,
            alpha=0.8,
            label=READINGS[end.reading].label if end.number == 1 else None,
        )
    for share in (0.1, 1.0):
        left.axhline(ROUNDING / share, color=GREY, linewidth=0.8, linestyle=(0, (4, 2)))
        left.annotate(
            f"half a point is {share:.0%}",
            (1, ROUNDING / share),
            xytext=(0, 3),
            textcoords="offset points",
            fontsize=7,
            color=GREY,
        )
    left.set_yscale("log")
    left.set_xlabel("direction")
    plain(left, "singular values (percentage points a factor of e)")
    left.legend(fontsize=8, frameon=False)
    best = nearest(ends)
    free = READINGS[best.reading].free
    rows = directions(best)[1]
    right.imshow(rows, cmap="RdBu_r", vmin=-1, vmax=1, aspect="auto")
    right.set_xticks(range(len(free)), free, rotation=60, ha="right", fontsize=7, color=INK)
    right.set_yticks(range(len(rows)), [str(at + 1) for at in range(len(rows))], fontsize=7)
    for (at, column), share in np.ndenumerate(rows):
        if abs(share) >= _WORTH:
            ink = "white" if abs(share) > 0.6 else INK
            right.text(column, at, f"{share:.1f}", ha="center", va="center", fontsize=6, color=ink)
    right.set_title(
        f"directions of the nearest ({best.reading} {best.number})",
        fontsize=9,
        loc="left",
        color=INK,
    )
    right.set_ylabel("direction", fontsize=8)
    return figure
