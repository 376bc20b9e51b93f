"""The plots of one run, as what BokehJS draws: recorded and fitted, residuals, their memory."""

import json
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from bokeh.embed import json_item
from bokeh.layouts import column
from bokeh.models import BoxAnnotation, ColumnDataSource, HoverTool
from bokeh.transform import dodge

from ...fitting import RunFit
from ...runs import Channel, Run
from .._abscissa import abscissa, channel_label, channels_together, sweep_starts
from .._style import BLUE, GREY, INK, VERMILLION
from .._worst import times_noise
from ._figures import colour_of, memory_plot, new_plot, small
from ._thin import thinned


class Panel(NamedTuple):
    """The plots of one channel, or of the coordinates of one point.

    Attributes:
        title: names and unit.
        note: how well they are described.
        colours: of its channels by name, where several share it.
        item: what BokehJS embeds, as JSON.
        drawn, samples: how many of how many samples.
    """

    title: str
    note: str
    colours: dict[str, str]
    item: str
    drawn: int
    samples: int


def worst_panels(run: Run, record: RunFit, most: int) -> tuple[list[list[str]], int]:
    """Names of the channels of each panel, and how many channels have none.

    Of more than `most` those that are described worst stay, in the order of the file.
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
    """The plots of some channels of a run.

    Arguments:
        names: of the channels.
        run: the recorded run.
        predicted: what the fitted model predicts for it, SI, by channel.
        record: the run's entry in the result.
        held: what was held out of it.
        bands: standard deviations of the prediction by the parameters, SI, by channel.
        values: about how many numbers the plots may hold.
    """
    over, label = abscissa(run)
    channels = [run.channels[name] for name in names]
    data, residuals = _columns(channels, run, predicted, held, bands)
    extremes = [data[key] for key in data if key[0] in "rdh"]
    kept = thinned(extremes, max(values // (len(data) + 1), 100))
    source = ColumnDataSource(
        {"x": small(over[kept])} | {key: small(cells[kept]) for key, cells in data.items()}
    )
    sweeps = np.empty(0, int) if over is run.times else sweep_starts(over)
    main = _main_plot(channels, source, record, _line(over, data, kept, sweeps), run)
    plots = [main, _residual_plot(channels, source, record, main, label)]
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
) -> tuple[dict[str, np.ndarray], list[np.ndarray]]:
    """Recorded, fitted, difference, held out and band by channel, in the units of the file."""
    data: dict[str, np.ndarray] = {}
    residuals = []
    for place, channel in enumerate(channels):
        recorded = channel.from_si(run.observations[channel.name])
        fitted = channel.from_si(predicted[channel.name])
        data[f"r{place}"], data[f"f{place}"] = recorded, fitted
        data[f"d{place}"] = recorded - fitted
        residuals.append(recorded - fitted)
        if held is not None and channel.name in held.observations:
            data[f"h{place}"] = channel.from_si(held.observations[channel.name])
        if bands and channel.name in bands:
            deviation = channel.from_si(bands[channel.name]) - channel.from_si(np.zeros(1))
            data[f"l{place}"] = fitted - 2 * deviation
            data[f"u{place}"] = fitted + 2 * deviation
    return data, residuals


def _line(
    over: np.ndarray, data: Mapping[str, np.ndarray], kept: np.ndarray, sweeps: np.ndarray
) -> ColumnDataSource:
    """The fitted values with a gap wherever the run jumps to another sweep; empty without one."""
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
    plot = new_plot(220, "", _unit(channels[0]))
    several = len(channels) > 1
    in_order = run.drawn_over is None
    for place, channel in enumerate(channels):
        colour = colour_of(place, channel, several)
        noise = 2 * record.channels[channel.name].noise
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
    noise = 2 * max(record.channels[channel.name].noise for channel in channels)
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
    noise = max(fit.noise for fit in fits)
    rmse = f"{max(known):.3g}{unit}" if len(known) == len(fits) else "not finite"
    return f"RMSE {rmse}, noise {noise:.3g}{unit}"


def _unit(channel: Channel) -> str:
    return channel.unit.replace("_per_", "/") or "value"
