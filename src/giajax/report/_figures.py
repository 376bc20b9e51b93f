"""The figures of a fit: recorded against fitted, residuals, correlation."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from ..fitting import FitResult
from ..runs import Channel, Run
from ._style import BLUE, GREEN, GREY, INK, LIGHT, VERMILLION, new_figure, plain

# More panels than this cannot be read on one screen.
_MOST_PANELS = 24

# More matrix cells than this leave no room for a number in each.
_MOST_NUMBERS = 16

MINUS = "\N{MINUS SIGN}"

_COMPONENTS = {"x": BLUE, "y": VERMILLION, "z": GREEN}


def recorded_figure(
    result: FitResult, run: Run, predicted: Mapping[str, np.ndarray], record: Mapping[str, Any]
) -> Figure:
    """Recorded against fitted channels of one run, in the units of its file.

    One panel a channel; the components of a link or of the tip share one where there would be
    too many. Cells that were not measured are gaps between the dots.

    Arguments:
        result: the fit.
        run: the recorded run.
        predicted: what the fitted model predicts for it, SI.
        record: the run's entry in `result.runs`.
    """
    panels, left_out = _panels(run)
    columns = _columns(len(panels))
    rows = -(-len(panels) // columns)
    title = f"{run.name}: recorded and fitted{_unfinished(result)}"
    if left_out:
        title += f"; {left_out} more channels are in prediction.csv"
    figure = new_figure(max(3.7 * columns, 6.5), max(2.05 * rows, 2.4) + 0.6, title)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    times = _times(run)
    for position, axes in enumerate(grid.flat):
        if position >= len(panels):
            axes.set_visible(False)
            continue
        _draw_panel(axes, panels[position], run, times, predicted, record)
        # The last panel of each column carries the time axis, also above an empty place.
        if position + columns >= len(panels):
            axes.set_xlabel("time (s)" if run.times is not None else "sample")
            axes.tick_params(labelbottom=True)
    _legend(figure, any(len(names) > 1 for names in panels))
    return figure


def residuals_figure(
    result: FitResult, runs: Sequence[Run], predictions: Sequence[Mapping[str, np.ndarray]]
) -> Figure:
    """Residuals in units of the noise: over time, as a distribution, and by channel."""
    tables = [
        _weighted(run, predicted, record)
        for run, predicted, record in zip(runs, predictions, result.runs, strict=True)
    ]
    shown = min(len(runs), 6)
    title = f"Residuals (recorded - fitted) in units of the noise{_unfinished(result)}"
    if shown < len(runs):
        title += f"; the first {shown} of {len(runs)} runs over time"
    figure = new_figure(11, 2.3 * shown + 2.9, title)
    grid = figure.add_gridspec(
        shown + 1, 2, width_ratios=[3, 1], height_ratios=[1.0] * shown + [0.9]
    )
    everything = np.concatenate([table[~np.isnan(table)] for table in tables])
    limit = float(np.clip(np.abs(everything).max(initial=0.0), 4.0, 8.0))
    for index in range(shown):
        axes = figure.add_subplot(grid[index, 0])
        _draw_over_time(axes, runs[index], tables[index], limit)
        if index == 0:
            _legend_above(axes)
    _draw_distribution(figure.add_subplot(grid[:shown, 1]), everything, limit)
    _draw_by_channel(figure.add_subplot(grid[shown, :]), runs, tables)
    return figure


def correlation_figure(result: FitResult) -> Figure:
    """Correlations between the parameters that the data determine."""
    paths = result.correlation["parameters"]
    matrix = np.array(result.correlation["matrix"], dtype=float).reshape(len(paths), len(paths))
    size = max(0.55 * len(paths), 1.0)
    title = f"Correlation of the estimates{_unfinished(result)}"
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


def _unfinished(result: FitResult) -> str:
    return "" if result.status == "converged" else f" ({result.status.replace('_', ' ')})"


def _times(run: Run) -> np.ndarray:
    if run.times is not None:
        return run.times
    return np.arange(len(next(iter(run.values.values()))), dtype=float)


def _panels(run: Run) -> tuple[list[list[str]], int]:
    """Names of the channels in each panel, and how many channels have none."""
    names = list(run.observations)
    panels = [[name] for name in names]
    if len(panels) > _MOST_PANELS:
        together: dict[Any, list[str]] = {}
        for name in names:
            channel = run.channels[name]
            together.setdefault((channel.kind, channel.index, channel.unit), []).append(name)
        panels = list(together.values())
    if len(panels) <= _MOST_PANELS:
        return panels, 0
    chosen = np.linspace(0, len(panels) - 1, _MOST_PANELS).round().astype(int)
    panels = [panels[i] for i in chosen]
    return panels, len(names) - sum(len(panel) for panel in panels)


def _columns(panels: int) -> int:
    return next(c for c, most in ((1, 1), (2, 8), (3, 15), (4, _MOST_PANELS)) if panels <= most)


def _draw_panel(
    axes: Axes,
    names: list[str],
    run: Run,
    times: np.ndarray,
    predicted: Mapping[str, np.ndarray],
    record: Mapping[str, Any],
) -> None:
    channels = [run.channels[name] for name in names]
    several = len(channels) > 1
    size = 1.6 if len(times) > 400 else 2.6
    for channel in channels:
        axes.plot(
            times,
            channel.from_si(run.observations[channel.name]),
            linestyle="none",
            marker="o",
            # A precise recording would hide behind the line.
            markersize=size + 0.8 if several else size,
            markeredgewidth=0,
            color=_colour(channel) if several else GREY,
            alpha=0.6,
        )
    for channel in channels:
        fitted = channel.from_si(predicted[channel.name])
        axes.plot(times, fitted, color=INK if several else BLUE, linewidth=0.8 if several else 1.2)
    unit = f" ({channels[0].unit.replace('_per_', '/')})" if channels[0].unit else ""
    plain(axes, (names[0] if len(names) == 1 else names[0][:-2]) + unit)
    axes.yaxis.set_major_locator(MaxNLocator(5))
    worst = [record["channels"][name]["rmse"] for name in names]
    if None not in worst:
        axes.set_title(f"RMSE {max(worst):.3g}", fontsize=8, loc="right", color=GREY)


def _colour(channel: Channel) -> str:
    return BLUE if channel.component is None else _COMPONENTS["xyz"[channel.component]]


def _legend(figure: Figure, components: bool) -> None:
    """One legend for all panels, in the title's line."""
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4}
    recorded: dict[str, str] = {"recorded": GREY}
    if components:
        recorded = {f"{name} recorded": colour for name, colour in _COMPONENTS.items()}
    handles = [
        *(Line2D([], [], color=colour, label=name, **dots) for name, colour in recorded.items()),
        Line2D([], [], color=INK if components else BLUE, linewidth=1.4, label="fitted"),
    ]
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False
    )


