"""The tables of a page about one result, as rows of text that a template lays out."""

import base64
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np
from bokeh.embed import json_item
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Span

from ...fitting import Estimate, FitResult, column_factors, in_column_units
from ...runtime.files import read_bytes
from ...runtime.limits import RESULT_BYTES
from ...runtime.text import InputError, format_bounds, format_estimate
from ...studies import (
    Bootstrap,
    Influence,
    PosteriorSummary,
    Profiles,
    Repeated,
    lost_starts,
    together,
    valleys,
)
from .. import (
    BLUE,
    BOOTSTRAP,
    GREY,
    INFLUENCE,
    LIGHT,
    POSTERIOR,
    POSTERIOR_HEADINGS,
    PROFILE_HEADINGS,
    VERMILLION,
    bootstrap_summary,
    bootstrap_table,
    influence_summary,
    influence_table,
    posterior_rows,
    profile_rows,
)
from .._posterior import BANDS, CORNER
from .._profiles import ABOVE, ProfileCurve, profile_curves
from ._plots import new_plot, small

# The correlation matrix as coloured cells of a table.

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


class Table(NamedTuple):
    """Headings and rows of text; how many columns at the left are words."""

    headings: list[str]
    rows: list[list[str]]
    words: int = 1


class ParameterRow(NamedTuple):
    """One parameter, as text; `exact` is the value in all digits."""

    path: str
    value: str
    exact: str
    statistical: str
    systematic: str
    both: str
    unit: str
    interval: str
    bounds: str
    sources: str
    remark: str
    free: bool


def parameter_rows(result: FitResult) -> list[ParameterRow]:
    """What was fitted, what follows from it, and what the settings hold; in the columns' units."""
    factors = column_factors(result.model)
    stated = together(result.systematic)
    rows = []
    for path, one in in_column_units(result.shown, result.model).items():
        # Of an element, or of a group of runs, it is that of the parameter.
        factor = factors.get(path.partition(" of ")[0].partition("[")[0], 1.0)
        value, error = format_estimate(one.value, one.standard_error)
        systematic = stated[path] * factor if path in stated else None
        both = None
        if systematic is not None and one.standard_error is not None:
            both = float(np.hypot(systematic, one.standard_error))
        rows.append(
            ParameterRow(
                path=path,
                value=value,
                exact=json.dumps(one.value),
                statistical=error,
                systematic="-" if systematic is None else f"{systematic:.2g}",
                both="-" if both is None else f"{both:.2g}",
                unit=one.unit or "-",
                interval=_interval(one, factor),
                bounds=format_bounds(one.lower, one.upper),
                sources=_sources(one.sources),
                remark=one.remark,
                free=one.free,
            )
        )
    return rows


def _interval(one: Estimate, factor: float) -> str:
    if one.interval is None or None in one.interval:
        return "-"
    low, high = sorted(end * factor for end in one.interval)
    return f"{low:.5g} .. {high:.5g}"


def _sources(sources: Mapping[str, float | None]) -> str:
    """Recordings with what leaving each out does to the error, the weightiest first."""
    weights = {name: np.inf if factor is None else factor for name, factor in sources.items()}
    ordered = sorted(weights, key=lambda name: -weights[name])
    return ", ".join(
        f"{name} (alone)" if np.isinf(weights[name]) else f"{name} (x{weights[name]:.3g})"
        for name in ordered
    )


def noise_table(result: FitResult) -> Table:
    """Each channel of each run: how far off, against which noise."""
    rows = []
    for run in result.runs:
        for name, c in run.channels.items():
            memory = (
                f"{c.correlated:.3g} over {c.correlation_time_s:.3g} s" if c.correlated else "-"
            )
            ratio = f"{c.rmse / c.noise:.2f}" if c.rmse is not None and c.noise else "-"
            size = [c.unit or "-", str(c.n), _number(c.rmse), _number(c.noise)]
            rows.append([run.name, name, *size, ratio, memory])
    headings = ["run", "channel", "unit", "values", "RMSE", "noise", "RMSE / noise", "with memory"]
    return Table(headings, rows, 3)


def held_out_table(result: FitResult) -> Table:
    """What was held out, and how far off its prediction is."""
    rows = [
        [record.name, name, c.unit or "-", str(c.n), _number(c.rmse), _number(c.size, "-")]
        for record in result.held_out
        for name, c in record.channels.items()
    ]
    headings = ["run", "channel", "unit", "values", "RMSE", "times what it may be off"]
    return Table(headings, rows, 3)


