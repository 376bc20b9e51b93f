"""Pictures of a fit: recorded and fitted values, residuals, correlations."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from ..fitting import (
    FitResult,
    HeldOut,
    PredictedRun,
    PredictionErrors,
    RunFit,
    errors_of,
    predict,
)
from ..recordings import Channel, Run, observing, unique_names
from ..runtime.text import InputError
from ..studies import UNEXPLAINED
from ..tasks import fitted_runs
from ._style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    MINUS,
    VERMILLION,
    new_figure,
    plain,
    plain_colorbar,
    to_png,
    unfinished,
)
from ._text import MOST_RUNS, correlation_text, worth_drawing

# A step this many times larger than usual, and larger than this fraction of the range, is a jump.
_JUMP, _FAR = 20, 0.3


def abscissa(run: Run) -> tuple[np.ndarray, str]:
    """Return the abscissa of a run, in the unit of the file, and its label."""
    name = run.drawn_over
    if name is None:
        return sample_times(run), time_label(run)
    return run.channels[name].from_si(run.values[name]), channel_label(run.channels[name])


def channel_label(channel: Channel) -> str:
    """Return the name and unit of a channel."""
    return channel.name + (f" ({channel.unit.replace('_per_', '/')})" if channel.unit else "")


def sample_times(run: Run) -> np.ndarray:
    """Return the sample times, s, or the sample numbers of a run without times."""
    if run.times is not None:
        return run.times
    return np.arange(len(next(iter(run.values.values()))), dtype=float)


def time_label(run: Run) -> str:
    """Return the label of `sample_times`."""
    return "time (s)" if run.times is not None else "sample"


def sweep_starts(over: np.ndarray) -> np.ndarray:
    """Return the samples at which a new sweep starts after a jump of the abscissa."""
    steps = np.abs(np.diff(over))
    usual = np.median(steps[steps > 0]) if np.any(steps > 0) else 0.0
    return np.flatnonzero((steps > _JUMP * usual) & (steps > _FAR * np.ptp(over))) + 1


def channels_together(run: Run, most: int) -> list[list[str]]:
    """Return the names of the channels that share a panel.

    Each channel has its own panel, unless there are more than `most`. Then the components of a link
    or of the tip share one.
    """
    names = list(run.observations)
    if len(names) <= most:
        return [[name] for name in names]
    together: dict[Any, list[str]] = {}
    for name in names:
        channel = run.channels[name]
        together.setdefault((channel.kind, channel.index, channel.unit), []).append(name)
    return list(together.values())


_MOST_NUMBERS = 16  # a larger matrix has no space for a number in each cell

_CORRELATION_CAPTION = (
    "Each coloured square shows the correlation coefficient of two estimates, from their "
    "covariance matrix. Red: positive. Blue: negative. A pair with a coefficient near -1 or 1 is "
    "strongly correlated: the data determine mainly a combination of the two parameters. Each pair "
    "is shown once, and grey squares are the diagonal of the matrix. Parameters that the data do "
    "not determine are omitted."
)


def correlation_figure(result: FitResult) -> Figure:
    """Plot the correlations between the parameters that the data determine."""
    paths = result.correlation.parameters
    matrix = np.array(result.correlation.matrix, dtype=float).reshape(len(paths), len(paths))
    size = max(0.55 * len(paths), 1.0)
    title = f"Correlation of the estimates{unfinished(result)}"
    caption = _CORRELATION_CAPTION if paths else "The data do not determine any parameter."
    figure = new_figure(min(size, 11) + 3.6, min(size, 11) + 1.9, title, caption)
    axes = figure.subplots()
    if not paths:
        axes.set_axis_off()
        axes.text(0.5, 0.5, "no parameter is determined", ha="center", fontsize=10, color=INK)
        return figure
    # Show each pair once, without the diagonal.
    below = np.where(np.tri(len(paths), k=-1, dtype=bool), matrix, np.nan)
    image = axes.imshow(below, cmap="RdBu_r", vmin=-1, vmax=1)
    axes.set_xticks(range(len(paths)), paths, rotation=45, ha="right", rotation_mode="anchor")
    axes.set_yticks(range(len(paths)), paths)
    axes.tick_params(labelsize=8, length=0, labelcolor=INK)
    axes.spines[:].set_visible(False)
    for i in range(len(paths)):
        axes.add_patch(Rectangle((i - 0.5, i - 0.5), 1, 1, facecolor=LIGHT, edgecolor="white"))
        for j in range(i if len(paths) <= _MOST_NUMBERS else 0):
            colour = "white" if abs(below[i, j]) > 0.6 else INK
            number = correlation_text(below[i, j]).replace("-", MINUS)
            axes.text(j, i, number, ha="center", va="center", fontsize=8, color=colour)
    plain_colorbar(axes, image, shrink=0.8, ticks=[-1, -0.5, 0, 0.5, 1])
    return figure


# More panels than this cannot be read on one screen.
_MOST_PANELS = 24
_COLUMNS = ((1, 1), (2, 8), (3, 15), (4, _MOST_PANELS))  # number of columns, maximum of panels

# Colours of fitted and of held-out cells.
_SHADES = {False: GREY, True: VERMILLION}

_COMPONENTS = {"x": (BLUE, "o"), "y": (VERMILLION, "s"), "z": (GREEN, "^")}


def plot(result: FitResult, run: Run | None = None) -> Figure:
    """Plot the recorded values of a run and the prediction of a fit, in the units of the run.

    Also available as `result.plot(run)`. Without a run, the fit must have a single run, which is
    read again from its file if the result was loaded.

    Raises:
        InputError: as in `giajax.predict`; the run is not one of the fitted ones; or no run is
            given, and there are several or the run has no file.

    Example:
        >>> result.plot().savefig("fit.png")  # doctest: +SKIP
    """
    if run is None:
        if len(result.runs) != 1:
            raise InputError(
                f"{len(result.runs)} runs were fitted: specify which one to plot, as in "
                "result.plot(run)"
            )
        (run,) = [each.run for each in result.predictions] or fitted_runs(result)
    known = (run.name, run.sha256)
    records = [each for each in result.runs if (each.name, each.sha256) == known]
    if len(records) != 1:
        why = (
            "several fitted runs have this name"
            if records
            else "its data have changed since the fit"
        )
        names = ", ".join(dict.fromkeys(each.name for each in result.runs))
        raise InputError(
            f"the run {run.name} cannot be assigned to a fitted run, because {why}: give one of "
            f"the fitted runs ({names}), or call result.predict(run).plot()"
        )
    return recorded_figure(result, run, result.predict(run), records[0])


def prediction_figure(predicted: PredictedRun) -> Figure:
    """Plot the prediction of a model for a run and the recorded values, in the units of the run.

    Also available as `result.predict(run).plot()`. A channel that the run does not have is in SI
    units. The layout is that of `recorded_figure`.

    Raises:
        InputError: no channel is predicted.
    """
    run = predicted.run
    if not predicted:
        raise InputError(
            f"no channel of the run {run.name} is predicted, because it has no recorded channel: "
            "name channels, as in predict(run, channels=[...])"
        )
    more = {name: Channel.named(name) for name in predicted if name not in run.channels}
    blank = np.full(len(sample_times(run)), np.nan)
    values = {**run.values, **dict.fromkeys(more, blank)}
    channels = {**run.channels, **more}
    run = dataclasses.replace(run, values=values, channels=channels, observed=tuple(predicted))
    known = {
        name: values
        for name, values in predicted.items()
        if not np.isnan(run.observations[name]).all()
    }
    title = f"{run.name}: {'recorded and ' if known else ''}predicted"
    return _figure(
        title, "predicted", run, predicted, errors_of(run, known), any_recorded=bool(known)
    )


def recorded_figure(
    result: FitResult,
    run: Run,
    predicted: Mapping[str, np.ndarray],
    record: RunFit | HeldOut,
    held: Run | None = None,
) -> Figure:
    """Plot recorded and fitted channels of one run, in the units of its file.

    The abscissa is time, or another quantity that gives a curve, such as the input of a hysteresis
    loop. Each channel has a panel; components of a link or of the tip share one if there would be
    too many. Cells that were not measured are gaps between the dots.

    Arguments:
        predicted: predictions of the fitted model for the run, SI.
        record: the entry of the run in `result.runs` or `result.held_out`.
        held: the held-out part of the run, drawn as hollow dots; `run` itself to plot only this
            part.
    """
    alone = held is run
    what = "held out and predicted" if alone else "recorded and fitted"
    title, line = f"{run.name}: {what}{unfinished(result)}", "predicted" if alone else "fitted"
    return _figure(title, line, run, predicted, record, held, any_recorded=not alone)


def _figure(
    title: str,
    line: str,
    run: Run,
    predicted: Mapping[str, np.ndarray],
    record: RunFit | HeldOut | PredictionErrors,
    held: Run | None = None,
    *,
    any_recorded: bool,
) -> Figure:
    """Plot as `recorded_figure`; `line` is the label of the prediction in the legend."""
    panels, left_out = _panels(run)
    columns = next(c for c, most in _COLUMNS if len(panels) <= most)
    rows = -(-len(panels) // columns)
    if left_out:
        title += f"; {left_out} more channels are in prediction.csv"
    over, label = abscissa(run)
    # A curve is easiest to read in a square panel, and a time series in a wide one.
    height = 2.05 if run.drawn_over is None else 3.4
    hollow = held is not None and any(
        name in held.observations for names in panels for name in names
    )
    several = any(len(names) > 1 for names in panels)
    caption = _caption(line, label, several, hollow=hollow, any_recorded=any_recorded)
    figure = new_figure(max(3.7 * columns, 6.5), max(height * rows, 2.4) + 0.6, title, caption)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for position, axes in enumerate(grid.flat):
        if position >= len(panels):
            axes.set_visible(False)
            continue
        _draw_panel(axes, panels[position], run, over, predicted, record, held)
        # The last panel of each column has the label of the abscissa, also above an empty place.
        if position + columns >= len(panels):
            axes.set_xlabel(label)
            axes.tick_params(labelbottom=True)
    _legend(figure, line, several, hollow=hollow, any_recorded=any_recorded)
    return figure


def _caption(line: str, across: str, several: bool, *, hollow: bool, any_recorded: bool) -> str:
    points = (
        " or the components of one point (x: blue circles, y: orange-red squares, "
        "z: green triangles)"
    )
    points, dots = (points, "markers") if several else ("", "dots")
    model = "fitted model" if line == "fitted" else "model"
    parts = [
        f"Each panel shows one channel{points} versus {across}, in the unit above the panel.",
        f"{'Line' if several else 'Blue line'}: prediction of the {model}.",
    ]
    if any_recorded:
        parts.append(f"{'Filled' if several else 'Grey'} {dots}: recorded values.")
    if hollow:
        colour = "" if several else " orange-red"
        parts.append(f"Hollow{colour} {dots}: recorded values that were held out of the fit.")
    if any_recorded or hollow:
        which = ", without the held-out values" if any_recorded and hollow else ""
        most = "; for several components, the largest RMSE is given" if several else ""
        parts.append(
            "RMSE: root-mean-square of the differences between recorded and predicted values"
            f"{which}{most}. Cells that were not measured are gaps between the {dots}."
        )
    return " ".join(parts)


def _panels(run: Run) -> tuple[list[list[str]], int]:
    """Return the names of the channels in each panel, and the number of channels without one."""
    panels = channels_together(run, _MOST_PANELS)
    if len(panels) <= _MOST_PANELS:
        return panels, 0
    chosen = np.linspace(0, len(panels) - 1, _MOST_PANELS).round().astype(int)
    panels = [panels[i] for i in chosen]
    return panels, len(run.observations) - sum(len(panel) for panel in panels)


def _draw_panel(
    axes: Axes,
    names: list[str],
    run: Run,
    over: np.ndarray,
    predicted: Mapping[str, np.ndarray],
    record: RunFit | HeldOut | PredictionErrors,
    held: Run | None,
) -> None:
    channels = [run.channels[name] for name in names]
    several = len(channels) > 1
    size = 1.6 if len(over) > 400 else 2.6
    cells = [(run, channel) for channel in channels if held is not run]
    if held is not None:
        cells += [(held, channel) for channel in channels if channel.name in held.observations]
    for shown, channel in cells:
        hollow = shown is held
        colour, mark = _style(channel) if several else (_SHADES[hollow], "o")
        axes.plot(
            over,
            channel.from_si(shown.observations[channel.name]),
            linestyle="none",
            marker=mark,
            # Dots of a precise recording would be hidden by the line.
            markersize=size + 0.8 if several or hollow else size,
            markeredgewidth=0.6 if hollow else 0,
            markerfacecolor="none" if hollow else None,
            color=colour,
            alpha=0.6,
        )
    sweeps = np.array([], dtype=int) if over is run.times else sweep_starts(over)
    line = np.insert(np.asarray(over, dtype=float), sweeps, np.nan)
    for channel in channels:
        fitted = np.insert(channel.from_si(predicted[channel.name]), sweeps, np.nan)
        axes.plot(line, fitted, color=INK if several else BLUE, linewidth=0.8 if several else 1.2)
    label = channel_label(channels[0])
    plain(axes, label if len(names) == 1 else label.replace(names[0], names[0][:-2]))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    records = [record.channels[name] for name in names if name in record.channels]
    known = [one.rmse for one in records if one.rmse is not None]
    if len(known) == len(names):
        axes.set_title(f"RMSE {max(known):.3g}", fontsize=8, loc="right", color=GREY)


def _style(channel: Channel) -> tuple[str, str]:
    """Return the colour and the marker of a component of a point."""
    return _COMPONENTS["xyz"[channel.component or 0]]


def _legend(
    figure: Figure, line: str, components: bool, *, hollow: bool, any_recorded: bool
) -> None:
    """Draw one legend for all panels, in the line of the title."""
    dots: dict[str, Any] = {"linestyle": "none", "markersize": 4}
    recorded = {"recorded": (GREY, "o")} if any_recorded else {}
    if components and (any_recorded or hollow):
        recorded = {f"{name} recorded": style for name, style in _COMPONENTS.items()}
    handles = [
        Line2D([], [], color=colour, marker=mark, label=name, **dots)
        for name, (colour, mark) in recorded.items()
    ]
    if hollow:
        colour = INK if components else _SHADES[True]
        handles.append(
            Line2D([], [], color=colour, marker="o", mfc="none", label="held out", **dots)
        )
    handles.append(Line2D([], [], color=INK if components else BLUE, linewidth=1.4, label=line))
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False
    )


_RESIDUALS_CAPTION = (
    "Residuals are divided by the standard deviation of white noise. Upper left: residuals of all "
    "channels of a run versus time or sample (grey; values beyond the axis are drawn at its "
    "edge), and their root-mean-square (RMS) in at most 40 equal intervals (orange-red). Upper "
    "right: distribution of the residuals of all runs, and the standard normal density (blue). "
    "Bottom: RMS of each channel over all runs (blue dots). Dashed lines: RMS of 1, which is "
    "expected if only noise remains."
)


def residuals_figure(
    result: FitResult, runs: Sequence[Run], predictions: Sequence[Mapping[str, np.ndarray]]
) -> Figure:
    """Plot residuals divided by the noise: versus time, as a distribution, and by channel.

    `predictions` are those of the fitted model for each run, SI, by channel.
    """
    tables = [
        _weighted(run, predicted, record)
        for run, predicted, record in zip(runs, predictions, result.runs, strict=True)
    ]
    shown = min(len(runs), 6)
    title = (
        f"Residuals (recorded - fitted) divided by the noise standard deviation{unfinished(result)}"
    )
    if shown < len(runs):
        title += f"; the first {shown} of {len(runs)} runs versus time"
    figure = new_figure(11, 2.3 * shown + 2.9, title, _RESIDUALS_CAPTION)
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


_SPREAD_CAPTION = (
    "Residuals (recorded - fitted) of the run with the largest residuals, divided by the standard "
    "deviation of white noise. Map: mean residuals of each channel in equal intervals of time "
    "or sample (red: positive, blue: negative). Missing values count as 0."
)

_CAUSES_CAPTION = (
    "Bottom: component common to the channels versus the command with the largest range and versus "
    "related quantities. The component belongs to the largest singular value of the residuals. Its "
    "sign is arbitrary. Grey dots: samples. Orange-red: means with standard errors of groups of "
    "equal numbers of samples."
)


def left_over_figure(
    result: FitResult, runs: Sequence[Run], predictions: Sequence[Mapping[str, np.ndarray]]
) -> Figure:
    """Plot the unexplained residuals of the run with the largest residuals.

    The first panel shows them versus time and along the arm. The others show the component that is
    common to the channels versus the command with the largest range, its rate, and the angle and
    rate of its joint.
    """
    tables = [
        np.nan_to_num(_weighted(run, predicted, record))
        for run, predicted, record in zip(runs, predictions, result.runs, strict=True)
    ]
    worst = int(np.argmax([np.mean(table**2) for table in tables]))
    run, table = runs[worst], tables[worst]
    causes = _causes(result, run)
    title = f"Residuals of {run.name} divided by the noise standard deviation"
    caption = f"{_SPREAD_CAPTION} {_CAUSES_CAPTION}" if causes else _SPREAD_CAPTION
    figure = new_figure(11, 6.4, title, caption)
    grid = figure.add_gridspec(2, max(len(causes), 1))
    _draw_spread(figure.add_subplot(grid[0, :]), run, table)
    left, sizes, _ = np.linalg.svd(table, full_matrices=False)
    common = left[:, 0] * sizes[0]
    for place, (label, values) in enumerate(causes.items()):
        axes = figure.add_subplot(grid[1, place])
        _draw_means(axes, values, common)
        plain(axes)
        axes.set_xlabel(label)
        if place == 0:
            axes.set_ylabel("component common to several channels")
    return figure


def _causes(result: FitResult, run: Run) -> dict[str, np.ndarray]:
    """Return possible causes of residuals by label: command, angle, and their rates."""
    moved = {name: row for name, row in run.commands.items() if row.dtype.kind == "f"}
    if not moved:
        return {}
    name = max(moved, key=lambda each: float(np.ptp(moved[each])))
    known = {name: moved[name]}
    channel = run.channels[name]
    if channel.kind == "joint_command":
        angle = f"joint{channel.index:02d}_angle"
        with contextlib.suppress(InputError):  # a user-defined model may not predict the angle
            known |= predict(result.model_of(run), run, [angle])
    causes = {}
    for each, values in known.items():
        shown = run.channels[name].from_si(values)
        causes[f"{each} ({channel.unit})"] = shown
        if run.times is not None:
            causes[f"its rate ({channel.unit}/s)"] = np.gradient(shown, run.times)
            causes = {label.replace("its", each, 1): item for label, item in causes.items()}
    return causes


def _draw_spread(axes: Axes, run: Run, table: np.ndarray) -> None:
    """Draw the mean residuals in intervals of time, by channel in the order of the links."""
    times = sample_times(run)
    spans = int(np.clip(len(times) // 8, 1, 120))
    edges = np.linspace(times[0], times[-1], spans + 1)
    member = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, spans - 1)
    counts = np.maximum(np.bincount(member, minlength=spans), 1)
    means = np.stack([np.bincount(member, row, minlength=spans) / counts for row in table.T])
    limit = float(np.clip(np.abs(means).max(initial=0.0), 1.0, 20.0))
    names = list(run.observations)
    picture = axes.pcolormesh(
        edges, np.arange(len(names) + 1), means, cmap="RdBu_r", vmin=-limit, vmax=limit
    )
    plain(axes, "Residuals versus time for each channel")
    axes.grid(False)
    every = -(-len(names) // 20)
    axes.set_yticks(np.arange(len(names))[::every] + 0.5, names[::every])
    axes.tick_params(axis="y", labelsize=7)
    axes.set_xlabel(time_label(run))
    plain_colorbar(axes, picture, label="mean residual / noise")


def _draw_means(axes: Axes, over: np.ndarray, values: np.ndarray) -> None:
    """Draw values versus an abscissa, and means with standard errors in equal parts of it."""
    axes.plot(over, values, "o", color=GREY, markersize=1.8, alpha=0.35, markeredgewidth=0)
    order = np.array_split(np.argsort(over, kind="stable"), int(np.clip(len(over) // 20, 2, 15)))
    centres = [float(np.mean(over[part])) for part in order]
    means = [float(np.mean(values[part])) for part in order]
    errors = [float(np.std(values[part]) / np.sqrt(len(part))) for part in order]
    axes.errorbar(centres, means, errors, color=VERMILLION, marker="o", markersize=4, linewidth=1.4)
    axes.axhline(0, color=INK, linewidth=0.8)


def _weighted(run: Run, predicted: Mapping[str, np.ndarray], record: RunFit) -> np.ndarray:
    """Return residuals divided by the noise, shape (sample, channel); NaN if not measured."""
    rests = {name: values - predicted[name] for name, values in run.observations.items()}
    columns = [
        rest / float(run.channels[name].to_si(record.channels[name].compared_noise))
        for name, rest in rests.items()
    ]
    return np.stack(columns, axis=-1)


def _draw_over_time(axes: Axes, run: Run, table: np.ndarray, limit: float) -> None:
    times = sample_times(run)
    few = table.size < 3000
    style: dict[str, Any] = {"linestyle": "none", "marker": "o", "markeredgewidth": 0}
    style |= {"markersize": 2.4 if few else 1.6, "alpha": 0.55 if few else 0.3, "color": GREY}
    over = np.broadcast_to(times[:, None], table.shape).ravel()
    axes.plot(over, np.clip(table, -limit, limit).ravel(), label="single values", **style)
    centres, rms = _running_rms(times, table)
    axes.plot(centres, rms, color=VERMILLION, linewidth=1.6, label="RMS (1 if only noise remains)")
    axes.axhline(1, color=VERMILLION, linewidth=0.8, linestyle=(0, (4, 3)))
    plain(axes, run.name)
    axes.set_ylim(-1.05 * limit, 1.05 * limit)
    axes.set_ylabel("residual / noise")
    axes.set_xlabel(time_label(run))


def _running_rms(times: np.ndarray, table: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the root mean square over all channels in up to 40 equal intervals of time."""
    spans = int(np.clip(table.size // 40, 1, 40))
    edges = np.linspace(times[0], times[-1], spans + 1)
    member = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, spans - 1)
    centres, rms = [], []
    for span in range(spans):
        cells = table[member == span]
        cells = cells[~np.isnan(cells)]
        centres.append((edges[span] + edges[span + 1]) / 2)
        # An interval without a measurement is a gap in the line.
        rms.append(np.sqrt(np.mean(cells**2)) if cells.size else np.nan)
    return np.asarray(centres), np.asarray(rms)


def _draw_distribution(axes: Axes, values: np.ndarray, limit: float) -> None:
    bins = int(np.clip(np.sqrt(values.size), 10, 60))
    inside = values[np.abs(values) <= limit]
    axes.hist(
        inside,
        bins=bins,
        range=(-limit, limit),
        # Normalised by all values, including those outside the axis.
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
        style: dict[str, Any] = {"fontsize": 8, "color": GREY, "ha": "right", "va": "top"}
        text = f"{beyond} of {values.size}\nresiduals beyond {limit:.0f}"
        axes.text(0.98, 0.98, text, transform=axes.transAxes, **style)


def _legend_above(axes: Axes) -> None:
    """Draw the legend in the line of the title, where it hides no values."""
    place: dict[str, Any] = {"loc": "lower right", "bbox_to_anchor": (1, 1), "ncols": 2}
    place |= {"borderaxespad": 0.2, "columnspacing": 1.2, "markerscale": 1.8}
    axes.legend(fontsize=8, frameon=False, **place)


def _draw_by_channel(axes: Axes, runs: Sequence[Run], tables: Sequence[np.ndarray]) -> None:
    """Draw the RMS residual of each channel in all runs."""
    names = list(dict.fromkeys(name for run in runs for name in run.observations))
    cells: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for run, table in zip(runs, tables, strict=True):
        for column, name in enumerate(run.observations):
            cells[name].append(table[~np.isnan(table[:, column]), column])
    rms = [float(np.sqrt(np.mean(np.concatenate(each) ** 2))) for each in cells.values()]
    places = np.arange(len(names))
    axes.vlines(places, 0, rms, color=LIGHT, linewidth=3)
    axes.plot(places, rms, "o", color=BLUE, markersize=5 if len(names) < 40 else 3.5)
    axes.axhline(1, color=VERMILLION, linewidth=0.8, linestyle=(0, (4, 3)))
    plain(axes, "RMS residual of each channel")
    axes.grid(False, axis="x")
    axes.set_ylim(0, None)
    axes.set_xlim(-0.7, len(names) - 0.3)
    axes.set_ylabel("RMS residual / noise")
    # Label every channel if there is space, otherwise every n-th one.
    every = -(-len(names) // 80)
    upright = len(names) > 10
    axes.set_xticks(places[::every], names[::every], rotation=90 if upright else 0)
    axes.tick_params(axis="x", labelsize=8 if len(names) <= 40 else 6)


def picture_files(
    result: FitResult,
    runs: Sequence[Run],
    names: Sequence[str],
    predictions: Sequence[Mapping[str, np.ndarray]],
    held_out: Sequence[Run],
) -> dict[str, bytes]:
    """Return the pictures of a fit by file name; `names` are the run names in file names."""
    files: dict[str, bytes] = {}
    everything = list(zip(runs, names, predictions, result.runs, strict=True))
    held = {(run.name, run.sha256): run for run in held_out}
    for run, name, predicted, record in (everything[index] for index in worth_drawing(result)):
        file = "recorded.png" if len(runs) == 1 else f"recorded_{name}.png"
        partly = held.get((run.name, run.sha256))
        files[file] = to_png(recorded_figure(result, run, predicted, record, partly))
    files |= _held_out_files(result, runs, held_out)
    files["residuals.png"] = to_png(residuals_figure(result, runs, predictions))
    files["correlation.png"] = to_png(correlation_figure(result))
    if any(reason.code == UNEXPLAINED for reason in result.verdict.reasons):
        files["left_over.png"] = to_png(left_over_figure(result, runs, predictions))
    return files


def _held_out_files(
    result: FitResult, runs: Sequence[Run], held_out: Sequence[Run]
) -> dict[str, bytes]:
    """Return pictures of runs and channels that are held out as a whole, by file name."""
    fitted = {(run.name, run.sha256): run.observations for run in runs}
    files: dict[str, bytes] = {}
    if len(result.held_predictions) != len(held_out):  # a loaded result has no predictions
        return files
    names = unique_names(held_out)
    several = zip(held_out, names, result.held_out, result.held_predictions, strict=True)
    for run, name, record, predicted in several:
        whole = run.observations.keys() - fitted.get((run.name, run.sha256), {}).keys()
        if whole and whole <= predicted.keys() and len(files) < MOST_RUNS:
            only = observing(run, [channel for channel in run.observations if channel in whole])
            figure = recorded_figure(result, only, predicted, record, only)
            files[f"held_out_{name}.png"] = to_png(figure)
    return files
