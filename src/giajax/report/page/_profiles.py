"""Profiles on a page: a plot of each, with the parabola of the standard error."""

import json
from typing import NamedTuple

from bokeh.embed import json_item
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Span

from ...fitting import FitResult
from ...study import Profiles
from .._profiles import ABOVE, PROFILE_HEADINGS, ProfileCurve, profile_curves, profile_rows
from .._style import BLUE, GREY, VERMILLION
from ._figures import new_plot, small
from ._tables import Table

# More plots than this are a page that no phone opens.
_MOST = 24


class ProfilePart(NamedTuple):
    """What the page shows of profiles: how sure, all of them as rows, and the plots of some."""

    level: float
    table: Table
    plots: list[tuple[str, str]]


def profile_part(profiles: Profiles, result: FitResult) -> ProfilePart:
    """The table and the plots, by the name of the quantity."""
    curves = profile_curves(profiles, result)[:_MOST]
    return ProfilePart(
        profiles.level,
        Table(list(PROFILE_HEADINGS), profile_rows(profiles, result), 1),
        [(curve.name, _item(curve)) for curve in curves],
    )


def _item(curve: ProfileCurve) -> str:
    top = ABOVE * curve.level
    plot = new_plot(200, curve.unit or "-", "deviance", y_range=(-0.05 * top, top))
    low, high = curve.interval
    plot.add_layout(BoxAnnotation(left=low, right=high, fill_color=GREY, fill_alpha=0.15))
    plot.add_layout(Span(location=curve.level, dimension="width", line_color=GREY, line_width=0.7))
    if len(curve.over):
        parabola = ColumnDataSource({"x": small(curve.over), "y": small(curve.line)})
        plot.line("x", "y", source=parabola, color=GREY, line_dash="dashed", line_width=1)
    line = ColumnDataSource({"x": small(curve.between), "y": small(curve.smooth)})
    plot.line("x", "y", source=line, color=BLUE, line_width=1.3)
    kept = curve.deviances <= 2 * top
    colours = [VERMILLION if bounded else BLUE for bounded in curve.bounded[kept]]
    source = ColumnDataSource(
        {"x": curve.values[kept], "y": curve.deviances[kept], "colour": colours}
    )
    dots = plot.scatter("x", "y", source=source, size=5, color="colour")
    tips = [(curve.name, "@x{0.0000a}"), ("deviance", "@y{0.000}")]
    plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    return json.dumps(json_item(plot))