def validation_table(result: FitResult) -> Table:
    """Runs that were not fitted, and how far off their prediction is."""
    rows = [
        [record.name, name, c.unit or "-", str(c.n), _number(c.rmse), _number(c.largest)]
        for record in result.validation
        for name, c in record.channels.items()
    ]
    return Table(["run", "channel", "unit", "values", "RMSE", "largest error"], rows, 3)


def starts_table(result: FitResult) -> Table:
    """Where each start ended, in the columns' units."""
    factors = column_factors(result.model)
    # Of an element of an array, it is that of the array.
    paths = {path: factors.get(path.partition("[")[0], 1.0) for path in result.free}
    rows = [
        [start.status, "-" if start.misfit is None else f"{start.misfit:.6g}"]
        + [_number(_times((start.parameters or {}).get(path), paths[path])) for path in paths]
        for start in result.starts
    ]
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    headings = [f"{path} ({units[path]})" if units[path] else path for path in paths]
    return Table(["ended", "misfit", *headings], rows, 1)


def optima_table(result: FitResult) -> Table:
    """The optima that the starts reached, in the columns' units; what failed is below them."""
    factors = column_factors(result.model)
    paths = {path: factors.get(path.partition("[")[0], 1.0) for path in result.free}
    rows = [
        [f"optimum {place}", str(valley.reached), f"{valley.worse:.3g}"]
        + [_number(valley.values[path] * factor) for path, factor in paths.items()]
        for place, valley in enumerate(valleys(result), 1)
    ]
    nothing = ["-"] * (1 + len(paths))
    rows += [[why, str(count), *nothing] for why, count in lost_starts(result).items()]
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    headings = [f"{path} ({units[path]})" if units[path] else path for path in paths]
    return Table(["ended at", "starts", "worse by (log-likelihood)", *headings], rows, 1)


def own_table(result: FitResult) -> Table:
    """What single runs have for themselves, such as an initial state, in the columns' units."""
    factors = column_factors(result.model)
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    rows = []
    for run in result.runs:
        for path, own in run.parameters.items():
            factor = factors.get(path.partition("[")[0], 1.0)
            numbers = format_estimate(own.value * factor, _times(own.standard_error, factor))
            # A state is no parameter of the model, which would know its unit.
            unit = units.get(path, "SI") or "-"
            rows.append([run.name, path, *numbers, unit, own.remark or "-"])
    return Table(["run", "parameter", "value", "error", "unit", "remark"], rows, 2)


def file_rows(result: FitResult) -> Table:
    """The files that were fitted, each with its checksum."""
    rows = {run.path: run.sha256 for run in result.runs if run.path}
    rows |= {record.path: record.sha256 for record in result.held_out if record.path}
    listed = {**rows, **result.task.get("inputs", {})}
    # A recording without a sidecar: that there was none is a part of what was fitted.
    files = [[str(path), str(sha or "there was no such file")] for path, sha in listed.items()]
    return Table(["file", "SHA-256"], files, 2)


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


def _number(value: float | None, missing: str = "not finite") -> str:
    return missing if value is None else f"{value:.4g}"


# What a page says of the posterior that lies beside a result.

# A page stays below 5 MB; a larger picture is left in its file.
_MOST_BYTES = 600_000


class PosteriorPart(NamedTuple):
    """What the page shows of a posterior.

    Attributes:
        summary: of the draws.
        table: of the parameters.
        within: the least share of recorded cells within their 95 % band, and of which channel;
            empty where nothing was recorded.
        pictures: as data of a browser, each with what it shows.
    """

    summary: PosteriorSummary
    table: Table
    within: str
    pictures: list[tuple[str, str]]


def posterior_part(result: FitResult, source: Path | None) -> PosteriorPart | None:
    """The posterior in the folder of a result.

    Arguments:
        result: of the fit.
        source: its `result.json`.

    Returns:
        What is shown of it; None where there is none, or it is of another fit.
    """
    if source is None:
        return None
    folder = source.parent
    try:
        text = read_bytes(folder / POSTERIOR, RESULT_BYTES).decode()
        summary = PosteriorSummary.from_json(text)
    except (OSError, UnicodeError, InputError):
        return None
    if not summary.is_of(result):
        return None
    shares = [
        (share, f"{channel} of {run}")
        for run, by_channel in summary.within.items()
        for channel, share in by_channel.items()
        if share is not None
    ]
    within = ""
    if shares:
        least, where = min(shares)
        within = f"{least:.1%} in the channel with the fewest, {where}"
    pictures = [
        (data, words)
        for name, words in (
            (CORNER, "pairs of parameters"),
            (BANDS, "channels with the bands of the posterior"),
        )
        if (data := _picture(folder / name)) is not None
    ]
    table = Table(POSTERIOR_HEADINGS, posterior_rows(summary, result), 2)
    return PosteriorPart(summary, table, within, pictures)


