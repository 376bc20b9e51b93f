"""Profiles as a table and as a picture, in the units of the columns."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.interpolate import PchipInterpolator

from ..fitting import Estimate, FitResult, in_column_units
from ..models import AbstractModel
from ..runtime.text import format_estimate
from ..studies import Profile, Profiles
from ._style import BLUE, GREY, LIGHT, VERMILLION, new_figure, plain

PROFILE_HEADINGS = ("quantity", "value", "error", "unit", "by the error", "by profile", "remark")

# More pictures than this are small print.
_MOST, _ACROSS = 12, 3

# A picture ends so far above the deviance of the interval.
ABOVE = 1.6


class ProfileCurve(NamedTuple):
    """What a picture of a profile shows, in the unit of the columns.

    Attributes:
        name, unit: of the quantity.
        values, deviances: of the points; the deviance from the lowest.
        bounded: which of them have another parameter at a bound that is at none in the fit.
        line: the parabola of the standard error at `over`; empty without one.
        between, smooth: values and deviances of the line through the points, whose root is smooth.
        over: values of the parabola.
        level: deviance at which the interval ends.
        interval: its ends, None where there is none.
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
    """A row of text for each profile, by `PROFILE_HEADINGS`."""
    rows = []
    for profile in profiles.profiles.values():
        factor, unit = _in_columns(profile, result.model)
        error = None if profile.standard_error is None else profile.standard_error * factor
        value, told = format_estimate(profile.value * factor, error)
        linear = "-" if profile.linear is None else _interval(profile.linear, factor)
        found = _interval(profile.interval, factor)
        remarks = "; ".join(profile.remarks)
        rows.append([profile.name, value, told, unit or "-", linear, found, remarks])
    return rows


def profile_curves(profiles: Profiles, result: FitResult) -> list[ProfileCurve]:
    """What there is to draw, without profiles of a single point."""
    drawn = [one for one in profiles.profiles.values() if len(one.points) > 1]
    return [_curve(one, result) for one in drawn]


def profile_figure(profiles: Profiles, result: FitResult, title: str = "Profiles") -> Figure:
    """Deviances over their quantities, with the parabolas of the standard errors.

    Arguments:
        profiles: of the fit.
        result: the fit.
        title: of the whole.

    Returns:
        The picture; of many profiles the first twelve.
    """
    curves = profile_curves(profiles, result)[:_MOST]
    across = max(min(_ACROSS, len(curves)), 1)
    down = -(-max(len(curves), 1) // across)
    figure = new_figure(3.6 * across, 2.7 * down + 0.6, title)
    for place, curve in enumerate(curves):
        axes = figure.add_subplot(down, across, place + 1)
        _draw(axes, curve)
    if curves:
        handles = figure.axes[0].get_legend_handles_labels()
        for axes in figure.axes[1:]:
            for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
                if label not in handles[1]:
                    handles[0].append(handle)
                    handles[1].append(label)
        figure.legend(*handles, loc="outside lower left", ncols=4, fontsize=8, frameon=False)
    return figure


def _curve(profile: Profile, result: FitResult) -> ProfileCurve:
    factor, unit = _in_columns(profile, result.model)
    values = np.asarray([point.value for point in profile.points])
    deviances = np.asarray([point.deviance for point in profile.points]) - profile.lowest
    level = profile.reach**2
    at_fit = next((p.at_bounds for p in profile.points if p.value == profile.value), ())
    over, line = np.zeros(0), np.zeros(0)
    if profile.standard_error is not None:
        width = np.sqrt(ABOVE * level) * profile.standard_error
        low = -np.inf if profile.lower is None else profile.lower
        high = np.inf if profile.upper is None else profile.upper
        over = np.linspace(max(profile.value - width, low), min(profile.value + width, high), 81)
        line = ((over - profile.value) / profile.standard_error) ** 2
    lowest = int(np.argmin(deviances))
    roots = np.sign(np.arange(len(values)) - lowest) * np.sqrt(deviances)
    shown = _shown(deviances, level)
    between = np.linspace(values[shown][0], values[shown][-1], 161)
    smooth = PchipInterpolator(values[shown], roots[shown])(between) ** 2
    low_end, high_end = profile.interval
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
        interval=(
            None if low_end is None else low_end * factor,
            None if high_end is None else high_end * factor,
        ),
    )


def _shown(deviances: np.ndarray, level: float) -> slice:
    """The points that a picture has: far ones would make of the part that counts a line."""
    inside = np.flatnonzero(deviances <= ABOVE * level)
    return slice(max(int(inside[0]) - 1, 0), min(int(inside[-1]) + 2, len(deviances)))


def _draw(axes: Axes, curve: ProfileCurve) -> None:
    top, kept = ABOVE * curve.level, _shown(curve.deviances, curve.level)
    if len(curve.over):
        axes.plot(curve.over, curve.line, color=GREY, lw=1, ls="--", label="standard error")
    axes.plot(curve.between, curve.smooth, color=BLUE, lw=1.3, label="profile")
    axes.plot(curve.values[kept], curve.deviances[kept], "o", color=BLUE, ms=3)
    if np.any(curve.bounded[kept]):
        axes.plot(
            curve.values[kept][curve.bounded[kept]], curve.deviances[kept][curve.bounded[kept]],
            "o", color=VERMILLION, ms=4, label="another parameter at a bound",
        )  # fmt: skip
    axes.axhline(curve.level, color=GREY, lw=0.7)
    low, high = curve.interval
    axes.axvspan(
        curve.values[kept][0] if low is None else low,
        curve.values[kept][-1] if high is None else high,
        color=LIGHT, alpha=0.6, lw=0, label="interval by profile",
    )  # fmt: skip
    plain(axes, curve.name)
    axes.set_ylim(-0.05 * top, top)
    axes.set_xlabel(curve.unit)
    axes.set_ylabel("deviance")


def _in_columns(profile: Profile, model: AbstractModel) -> tuple[float, str]:
    """What the quantity is multiplied by in the unit of the columns, and that unit."""
    one = Estimate(1.0, None, profile.unit, None, None, free=True)
    shown = in_column_units({profile.name: one}, model)[profile.name]
    return float(shown.value), shown.unit


def _interval(ends: Sequence[float | None], factor: float) -> str:
    low, high = ("open" if end is None else f"{end * factor:.5g}" for end in ends)
    return f"{low} .. {high}"
