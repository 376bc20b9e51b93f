"""The picture of the correlations between the estimates."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ..fitting import FitResult
from ._style import INK, LIGHT, MINUS, new_figure, unfinished

# More matrix cells than this leave no room for a number in each.
_MOST_NUMBERS = 16


def correlation_figure(result: FitResult) -> Figure:
    """Correlations between the parameters that the data determine."""
    paths = result.correlation.parameters
    matrix = np.array(result.correlation.matrix, dtype=float).reshape(len(paths), len(paths))
    size = max(0.55 * len(paths), 1.0)
    title = f"Correlation of the estimates{unfinished(result)}"
    figure = new_figure(min(size, 11) + 3.6, min(size, 11) + 1.9, title)
    axes = figure.subplots()
    if not paths:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no parameter is determined", ha="center", fontsize=10, color=INK)
        return figure
    # Each pair once: the other half and the ones on the diagonal say nothing.
    below = np.where(np.tri(len(paths), k=-1, dtype=bool), matrix, np.nan)
    image = axes.imshow(below, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(paths)), paths, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(paths)), paths)
    axes.tick_params(labelsize=8, length=0, labelcolor=INK)
    for spine in axes.spines.values():
        spine.set_visible(False)
    for i in range(len(paths)):
        axes.add_patch(Rectangle((i - 0.5, i - 0.5), 1, 1, facecolor=LIGHT, edgecolor="white"))
        for j in range(i if len(paths) <= _MOST_NUMBERS else 0):
            colour = "white" if abs(below[i, j]) > 0.6 else INK
            number = _correlation(below[i, j])
            axes.text(j, i, number, ha="center", va="center", fontsize=8, color=colour)
    bar = figure.colorbar(image, ax=axes, shrink=0.8, ticks=[-1, -0.5, 0, 0.5, 1])
    bar.ax.tick_params(labelsize=8, length=0, labelcolor=INK)
    bar.outline.set_visible(False)
    return figure


def _correlation(value: float) -> str:
    # Three digits where two would round to one, which no correlation here is.
    digits = 3 if abs(value) >= 0.995 else 2
    return "?" if np.isnan(value) else f"{value:.{digits}f}".replace("-", MINUS)