def _picture(path: Path) -> str | None:
    try:
        content = read_bytes(path, _MOST_BYTES)
    except (OSError, InputError):
        return None
    return "data:image/png;base64," + base64.b64encode(content).decode()


# Profiles on a page: a plot of each, with the parabola of the standard error.

# More plots than this are a page that no phone opens.
_MOST_PROFILES = 24


class ProfilePart(NamedTuple):
    """What the page shows of profiles: how sure, all of them as rows, and the plots of some."""

    level: float
    table: Table
    plots: list[tuple[str, str]]


def profile_part(profiles: Profiles, result: FitResult) -> ProfilePart:
    """The table and the plots, by the name of the quantity."""
    curves = profile_curves(profiles, result)[:_MOST_PROFILES]
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


# What repetitions of a fit add to its page, where their files are beside the result.

Found = TypeVar("Found", Bootstrap, Influence)

# Histograms of more parameters than these are in bootstrap.png.
_MOST_PARTS = 6


class RepeatedPart(NamedTuple):
    """The section on a bootstrap.

    Attributes:
        table: of the parameters.
        sentences: beside it.
        plots: a title and what BokehJS embeds, of each histogram.
    """

    table: Table
    sentences: list[str]
    plots: list[tuple[str, str]]


def repeated_part(result: FitResult, source: Path | None) -> RepeatedPart | None:
    """The section on the bootstrap of a result; None where there is none, or of another fit.

    Arguments:
        result: that the page is about.
        source: its `result.json`.
    """
    found = _beside(result, source, BOOTSTRAP, Bootstrap.of_json)
    if found is None:
        return None
    drawn = [(path, one) for path, one in found.parameters.items() if len(one.values) > 1]
    plots = [(path, _histogram(one)) for path, one in drawn[:_MOST_PARTS]]
    return RepeatedPart(Table(*bootstrap_table(found)), bootstrap_summary(found), plots)


def influence_part(result: FitResult, source: Path | None) -> tuple[Table, list[str]] | None:
    """The table and the sentences on the influence of the data; None as of `repeated_part`.

    Arguments:
        result: that the page is about.
        source: its `result.json`.
    """
    found = _beside(result, source, INFLUENCE, Influence.of_json)
    if found is None:
        return None
    return Table(*influence_table(found), 2), influence_summary(found)


def is_of(fitted: dict[str, float], result: FitResult) -> bool:
    """Whether values of free parameters are those of a result."""
    return fitted == {path: float(estimate.value) for path, estimate in result.free.items()}


def _beside(
    result: FitResult, source: Path | None, name: str, read: Callable[[bytes], Found]
) -> Found | None:
    """What a file beside a result holds; None where there is none, or one of another fit."""
    if source is None:
        return None
    try:
        found = read(read_bytes(source.parent / name, RESULT_BYTES))
    except (OSError, InputError):
        return None
    return found if is_of(found.fitted, result) else None


def _histogram(one: Repeated) -> str:
    values = np.asarray(one.values)
    counts, edges = np.histogram(values, bins=int(np.clip(np.sqrt(len(values)) * 1.5, 8, 40)))
    plot: Any = new_plot(180, one.unit or "value", "repetitions")
    bars = plot.quad(
        top=counts, bottom=0, left=edges[:-1], right=edges[1:], fill_color=LIGHT, line_color=BLUE
    )
    for end in one.percentile or ():
        plot.add_layout(Span(location=end, dimension="height", line_color=VERMILLION))
    plot.add_layout(
        Span(location=one.value, dimension="height", line_color=BLUE, line_dash="dashed")
    )
    tips = [("from", "@left"), ("to", "@right"), ("repetitions", "@top")]
    plot.add_tools(HoverTool(renderers=[bars], tooltips=tips))
    return json.dumps(json_item(plot))
