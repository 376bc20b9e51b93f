"""The picture of a run: recorded against fitted."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from ..fitting import FitResult, HeldOut, RunFit
from ..runs import Channel, Run
from ._abscissa import abscissa, channel_label, channels_together, sweep_starts
from ._style import BLUE, GREEN, GREY, INK, VERMILLION, new_figure, plain, unfinished

# More panels than this cannot be read on one screen.
_MOST_PANELS = 24

# Of cells that were fitted, and of those that were held out.
_SHADES = {False: GREY, True: VERMILLION}

_COMPONENTS = {"x": BLUE, "y": VERMILLION, "z": GREEN}


def recorded_figure(
    result: FitResult,
    run: Run,
    predicted: Mapping[str, np.ndarray],
    record: RunFit | HeldOut,
    held: Run | None = None,
) -> Figure:
    """Recorded against fitted channels of one run, in the units of its file.

    Over time, or over what makes them a curve, such as the input of a hysteresis loop.
    One panel a channel; the components of a link or of the tip share one where there would be
    too many. Cells that were not measured are gaps between the dots.

    Arguments:
        result: the fit.
        run: the recorded run.
        predicted: what the fitted model predicts for it, SI.
        record: the run's entry in `result.runs`, or in `result.held_out`.
        held: what was held out of it, which is drawn hollow; `run` itself for a picture of it.

    Returns:
        The picture.
    """
    panels, left_out = _panels(run)
    columns = _columns(len(panels))
    rows = -(-len(panels) // columns)
    alone = held is run
    what = "held out and predicted" if alone else "recorded and fitted"
    title = f"{run.name}: {what}{unfinished(result)}"
    if left_out:
        title += f"; {left_out} more channels are in prediction.csv"
    over, label = abscissa(run)
    # A curve is read best about as high as it is wide, a motion in a wide picture.
    height = 2.05 if run.drawn_over is None else 3.4
    figure = new_figure(max(3.7 * columns, 6.5), max(height * rows, 2.4) + 0.6, title)
    grid = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for position, axes in enumerate(grid.flat):
        if position >= len(panels):
            axes.set_visible(False)
            continue
        _draw_panel(axes, panels[position], run, over, predicted, record, held)
        # The last panel of each column carries the axis's name, also above an empty place.
        if position + columns >= len(panels):
            axes.set_xlabel(label)
            axes.tick_params(labelbottom=True)
    hollow = held is not None and any(
        name in held.observations for names in panels for name in names
    )
    _legend(figure, any(len(names) > 1 for names in panels), hollow=hollow, alone=alone)
    return figure


def _panels(run: Run) -> tuple[list[list[str]], int]:
    """Names of the channels in each panel, and how many channels have none."""
    panels = channels_together(run, _MOST_PANELS)
    if len(panels) <= _MOST_PANELS:
        return panels, 0
    chosen = np.linspace(0, len(panels) - 1, _MOST_PANELS).round().astype(int)
    panels = [panels[i] for i in chosen]
    return panels, len(run.observations) - sum(len(panel) for panel in panels)


def _columns(panels: int) -> int:
    return next(c for c, most in ((1, 1), (2, 8), (3, 15), (4, _MOST_PANELS)) if panels <= most)


def _draw_panel(
    axes: Axes,
    names: list[str],
    run: Run,
    over: np.ndarray,
    predicted: Mapping[str, np.ndarray],
    record: RunFit | HeldOut,
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
        axes.plot(
            over,
            channel.from_si(shown.observations[channel.name]),
            linestyle="none",
            marker="o",
            # A precise recording would hide behind the line.
            markersize=size + 0.8 if several or hollow else size,
            markeredgewidth=0.6 if hollow else 0,
            markerfacecolor="none" if hollow else None,
            color=_colour(channel) if several else _SHADES[hollow],
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
    known = [rmse for name in names if (rmse := record.channels[name].rmse) is not None]
    if len(known) == len(names):
        axes.set_title(f"RMSE {max(known):.3g}", fontsize=8, loc="right", color=GREY)


def _colour(channel: Channel) -> str:
    return BLUE if channel.component is None else _COMPONENTS["xyz"[channel.component]]


def _legend(figure: Figure, components: bool, *, hollow: bool, alone: bool) -> None:
    """One legend for all panels, in the title's line."""
    dots: dict[str, Any] = {"linestyle": "none", "marker": "o", "markersize": 4}
    recorded: dict[str, str] = {} if alone else {"recorded": GREY}
    if components:
        recorded = {f"{name} recorded": colour for name, colour in _COMPONENTS.items()}
    handles = [Line2D([], [], color=c, label=name, **dots) for name, c in recorded.items()]
    if hollow:
        colour = INK if components else _SHADES[True]
        handles.append(
            Line2D([], [], color=colour, markerfacecolor="none", label="held out", **dots)
        )
    word = "predicted" if alone else "fitted"
    handles.append(Line2D([], [], color=INK if components else BLUE, linewidth=1.4, label=word))
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False
    )
