"""Display profiles as a table, a picture and a section of a page, in the units of the columns."""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from ..fitting import Estimate, FitResult, in_column_units
from ..models import AbstractModel
from ..runtime.text import format_estimate, format_range
from ..studies import Profile, Profiles
from ._style import (
    BLUE,
    GREY,
    LIGHT,
    VERMILLION,
    embedded,
    grid_of,
    new_figure,
    new_plot,
    plain,
    small,
)
from ._views import PageSection, RecordView, Table

PROFILE_HEADINGS = (
    "quantity",
    "value",
    "error",
    "unit",
    "interval from standard error",
    "profile interval",
    "remark",
)

# More panels than this are too small, and a page with more plots is too large for a phone.
_MOST, _ACROSS, _MOST_ON_PAGE = 12, 3, 24

_ABOVE = 1.6  # upper end of a picture, as a multiple of the deviance at the ends of the interval


class ProfileCurve(NamedTuple):
    """Data for the plot of a profile, in the unit of the columns.

    Deviances are relative to the lowest point. `bounded` marks points at which another parameter is
    at a bound that it is not at in the fit. The curve through the points, whose square root is
    smooth, has the values `smooth` at `between`. The parabola of the standard error, if it exists,
    has the values `line` at `over`. The interval ends at the deviance `level`.
    """

    name: str
    unit: str
    values: np.ndarray
    deviances: np.ndarray
    bounded: np.ndarray
    between: np.ndarray
    smooth: np.ndarray
    over: np.ndarray
    line: np.ndarray
    level: float
    interval: tuple[float | None, float | None]


def profile_rows(profiles: Profiles, result: FitResult) -> list[list[str]]:
    """Return a row of text for each profile, under `PROFILE_HEADINGS`."""
    rows = []
    for profile in profiles.profiles.values():
        factor, unit = _in_columns(profile, result.model)
        error = None if profile.standard_error is None else profile.standard_error * factor
        numbers = format_estimate(profile.value * factor, error)
        intervals = (profile.linear, profile.interval)
        ranges = [format_range(ends, error, factor) for ends in intervals]
        rows.append([profile.name, *numbers, unit or "-", *ranges, "; ".join(profile.remarks)])
    return rows


def _caption(level: float, curves: list[ProfileCurve]) -> str:
    caption = (
        "Each quantity was fixed at a series of values, while all other parameters were fitted "
        "(blue dots; the blue line interpolates). The deviance is twice the increase in the cost, "
        "divided by the variance factor of the residuals. Dashed line: its approximation from the "
        f"standard error. Shaded: the {100 * level:.3g} % profile interval, which ends where the "
        "deviance reaches the horizontal line (the squared quantile of Student's t), or at a bound."
    )
    if any(None in curve.interval for curve in curves):
        caption += (
            " Where an end of the interval was not found, the shading extends to the last point "
            "shown."
        )
    if any(curve.bounded[_shown(curve.deviances, curve.level)].any() for curve in curves):
        caption += " Orange-red squares: another parameter has reached a bound."
    return caption


def profile_figure(profiles: Profiles, result: FitResult, title: str = "Profiles") -> Figure:
    """Plot deviances versus their quantities, with the parabolas of the standard errors.

    With many profiles, the first twelve are shown.
    """
    curves = _curves(profiles, result, _MOST)
    across = max(min(_ACROSS, len(curves)), 1)
    down = -(-max(len(curves), 1) // across)
    caption = _caption(profiles.level, curves)
    figure = new_figure(3.6 * across, 2.7 * down + 0.6, title, caption)
    for axes, curve in zip(grid_of(figure, len(curves), across), curves, strict=True):
        _draw(axes, curve)
    if curves:
        handles: dict[str, Any] = {}
        for axes in figure.axes:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                handles.setdefault(label, handle)
        place: dict[str, Any] = {"loc": "outside lower left", "ncols": 4}
        figure.legend(handles.values(), handles.keys(), fontsize=8, frameon=False, **place)
    return figure


def _curves(profiles: Profiles, result: FitResult, most: int) -> list[ProfileCurve]:
    """Return the curves to draw, without profiles of a single point."""
    drawn = [one for one in profiles.profiles.values() if len(one.points) > 1]
    return [_curve(one, result) for one in drawn[:most]]


def _curve(profile: Profile, result: FitResult) -> ProfileCurve:
    factor, unit = _in_columns(profile, result.model)
    values = np.asarray([point.value for point in profile.points])
    deviances = np.asarray([point.deviance for point in profile.points]) - profile.lowest
    level = profile.reach**2
    at_fit = next((p.at_bounds for p in profile.points if p.value == profile.value), ())
    over, line = np.zeros(0), np.zeros(0)
    if profile.standard_error is not None:
        width = np.sqrt(_ABOVE * level) * profile.standard_error
        low = -np.inf if profile.lower is None else profile.lower
        high = np.inf if profile.upper is None else profile.upper
        over = np.linspace(max(profile.value - width, low), min(profile.value + width, high), 81)
        line = ((over - profile.value) / profile.standard_error) ** 2
    lowest = int(np.argmin(deviances))
    roots = np.sign(np.arange(len(values)) - lowest) * np.sqrt(deviances)
    shown = _shown(deviances, level)
    between = np.linspace(values[shown][0], values[shown][-1], 161)
    smooth = PchipInterpolator(values[shown], roots[shown])(between) ** 2
    low_end, high_end = (None if end is None else end * factor for end in profile.interval)
    return ProfileCurve(
        name=profile.name,
        unit=unit,
        values=values * factor,
        deviances=deviances,
        bounded=np.asarray([bool(set(p.at_bounds) - set(at_fit)) for p in profile.points]),
        between=between * factor,
        smooth=smooth,
        over=over * factor,
        line=line,
        level=level,
        interval=(low_end, high_end),
    )


def _shown(deviances: np.ndarray, level: float) -> slice:
    """Return the points to draw; distant ones would compress the relevant range."""
    inside = np.flatnonzero(deviances <= _ABOVE * level)
    return slice(max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 2, len(deviances)))


