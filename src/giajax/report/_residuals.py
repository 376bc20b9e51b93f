"""The picture of the residuals: what the model misses, when and where."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..fitting import FitResult, RunFit
from ..noise import by_second_differences
from ..runs import Run
from ._abscissa import sample_times, time_label
from ._style import BLUE, GREY, LIGHT, VERMILLION, new_figure, plain, unfinished


def residuals_figure(
    result: FitResult, runs: Sequence[Run], predictions: Sequence[Mapping[str, np.ndarray]]
) -> Figure:
    """Residuals in units of the noise: over time, as a distribution, and by channel.

    Arguments:
        result: the fit.
        runs: the recorded runs.
        predictions: what the fitted model predicts for each, SI, by channel.

    Returns:
        The picture.
    """
    tables = [
        _weighted(run, predicted, record)
        for run, predicted, record in zip(runs, predictions, result.runs, strict=True)
    ]
    shown = min(len(runs), 6)
    title = f"Residuals (recorded - fitted) in units of the noise{unfinished(result)}"
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


def _weighted(run: Run, predicted: Mapping[str, np.ndarray], record: RunFit) -> np.ndarray:
    """Residuals in units of the noise, NaN where not measured; shape (sample, channel)."""
    columns = []
    for name, values in run.observations.items():
        rest = values - predicted[name]
        columns.append(rest / _noise(run, name, rest, record))
    return np.stack(columns, axis=-1)


def _noise(run: Run, name: str, rest: np.ndarray, record: RunFit) -> float:
    """The noise of a channel as the verdict sees it, SI: stated, or from sample to sample.

    What was estimated from the residuals may have taken in what the model misses.
    """
    stated = run.noise(name)
    if stated is not None:
        return stated
    adopted = float(run.channels[name].to_si(record.channels[name].noise))
    return adopted if run.times is None else min(by_second_differences(rest) or adopted, adopted)


def _draw_over_time(axes: Axes, run: Run, table: np.ndarray, limit: float) -> None:
    times = sample_times(run)
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
    axes.set_xlabel(time_label(run))


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