def _weighted(
    run: Run, predicted: Mapping[str, np.ndarray], record: Mapping[str, Any]
) -> np.ndarray:
    """Residuals in units of the noise, NaN where not measured; shape (sample, channel)."""
    columns = []
    for name, values in run.observations.items():
        sigma = run.channels[name].to_si(record["channels"][name]["noise"])
        columns.append((values - predicted[name]) / sigma)
    return np.stack(columns, axis=-1)


def _draw_over_time(axes: Axes, run: Run, table: np.ndarray, limit: float) -> None:
    times = _times(run)
    count = table.size
    axes.plot(
        np.broadcast_to(times[:, None], table.shape).ravel(),
        np.clip(table, -limit, limit).ravel(),
        linestyle="none",
        marker="o",
        markeredgewidth=0,
        markersize=2.4 if count < 3000 else 1.6,
        alpha=0.55 if count < 3000 else 0.3,
        color=GREY,
        label="each value",
    )
    centres, rms = _running_rms(times, table)
    axes.plot(centres, rms, color=VERMILLION, linewidth=1.6, label="RMS (1 if only noise is left)")
    axes.axhline(1, color=VERMILLION, linewidth=0.8, linestyle=(0, (4, 3)))
    plain(axes, run.name)
    axes.set_ylim(-1.05 * limit, 1.05 * limit)
    axes.set_ylabel("residual / noise")
    axes.set_xlabel("time (s)" if run.times is not None else "sample")