def _draw(axes: Axes, curve: ProfileCurve) -> None:
    top, kept = _ABOVE * curve.level, _shown(curve.deviances, curve.level)
    if len(curve.over):
        axes.plot(curve.over, curve.line, color=GREY, lw=1, ls="--", label="standard error")
    axes.plot(curve.between, curve.smooth, color=BLUE, lw=1.3, label="profile")
    axes.plot(curve.values[kept], curve.deviances[kept], "o", color=BLUE, ms=3)
    if np.any(curve.bounded[kept]):
        axes.plot(
            curve.values[kept][curve.bounded[kept]], curve.deviances[kept][curve.bounded[kept]],
            "s", color=VERMILLION, ms=4.5, label="another parameter at a bound",
        )  # fmt: skip
    axes.axhline(curve.level, color=GREY, lw=0.7)
    low, high = curve.interval
    axes.axvspan(
        curve.values[kept][0] if low is None else low,
        curve.values[kept][-1] if high is None else high,
        color=LIGHT, alpha=0.6, lw=0, label="profile interval",
    )  # fmt: skip
    plain(axes, curve.name)
    axes.set_ylim(-0.05 * top, top)
    axes.set_xlabel(curve.unit)
    axes.set_ylabel("deviance")


def _in_columns(profile: Profile, model: AbstractModel) -> tuple[float, str]:
    """Return the factor from the quantity to the unit of the columns, and this unit."""
    one = Estimate(1.0, None, profile.unit, None, None, free=True)
    shown = in_column_units({profile.name: one}, model)[profile.name]
    return float(shown.value), shown.unit


def _table(found: Profiles, result: FitResult, most: int | None = None) -> Table:
    return Table.of_parameters(PROFILE_HEADINGS, profile_rows(found, result)[:most])


def _section(found: Profiles, result: FitResult, folder: Path) -> PageSection:
    curves = _curves(found, result, _MOST_ON_PAGE)
    return PageSection(
        id="profiles",
        name="Profiles",
        heading="Profiles",
        early=True,
        table=_table(found, result),
        plots=[(curve.name, _plot(curve)) for curve in curves],
        note="Each quantity was fixed at a series of values, while all other parameters were "
        "fitted. Solid line: increase of the deviance. Dashed line: its approximation from the "
        f"standard error. The {100 * found.level:.3g} % interval ends where the solid line crosses "
        "the horizontal line. At orange-red squares, another parameter is at a bound.",
    )


def _plot(curve: ProfileCurve) -> str:
    """Return a plot of a profile with the parabola of the standard error, as JSON for BokehJS."""
    from bokeh.models import BoxAnnotation, ColumnDataSource, Span

    top = _ABOVE * curve.level
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
    bounded = curve.bounded[kept]
    source = ColumnDataSource(
        {
            "x": curve.values[kept],
            "y": curve.deviances[kept],
            "colour": np.where(bounded, VERMILLION, BLUE).tolist(),
            "mark": np.where(bounded, "square", "circle").tolist(),
        }
    )
    dots = plot.scatter("x", "y", source=source, size=5, color="colour", marker="mark")
    tips = [(curve.name, "@x{0.0000a}"), ("deviance", "@y{0.000}")]
    return embedded(plot, dots, tips)


def _figure(found: Profiles, result: FitResult) -> Figure:
    names = ", ".join(record.name for record in result.runs[:3])
    return profile_figure(found, result, f"{names}: profiles")


RecordView(
    place=0,
    record=Profiles,
    table=_table,
    sentences=lambda found, most: [
        f"intervals at confidence level {found.level:.3g}; 'open' if the data give no limit"
    ],
    figure=_figure,
    section=_section,
)
