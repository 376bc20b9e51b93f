"""Fig. 19: the same operation in the model and in the experiment."""

import numpy as np
from matplotlib.axes import Axes

from ..report import BLUE, GREEN, GREY, INK, LIGHT, VERMILLION, new_figure, plain
from ..runs import Run
from ._concordance import WINDOW, compared, concordance, relative_error
from ._contenders import CONTENDERS, HEIGHTS, LINKS, Fits, times_of
from ._reproduced import Reproduced, Sources

STYLES = {
    "with_air": (BLUE, "-"),
    "without_air": (VERMILLION, (0, (1, 1.5))),
    "own": (GREEN, (0, (5, 2))),
}

STAND_IN = (
    "the experiment, whose recordings are not public: rigid bodies by MuJoCo, with drag along the "
    "links (C_D 1.1), added mass 1, 0.084 kg a link trimmed 0.15 m below the axis, 2.6 and 30 "
    "N m/rad, damping 0.04 N m s/rad, Dahl friction of 0.06 N m at 60 N m/rad in each joint, 0.05 "
    "m/s across with gusts to 0.2 m/s, and a camera at 10 Hz with noise of 20 mm (data/paper)."
)

SOURCES = Sources(
    printed="the model (eq. (1) at the centres of the links, 0.047 kg each), the base joint that "
    "bends, the four links, the window that table 3 compares (grey).",
    assumed="a bend to 30 deg within 1 s from 0.5 s on, and back from 12 s on; stiffness, damping "
    "and C_D are fitted. giajax's own model has the stand-in's structure, trim and added mass, and "
    "its friction is fitted, too. The run is the first of twenty; without air links leave the "
    "panels.",
    reconstructed=STAND_IN,
)


def fig19(fits: Fits) -> Reproduced:
    """Fig. 19, for the first run of the stand-in.

    Arguments:
        fits: of the stand-in's runs.
    """
    run = fits.runs[0]
    curves = {name: fits.predicted(name, run) for name in STYLES}
    times = times_of(run)
    figure = new_figure(10, 6.8, "Fig. 19: models, and a stand-in for the experiment")
    panels = figure.subplots(2, 2, sharex=True)
    rows = []
    columns = {"time_s": times}
    window = compared(times)
    for panel, link, channel in zip(panels.flat, LINKS, HEIGHTS, strict=True):
        _draw(panel, run, channel, {name: curves[name][channel] for name in curves})
        plain(panel, f"link {link}: z (m)")
        recorded = run.values[channel]
        columns[f"{channel}_recorded_m"] = recorded
        row: list[object] = [link]
        for name in curves:
            model = curves[name][channel]
            columns[f"{channel}_{name}_m"] = model
            row.append(f"{100 * concordance(model[window], recorded[window]):.0f}")
            row.append(f"{100 * relative_error(model[window], recorded[window]):.0f}")
        rows.append(tuple(row))
    for panel in panels[1]:
        panel.set_xlabel("time (s)")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=2, fontsize=8, frameon=False)
    headings = ["link"]
    for name in curves:
        headings += [f"{CONTENDERS[name].label}: concordance, %", "RMS error, %"]
    return Reproduced(
        "Fig. 19: the same operation in the models and in the experiment's stand-in",
        SOURCES,
        figure,
        tuple(headings),
        tuple(rows),
        columns,
        {"fits": fits.record()},
    )


def _draw(panel: Axes, run: Run, channel: str, curves: dict[str, np.ndarray]) -> None:
    recorded = run.values[channel]
    panel.axvspan(*WINDOW, color=LIGHT, linewidth=0, zorder=0, alpha=0.6)
    panel.plot(
        times_of(run),
        recorded,
        color=GREY,
        marker=".",
        markersize=2.5,
        linewidth=0,
        label="stand-in",
    )
    for name, curve in curves.items():
        colour, dashes = STYLES[name]
        panel.plot(
            times_of(run),
            curve,
            color=colour,
            linestyle=dashes,
            linewidth=1.4,
            label=CONTENDERS[name].label,
        )
    # Without air a link goes far beyond the others.
    shown = np.concatenate([recorded, curves["with_air"], curves["own"]])
    low, high = float(np.min(shown)), float(np.max(shown))
    margin = 0.25 * (high - low)
    panel.set_ylim(low - margin, high + margin)
    panel.axhline(0, color=INK, linewidth=0.6)
    panel.set_xlim(0, WINDOW[1])