def _running_rms(times: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Root mean square over all channels in up to 40 equal spans of time."""
    spans = int(np.clip(table.size // 40, 1, 40))
    edges = np.linspace(times[0], times[-1], spans + 1)
    member = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, spans - 1)
    centres, rms = [], []
    for span in range(spans):
        cells = table[member == span]
        cells = cells[~np.isnan(cells)]
        centres.append((edges[span] + edges[span + 1]) / 2)
        # A span without a measurement is a gap in the line.
        rms.append(np.sqrt(np.mean(cells**2)) if cells.size else np.nan)
    return np.asarray(centres), np.asarray(rms)


def _draw_distribution(axes: Axes, values: np.ndarray, limit: float) -> None:
    bins = int(np.clip(np.sqrt(values.size), 10, 60))
    inside = values[np.abs(values) <= limit]
    axes.hist(
        inside,
        bins=bins,
        range=(-limit, limit),
        # A density of all values, also of those beyond the axis.
        weights=np.full(inside.size, bins / (2 * limit * max(values.size, 1))),
        color=GREY,
        alpha=0.5,
        orientation="horizontal",
        label="residuals",
    )
    grid = np.linspace(-limit, limit, 201)
    normal = np.exp(-(grid**2) / 2) / np.sqrt(2 * np.pi)
    axes.plot(normal, grid, color=BLUE, linewidth=1.4, label="standard normal")
    plain(axes)
    axes.set_ylim(-1.05 * limit, 1.05 * limit)
    axes.set_xlabel("density")
    _legend_above(axes)
    beyond = values.size - inside.size
    if beyond:
        axes.text(
            0.98,
            0.98,
            f"{beyond} of {values.size}\nbeyond {limit:.0f}",
            transform=axes.transAxes,
            fontsize=8,
            color=GREY,
            ha="right",
            va="top",
        )


def _legend_above(axes: Axes) -> None:
    """In the line of the title, where no value can hide behind it."""
    axes.legend(
        fontsize=8,
        frameon=False,
        loc="lower right",
        bbox_to_anchor=(1, 1),
        ncols=2,
        borderaxespad=0.2,
        columnspacing=1.2,
        markerscale=1.8,
    )


def _draw_by_channel(axes: Axes, runs: Sequence[Run], tables: Sequence[np.ndarray]) -> None:
    """Which channel the model misses: RMS of its residuals in all runs."""
    names = list(dict.fromkeys(name for run in runs for name in run.observations))
    squares: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for run, table in zip(runs, tables, strict=True):
        for column, name in enumerate(run.observations):
            cells = table[:, column]
            squares[name].append(cells[~np.isnan(cells)] ** 2)
    rms = [float(np.sqrt(np.mean(np.concatenate(squares[name])))) for name in names]
    places = np.arange(len(names))
    axes.vlines(places, 0, rms, color=LIGHT, linewidth=3)
    axes.plot(places, rms, "o", color=BLUE, markersize=5 if len(names) < 40 else 3.5)
    axes.axhline(1, color=VERMILLION, linewidth=0.8, linestyle=(0, (4, 3)))
    plain(axes, "by channel")
    axes.grid(False, axis="x")
    axes.set_ylim(0, None)
    axes.set_xlim(-0.7, len(names) - 0.3)
    axes.set_ylabel("RMS residual / noise")
    # Every name where they can be read, else every n-th.
    every = -(-len(names) // 80)
    upright = len(names) > 10
    axes.set_xticks(places[::every], names[::every], rotation=90 if upright else 0)
    axes.tick_params(axis="x", labelsize=8 if len(names) <= 40 else 6)
