"""How the plots of a page look, and those that are a single curve."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.embed import json_item
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Span
from bokeh.plotting import figure

from ...runs import Channel
from .._style import BLUE, GREEN, GREY, VERMILLION
from ._autocorrelation import autocorrelation

# As three coordinates of one point, or as one channel.
_COLOURS = (BLUE, VERMILLION, GREEN)


def new_plot(height: int, across: str, up: str, **more: Any) -> Any:
    """An empty plot of this height that is as wide as its place."""
    plot = figure(
        height=height,
        sizing_mode="stretch_width",
        tools="xpan,box_zoom,reset",
        # None for the wheel: who scrolls the page does not mean to zoom.
        active_drag="box_zoom",
        toolbar_location="above",
        x_axis_label=across,
        y_axis_label=up,
        **more,
    )
    plot.toolbar.logo = None
    plot.toolbar.autohide = True
    plot.outline_line_color = None
    plot.grid.grid_line_alpha = 0.5
    for axis in plot.axis:
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_text_font_size = "11px"
        axis.major_label_text_font_size = "11px"
        axis.minor_tick_line_color = None
    plot.yaxis.ticker.desired_num_ticks = 6 if height > 180 else 4
    return plot


def curve_item(label: str, over: Sequence[float], values: Sequence[float], *, log: bool) -> str:
    """A line over steps, such as the cost of each iteration, as what BokehJS embeds."""
    plot = new_plot(200, "iteration", label, y_axis_type="log" if log else "linear")
    source = ColumnDataSource({"x": np.asarray(over, float), "y": np.asarray(values, float)})
    plot.line("x", "y", source=source, color=BLUE, line_width=1.5)
    dots = plot.scatter("x", "y", source=source, color=BLUE, size=5)
    tips = [("iteration", "@x{0}"), ("cost", "@y{0.00000a}")]
    plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    return json.dumps(json_item(plot))


def memory_plot(channels: Sequence[Channel], residuals: Sequence[np.ndarray]) -> Any:
    """Autocorrelations within the band of white noise; None where there are too few values."""
    plot = new_plot(140, "lag (samples)", "correlation")
    widest = 0.0
    for place, channel in enumerate(channels):
        values, band = autocorrelation(residuals[place])
        if not len(values):
            continue
        widest = max(widest, band)
        colour = colour_of(place, channel, len(channels) > 1)
        lags = np.arange(1, len(values) + 1, dtype=np.float32)
        source = ColumnDataSource({"x": lags, "y": small(values)})
        plot.line("x", "y", source=source, color=colour, line_width=1)
        dots = plot.scatter("x", "y", source=source, size=3.5, color=colour)
        tips = [("lag", "@x{0}"), ("autocorrelation", "@y{0.00}")]
        plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    if not widest:
        return None
    plot.add_layout(BoxAnnotation(bottom=-widest, top=widest, fill_color=GREY, fill_alpha=0.2))
    plot.add_layout(Span(location=0, dimension="width", line_color=GREY, line_width=0.7))
    return plot


def colour_of(place: int, channel: Channel, several: bool) -> str:
    """That of a coordinate, where several share a plot; else the first."""
    if not several:
        return BLUE
    return _COLOURS[(place if channel.component is None else channel.component) % len(_COLOURS)]


def small(values: np.ndarray) -> np.ndarray:
    """As seven digits, which no screen shows: half of the page's size."""
    return np.asarray(values, dtype=np.float32)
