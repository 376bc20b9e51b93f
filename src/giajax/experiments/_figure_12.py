"""Fig. 12 of the paper: measured against target angles, without and with compensation."""

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..report import BLUE, GREEN, GREY, INK, VERMILLION, new_figure, plain
from ._one_link import OneLink, Trial


class _Column(NamedTuple):
    """How the trials of a compensation are drawn."""

    title: str
    colour: str


_COLUMNS = {
    "none": _Column("without compensation", VERMILLION),
    "branches": _Column("eq. (12)", BLUE),
    "inverse": _Column("inverse of the modified Prandtl-Ishlinskii form", GREEN),
}
_HISTORIES = {"paper": "the paper's history", "other": "other amplitudes and minor loops"}


def figure_12(study: OneLink) -> Figure:
    """One row a history, one column a compensation."""
    histories = list(dict.fromkeys(trial.history.name for trial in study.trials))
    columns = list(dict.fromkeys(trial.compensation for trial in study.trials))
    title = "One link: measured against target angle, simulated joint, offset removed"
    figure = new_figure(3.6 * len(columns), 3.4 * len(histories) + 0.5, title)
    grid = figure.subplots(len(histories), len(columns), sharex=True, sharey=True, squeeze=False)
    for row, name in enumerate(histories):
        for column, compensation in enumerate(columns):
            axes = grid[row, column]
            _draw(axes, study.trial(name, compensation))
            if column == 0:
                axes.set_ylabel(f"{_HISTORIES.get(name, name)}\nmeasured angle (deg)")
            if row == len(histories) - 1:
                axes.set_xlabel("target angle (deg)")
            if row == 0:
                axes.set_title(_COLUMNS[compensation].title, fontsize=9, loc="left", color=INK)
    return figure


def _draw(axes: Axes, trial: Trial) -> None:
    ends = np.asarray([-65.0, 65.0])
    axes.plot(ends, ends, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
    measured = trial.history.measured
    axes.plot(
        trial.history.target[measured],
        trial.angles[measured],
        color=_COLUMNS[trial.compensation].colour,
        linewidth=0.9,
        marker="o",
        markersize=1.8,
        markeredgewidth=0,
    )
    plain(axes)
    axes.set_xlim(*ends)
    axes.set_ylim(-70, 70)
    axes.set_xticks(range(-60, 61, 20))
    axes.set_yticks(range(-60, 61, 20))
    axes.text(
        0.03,
        0.97,
        f"error: mean {trial.mean:.1f}, largest {trial.largest:.1f} deg",
        transform=axes.transAxes,
        fontsize=8,
        color=INK,
        va="top",
    )
