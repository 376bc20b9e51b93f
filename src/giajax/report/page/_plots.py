"""Plots of one run for BokehJS: recorded and fitted values, residuals, autocorrelations."""

import itertools
import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool, Span
from bokeh.transform import dodge

from ...fitting import FitResult, RunFit, predict
from ...recordings import Channel, Run
from ...runtime.arrays import Float, Int
from ...schema.parameters import replace
from .. import BLUE, GREEN, GREY, INK, VERMILLION
from .._pictures import abscissa, channel_label, channels_together, sweep_starts
from .._style import embedded, new_plot, small
from .._text import times_noise

_MOST_LAGS = 60


def autocorrelation(
    residuals: Float[np.ndarray, " sample"],
) -> tuple[Float[np.ndarray, " lag"], float]:
    """Return the autocorrelation of residuals at lags of 1, 2, ... samples, and its 95 % band.

    Arguments:
        residuals: recorded minus fitted values; NaN if not measured, which forms no pairs.

    Returns:
        The autocorrelations, empty with too few values, and half the width of the 95 % band of
        white noise.
    """
    known = ~np.isnan(residuals)
    count = int(known.sum())
    lags = min(len(residuals) // 4, _MOST_LAGS)
    values = np.where(known, residuals - (residuals[known].mean() if count else 0.0), 0.0)
    power = float(np.mean(values[known] ** 2)) if count else 0.0
    if count < 8 or power == 0:
        return np.empty(0), 0.0
    found = []
    for lag in range(1, lags + 1):
        pairs = int(np.sum(known[lag:] & known[:-lag]))
        found.append(np.sum(values[lag:] * values[:-lag]) / (max(pairs, 1) * power))
    return np.array(found), 1.96 / np.sqrt(count)


def thinned(columns: Sequence[Float[np.ndarray, " sample"]], most: int) -> Int[np.ndarray, " kept"]:
    """Select samples to draw without losing an extreme value of any column.

    The samples are divided into equal intervals. In each, the first sample is kept, and the minimum
    and maximum of each column. A single outlier among a million values is therefore drawn.

    Returns:
        The sample numbers, about `most` of them, ascending.
    """
    count = len(columns[0])
    if count <= most:
        return np.arange(count)
    spans = max(most // (2 * len(columns) + 1), 1)
    edges = np.linspace(0, count, spans + 1).astype(int)
    kept = set(edges[:-1].tolist()) | {count - 1}
    for values in columns:
        low = np.where(np.isnan(values), np.inf, values)
        high = np.where(np.isnan(values), -np.inf, values)
        for start, end in itertools.pairwise(edges.tolist()):
            kept.add(start + int(np.argmin(low[start:end])))
            kept.add(start + int(np.argmax(high[start:end])))
    return np.array(sorted(kept))


_COLOURS = (BLUE, VERMILLION, GREEN)  # of the three coordinates of a point; the first for others


def curve_item(label: str, over: Sequence[float], values: Sequence[float], *, log: bool) -> str:
    """Return a line over iterations, such as the cost of each, as JSON for BokehJS."""
    plot = new_plot(200, "iteration", label, y_axis_type="log" if log else "linear")
    source = ColumnDataSource({"x": np.asarray(over, float), "y": np.asarray(values, float)})
    plot.line("x", "y", source=source, color=BLUE, line_width=1.5)
    dots = plot.scatter("x", "y", source=source, color=BLUE, size=5)
    return embedded(plot, dots, [("iteration", "@x{0}"), ("cost", "@y{0.00000a}")])


def memory_plot(channels: Sequence[Channel], residuals: Sequence[np.ndarray]) -> Any:
    """Plot autocorrelations and the band of white noise; None with too few values."""
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
    """Return the colour of a coordinate if several share a plot, otherwise the first one."""
    if not several:
        return BLUE
    return _COLOURS[(place if channel.component is None else channel.component) % len(_COLOURS)]


_MOST_PARAMETERS = 12  # each parameter requires a prediction, by a compiled program


def can_have_bands(result: FitResult) -> bool:
    """Return whether bands are cheap and follow from the result: few parameters, no ties."""
    paths = result.correlation.parameters
    return (
        0 < len(paths) <= _MOST_PARAMETERS
        and set(paths) <= set(result.parameters)
        and not result.config.get("ties")
        and all(result.parameters[path].standard_error for path in paths)
        and bool(np.all(np.isfinite(np.array(result.correlation.matrix, dtype=float))))
        and not any(run.parameters.keys() & result.free.keys() for run in result.runs)
    )


def prediction_errors_of_parameters(
    result: FitResult, run: Run, predicted: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Return the standard deviation of each predicted channel due to the shared parameters.

    It is a first-order propagation of their covariance: each parameter is changed by its standard
    error, and the changes are combined with the correlations. Parameters of a single run, such as
    its initial state, are not included. SI, by channel, each of shape (sample,); empty if a
    changed model cannot be predicted.
    """
    model = result.model_of(run)
    changes: dict[str, list[np.ndarray]] = {name: [] for name in predicted}
    for path in result.correlation.parameters:
        estimate = result.parameters[path]
        moved = estimate.value + estimate.standard_error
        if estimate.upper is not None and moved >= estimate.upper:
            moved = estimate.value - estimate.standard_error
        there = predict(replace(model, {path: moved}), run, list(predicted))
        sign = np.sign(moved - estimate.value)
        for name, values in there.items():
            changes[name].append(sign * (values - predicted[name]))
    matrix = np.array(result.correlation.matrix, dtype=float)
    bands = {}
    for name, rows in changes.items():
        table = np.stack(rows)
        variance = np.einsum("is,ij,js->s", table, matrix, table)
        if not np.all(np.isfinite(variance)):
            return {}
        bands[name] = np.sqrt(np.maximum(variance, 0.0))
    return bands


class Panel(NamedTuple):
    """The plots of one channel, or of the coordinates of one point, as JSON for BokehJS.

    It also has names and unit, the quality of the fit, the colour of each channel if several share
    the panel, and the numbers of drawn and of all samples.
    """

    title: str
    note: str
    colours: dict[str, str]
    item: str
    drawn: int
    samples: int


def worst_panels(run: Run, record: RunFit, most: int) -> tuple[list[list[str]], int]:
    """Return the names of the channels of each panel, and the number of channels without one.

    If there are more than `most`, those with the largest residuals are kept, in the order of the
    file.
    """
    groups = channels_together(run, most)
    shown = sorted(range(len(groups)), key=lambda i: -times_noise(record, groups[i]))[:most]
    kept = [groups[i] for i in sorted(shown)]
    return kept, len(run.observations) - sum(map(len, kept))


def panel(
    names: Sequence[str],
    run: Run,
    predicted: Mapping[str, np.ndarray],
    record: RunFit,
    *,
    held: Run | None = None,
    bands: Mapping[str, np.ndarray] | None = None,
    values: int = 20_000,
) -> Panel:
    """Plot some channels of a run, given by name.

    Arguments:
        predicted: predictions of the fitted model for the run, SI, by channel.
        record: the entry of the run in the result; `held` is the held-out part of the run.
        bands: standard deviations of the prediction due to the parameters, SI, by channel.
        values: approximate limit on the number of values in the plots.
    """
    over, label = abscissa(run)
    channels = [run.channels[name] for name in names]
    data = _columns(channels, run, predicted, held, bands)
    extremes = [data[key] for key in data if key[0] in "rdh"]
    kept = thinned(extremes, max(values // (len(data) + 1), 100))
    source = ColumnDataSource(
        {"x": small(over[kept])} | {key: small(cells[kept]) for key, cells in data.items()}
    )
    sweeps = np.empty(0, int) if over is run.times else sweep_starts(over)
    main = _main_plot(channels, source, record, _line(over, data, kept, sweeps), run)
    plots = [main, _residual_plot(channels, source, record, main, label)]
    residuals = [data[f"d{place}"] for place in range(len(channels))]
    if run.times is not None and (memory := memory_plot(channels, residuals)) is not None:
        plots.append(memory)
    first = channel_label(channels[0])
    title = first if len(names) == 1 else first.replace(names[0], names[0][:-2])
    item = json.dumps(json_item(column(*plots, sizing_mode="stretch_width")), allow_nan=True)
    colours = {channel.name: colour_of(i, channel, True) for i, channel in enumerate(channels)}
    shown = colours if len(names) > 1 else {}
    return Panel(title, _note(channels, record), shown, item, len(kept), len(over))


def _columns(
    channels: Sequence[Channel],
    run: Run,
    predicted: Mapping[str, np.ndarray],
    held: Run | None,
    bands: Mapping[str, np.ndarray] | None,
) -> dict[str, np.ndarray]:
    """Return recorded, fitted, difference, held-out and band columns, in the units of the file."""
    data: dict[str, np.ndarray] = {}
    for place, channel in enumerate(channels):
        recorded = channel.from_si(run.observations[channel.name])
        fitted = channel.from_si(predicted[channel.name])
        data |= {f"r{place}": recorded, f"f{place}": fitted, f"d{place}": recorded - fitted}
        if held is not None and channel.name in held.observations:
            data[f"h{place}"] = channel.from_si(held.observations[channel.name])
        if bands and channel.name in bands:
            deviation = channel.from_si(bands[channel.name]) - channel.from_si(np.zeros(1))
            data[f"l{place}"] = fitted - 2 * deviation
            data[f"u{place}"] = fitted + 2 * deviation
    return data


def _line(
    over: np.ndarray, data: Mapping[str, np.ndarray], kept: np.ndarray, sweeps: np.ndarray
) -> ColumnDataSource:
    """Return fitted values with a gap before each new sweep; empty if there are no sweeps."""
    if not len(sweeps):
        return ColumnDataSource()
    places = np.searchsorted(kept, sweeps)
    columns = {"x": over} | {key: cells for key, cells in data.items() if key[0] == "f"}
    return ColumnDataSource(
        {key: small(np.insert(cells[kept], places, np.nan)) for key, cells in columns.items()}
    )


def _main_plot(
    channels: Sequence[Channel],
    source: ColumnDataSource,
    record: RunFit,
    broken: ColumnDataSource,
    run: Run,
) -> Any:
    plot = new_plot(220, "", channels[0].unit.replace("_per_", "/") or "value")
    several = len(channels) > 1
    in_order = run.drawn_over is None
    for place, channel in enumerate(channels):
        colour = colour_of(place, channel, several)
        noise = 2 * record.channels[channel.name].compared_noise
        fitted = f"f{place}"
        if in_order:
            edges = [dodge(fitted, noise), dodge(fitted, -noise)]
            plot.varea("x", *edges, source=source, fill_color=colour, fill_alpha=0.15)
        if f"l{place}" in source.data and in_order:
            ends = {"y1": f"l{place}", "y2": f"u{place}"}
            plot.varea("x", **ends, source=source, fill_color=VERMILLION, fill_alpha=0.3)
        dots = plot.scatter(
            "x", f"r{place}", source=source, size=3.5, color=colour if several else GREY, alpha=0.6
        )
        if f"h{place}" in source.data:
            hollow = {"fill_color": None, "line_color": VERMILLION}
            plot.scatter("x", f"h{place}", source=source, size=4.5, **hollow)
        drawn = broken if broken.data else source
        colour = INK if several else BLUE
        plot.line("x", fitted, source=drawn, color=colour, line_width=1.3)
        tips = [("at", "@x"), ("recorded", f"@r{place}"), ("fitted", f"@f{place}")]
        plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    return plot


def _residual_plot(
    channels: Sequence[Channel], source: ColumnDataSource, record: RunFit, main: Any, label: str
) -> Any:
    plot = new_plot(140, label, "residual", x_range=main.x_range)
    noise = 2 * max(record.channels[channel.name].compared_noise for channel in channels)
    plot.add_layout(BoxAnnotation(bottom=-noise, top=noise, fill_color=BLUE, fill_alpha=0.1))
    for place, channel in enumerate(channels):
        colour = colour_of(place, channel, len(channels) > 1)
        dots = plot.scatter("x", f"d{place}", source=source, size=3, color=colour, alpha=0.6)
        tips = [("at", "@x"), ("residual", f"@d{place}")]
        plot.add_tools(HoverTool(renderers=[dots], tooltips=tips))
    return plot


def _note(channels: Sequence[Channel], record: RunFit) -> str:
    fits = [record.channels[channel.name] for channel in channels]
    known = [fit.rmse for fit in fits if fit.rmse is not None]
    unit = f" {fits[0].unit}" if fits[0].unit else ""
    noise = max(fit.compared_noise for fit in fits)
    rmse = f"{max(known):.3g}{unit}" if len(known) == len(fits) else "not finite"
    return f"RMSE {rmse}, noise {noise:.3g}{unit}"
