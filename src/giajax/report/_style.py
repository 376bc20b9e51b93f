"""How all pictures look, and how they become files. Touches nothing global of matplotlib."""

import io

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..fitting import FitResult
from ._names import SIGNATURE

# Okabe and Ito's colours, which people who see red and green alike can tell apart.
BLUE, VERMILLION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY = "#CC79A7", "#E69F00", "#56B4E9"
INK, GREY, LIGHT = "#222222", "#767676", "#E3E3E3"

MINUS = "\N{MINUS SIGN}"
DEGREE = "\N{DEGREE SIGN}"

_DPI = 130


def new_figure(width: float, height: float, title: str) -> Figure:
    """An empty picture of this size (inches)."""
    # A Figure that pyplot does not know has no window and chooses no backend.
    figure = Figure(figsize=(width, height), layout="constrained", facecolor="white")
    figure.suptitle(title, fontsize=10, color=INK, x=0.01, ha="left")
    return figure


def plain(axes: Axes, title: str = "") -> None:
    """A light grid, two spines, small print."""
    axes.grid(True, color=LIGHT, linewidth=0.6)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        axes.spines[side].set_color(GREY)
    axes.tick_params(labelsize=8, color=GREY, labelcolor=INK, length=3)
    axes.xaxis.label.set_fontsize(8)
    axes.yaxis.label.set_fontsize(8)
    if title:
        axes.set_title(title, fontsize=9, loc="left", color=INK)


def unfinished(result: FitResult) -> str:
    """What a title says of a fit that did not end well."""
    return "" if result.status == "converged" else f" ({result.status.replace('_', ' ')})"


def to_png(figure: Figure) -> bytes:
    """The picture as a PNG file; the same bytes for the same picture."""
    figure.set_dpi(_DPI)
    if (engine := figure.get_layout_engine()) is not None:
        # Matplotlib draws a picture twice to lay it out once.
        engine.execute(figure)
        figure.set_layout_engine("none")
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI, metadata={"Software": SIGNATURE})
    return buffer.getvalue()
