"""Figure, table and JSON text of a designed experiment."""

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter

from ...recordings import Channel
from ...report import BLUE, DEGREE, GREY, INK, VERMILLION, new_figure, plain
from ...runtime.records import plain_data
from ...runtime.text import format_estimate, format_number
from ...studies import body_of
from ._experiment import Design, Expected

DESIGN_HEADINGS = (
    *("parameter", "value", "error, design", "error, base step", "ratio"),
    *("error, previous fit", "unit"),
)
_STYLES = (("design", BLUE, "-"), ("base step", VERMILLION, "--"))
_MOST_NAMES = 12


def design_rows(found: Design) -> list[tuple[str, ...]]:
    """Return one row per free parameter with its expected standard errors, those of interest first.

    The columns are `DESIGN_HEADINGS`. A value has the digits of its error in the previous fit.
    """
    order = [*found.wanted, *(path for path in found.parameters if path not in found.wanted)]
    rows = []
    for path in order:
        value, unit = found.parameters[path]
        both = found.designed.errors[path], found.base_step.errors[path]
        ratio = both[0] / both[1] if max(both) < math.inf else None
        expected = [
            format_estimate(value, error)[1] if error < math.inf else "not determined"
            for error in both
        ]
        shown, before = format_estimate(value, found.before.get(path))
        rows.append((path, shown, *expected, format_number(ratio, "#.2g"), before, unit or "-"))
    return rows


def design_json(found: Design) -> str:
    """Return a design as JSON text."""
    limits = found.limits
    smallest, largest = (None, None) if found.designed.criterion is None else found.spread
    facts: dict[str, Any] = {
        "schema_version": 1,
        "criterion": found.criterion,
        "wanted": list(found.wanted),
        "limits": {
            "joints": list(limits.joints),
            "angle_deg": math.degrees(limits.angle),
            "rate_deg_per_s": math.degrees(limits.rate),
            "duration_s": limits.duration,
            "rows_per_s": limits.sampling,
        },
        "parameters": {
            path: {"value": value, "unit": unit, "error_before": found.before.get(path)}
            for path, (value, unit) in found.parameters.items()
        },
        "noise": found.noise,
        "design": _expected_json(found.designed),
        "base_step": _expected_json(found.base_step),
        "ratio": found.ratio,
        "draws": {"count": found.draws, "smallest": smallest, "largest": largest},
        "status": found.status,
        "evaluations": len(found.evaluations),
        "seconds": found.seconds,
    }
    return json.dumps(plain_data(facts), indent=2)


def _expected_json(expected: Expected) -> dict[str, Any]:
    corners = {name: np.degrees(row).tolist() for name, row in expected.drive.values.items()}
    return {
        "markers": list(expected.markers),
        "criterion": expected.criterion,
        "errors": expected.errors,
        "corners": {"time_s": expected.drive.times.tolist(), "angle_deg": corners},
    }


_CAPTION = (
    "The designed experiment (blue) and the base step (orange-red, dashed), in which one joint "
    "moves to the largest angle at the largest rate. Top left: commands, paler for joints farther "
    "from the base. Bottom left: predicted motion of the outermost body, for the component that "
    "moves most. Right: expected standard errors of the estimates divided by the values of the "
    "parameters, for the design (circles) and the base step (squares), each with the markers "
    "selected for it."
)


def design_figure(found: Design, title: str = "") -> Figure:
    """Draw the command, the motion of the outermost marker, and the expected errors."""
    rows = min(len(found.parameters), _MOST_NAMES)
    caption = _CAPTION + (" Grey diamonds: errors of the previous fit." if found.before else "")
    title = title or "The next experiment"
    figure = new_figure(10, max(4.6, 2.6 + 0.4 * rows), title, caption)
    grid = figure.add_gridspec(2, 2, width_ratios=[3, 2])
    both = (found.designed, found.base_step)
    _commands(figure.add_subplot(grid[0, 0]), both)
    _path(figure.add_subplot(grid[1, 0]), both)
    _errors(figure.add_subplot(grid[:, 1]), found)
    return figure


def _commands(axes: Axes, both: Sequence[Expected]) -> None:
    for (label, colour, style), one in zip(_STYLES, both, strict=True):
        assert one.run.times is not None
        for index, (name, row) in enumerate(one.run.commands.items()):
            drawn: Any = {"color": colour, "alpha": max(1 - 0.25 * index, 0.25)}
            named = f"{label}, {name.removesuffix('_command')}"
            axes.plot(one.run.times, np.degrees(row), style, label=named, **drawn)
    plain(axes, "Command", "time (s)", f"commanded angle ({DEGREE})")
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))


def _path(axes: Axes, both: Sequence[Expected]) -> None:
    """Draw the component of the last body that moves most, versus time."""
    last = body_of(list(both[0].predicted)[-1])
    names = [name for name in both[0].predicted if body_of(name) == last]
    most = max(names, key=lambda name: max(float(np.ptp(one.predicted[name])) for one in both))
    for (label, colour, style), one in zip(_STYLES, both, strict=True):
        axes.plot(one.times, one.predicted[most], style, color=colour, label=label)
    unit = Channel.named(most).si_unit
    plain(axes, f"Motion of {last}", "time (s)", f"{most} ({unit})" if unit else most)


def _errors(axes: Axes, found: Design) -> None:
    """Draw the standard errors divided by the values, where both are finite."""
    paths = [row[0] for row in design_rows(found)][:_MOST_NAMES]
    places = np.arange(len(paths))[::-1]
    missing: dict[int, list[str]] = {}
    shown = [
        ("previous fit", GREY, "D", found.before),
        ("base step", VERMILLION, "s", found.base_step.errors),
        ("design", BLUE, "o", found.designed.errors),
    ]
    for label, colour, mark, errors in shown:
        if not errors:
            continue
        shares = [
            100 * errors.get(path, math.inf) / (abs(found.parameters[path][0]) or 1.0)
            for path in paths
        ]
        finite = [share if share < math.inf else math.nan for share in shares]
        axes.plot(finite, places, mark, color=colour, markersize=7, label=label)
        for share, place in zip(shares, places, strict=True):
            if share == math.inf:
                missing.setdefault(int(place), []).append(label)
    for place, labels in missing.items():
        words = f"not determined: {', '.join(labels)}"
        beside: Any = {"textcoords": "offset points", "fontsize": 7, "color": INK, "ha": "right"}
        axes.annotate(words, (1, place), (0, 8), axes.get_yaxis_transform(), **beside)
    # Bars would need a baseline, which a logarithmic axis does not have: draw markers.
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(LogFormatter())
    axes.xaxis.set_minor_formatter(LogFormatter())
    plain(axes, "Expected standard errors", "standard error relative to the value (%)")
    axes.set_yticks(places, [path.replace(".", ".\n", 1) for path in paths])
    axes.set_ylim(-0.5, len(paths) - 0.5)
    axes.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(0, -0.15), ncols=3)
