"""What each part of the data does to a fit, as a table, sentences and a picture."""

import numpy as np
from matplotlib.figure import Figure

from ..repetitions import Influence, LeftOut
from ._style import GREY, INK, new_figure, plain

INFLUENCE = "influence.json"
"""Name of the file beside a `result.json`."""

# More rows than these are a list to read in the file.
_MOST = 30
# Columns in which numbers can still be read.
_MOST_COLUMNS = 12


def influence_table(found: Influence, most: int | None = None) -> tuple[list[str], list[list[str]]]:
    """Headings and a row for each part, the largest shift first.

    Under each parameter its shift in standard errors and, in brackets, what its error would be
    without the part, in the same.

    Arguments:
        found: the influence.
        most: rows; all by default.
    """
    paths = _columns(found)
    headings = ["left out", "kind", "cells", "by", "over expected", *paths]
    rows = []
    for part in found.parts[:most]:
        by = "fit" if part.exact is not None else "step"
        surprise = "-" if part.surprise is None else f"{part.surprise:.1f}"
        shown = [_cell(part, path) for path in paths]
        rows.append([part.name, part.kind, str(part.cells), by, surprise, *shown])
    return headings, rows


def influence_summary(found: Influence) -> list[str]:
    """Sentences beside the table: what it shows, what failed, and what is left out."""
    sentences = [
        "shift of each parameter without the part, in standard errors, and in brackets how many "
        "times as large the error would be; over expected: beyond 3 a part contradicts the others"
    ]
    lost = [part for part in found.parts if None in part.steps.values()]
    for path in found.parameters:
        names = [part.name for part in lost if part.steps.get(path, 0.0) is None]
        if names:
            sentences.append(f"{path} is not determined without {', '.join(names)}")
    sentences += [
        f"the fit without {part.name} did not converge ({part.reason})"
        for part in found.parts
        if part.reason
    ]
    return [*sentences, *found.notes]


def influence_figure(found: Influence, title: str = "") -> Figure:
    """A map of the shifts: parts by parameters, the largest shift first.

    Arguments:
        found: the influence.
        title: of the whole.

    Returns:
        The picture.
    """
    parts, paths = found.parts[:_MOST], _columns(found)[:_MOST_COLUMNS]
    title = title or "Shift of each parameter without a part of the data, in standard errors"
    figure = new_figure(3.2 + 1.2 * max(len(paths), 2), 1.8 + 0.26 * len(parts), title)
    axes = figure.add_subplot()
    shifts = np.asarray(
        [[part.shifts.get(path, 0.0) for path in paths] for part in parts], dtype=float
    ).reshape(len(parts), len(paths))
    known = np.abs(shifts[np.isfinite(shifts)])
    reach = max(float(np.max(known, initial=0.0)), 1e-3)
    image = axes.imshow(shifts, cmap="RdBu_r", vmin=-reach, vmax=reach, aspect="auto")
    plain(axes)
    axes.grid(False)
    axes.set_facecolor("#CFCFCF")
    for (row, column), shift in np.ndenumerate(shifts):
        strong = np.isfinite(shift) and abs(shift) > 0.6 * reach
        text = f"{shift:+.2f}" if np.isfinite(shift) else "lost"
        colour = "white" if strong else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    axes.set_yticks(range(len(parts)), [f"{part.kind} {part.name}" for part in parts])
    names = [path.replace(".", ".\n", 1) for path in paths]
    axes.set_xticks(range(len(paths)), names)
    axes.xaxis.tick_top()
    bar = figure.colorbar(image, ax=axes, pad=0.02)
    bar.ax.tick_params(labelsize=8, length=0, labelcolor=INK)
    bar.outline.set_visible(False)
    if len(found.parts) > len(parts):
        axes.set_xlabel(f"{len(found.parts) - len(parts)} more parts move less", color=GREY)
    return figure


def _columns(found: Influence) -> list[str]:
    """The parameters that runs share, if there are any: those of single runs fill no table."""
    shared = [label for label in found.parameters if " of '" not in label]
    return shared or list(found.parameters)


def _cell(part: LeftOut, path: str) -> str:
    if path not in part.shifts:  # Its own, and gone with it.
        return ""
    shift = part.shifts[path]
    wider = (part.widening if part.exact_widening is None else part.exact_widening)[path]
    if shift is None:
        return "lost" if part.steps[path] is None else "-"
    return f"{shift:+.2f}" + ("" if wider is None else f" ({wider:.2f})")
