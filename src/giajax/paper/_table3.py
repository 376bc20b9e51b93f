"""Table 3: how well models with and without air follow the experiment."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..report import BLUE, GREEN, GREY, INK, VERMILLION, new_figure, plain
from ._concordance import compared, concordance, relative_error
from ._contenders import CONTENDERS, HEIGHTS, LINKS, Fits, times_of
from ._fig19 import STAND_IN
from ._reproduced import Reproduced, Sources

PRINTED = {"with_air": (77, 94, 51, 62, 71), "without_air": (78, 32, -99, -190, -45)}
"""The paper's table, %: links 2, 6, 12, 20, and their average."""

COLOURS = {"with_air": BLUE, "without_air": VERMILLION, "refitted": GREY, "own": GREEN}

SOURCES = Sources(
    printed="the definition of the concordance (mean of 1 - |Xm - Xe| / |Xe| every 0.1 s from 10 "
    "to 25 s), the links, and the numbers of the first two rows.",
    assumed="that the displacement is z, and that the paper's model was fitted to the run that it "
    "is compared with; a sample where Xe is exactly 0 has no term. giajax's own model has the "
    "stand-in's structure, trim and added mass; its C_D, stiffness, damping and friction are "
    "fitted to one more run, in twelve iterations at most.",
    reconstructed=STAND_IN,
)

_PLACES = (*(f"link {link}" for link in LINKS), "average")


def table3(fits: Fits) -> Reproduced:
    """Table 3 over all runs of the stand-in, beside the numbers that the paper prints.

    Arguments:
        fits: of the stand-in's runs.
    """
    rates = {name: np.empty((len(fits.runs), len(LINKS))) for name in CONTENDERS}
    errors = {name: np.empty_like(rates[name]) for name in CONTENDERS}
    for number, run in enumerate(fits.runs):
        rows = compared(times_of(run))
        for name in CONTENDERS:
            predicted = fits.predicted(name, run)
            for place, channel in enumerate(HEIGHTS):
                both = predicted[channel][rows], run.values[channel][rows]
                rates[name][number, place] = concordance(*both)
                errors[name][number, place] = relative_error(*both)
    return Reproduced(
        "Table 3: concordance of models and experiment (a stand-in simulated by MuJoCo)",
        SOURCES,
        _drawn(rates, errors),
        ("model", "measure, %", *_PLACES),
        _rows(rates, errors),
        _columns(fits, rates, errors),
        {"fits": fits.record()},
    )


def with_average(values: np.ndarray) -> np.ndarray:
    """Values of the links, and their average, shape (run, link + 1)."""
    return np.concatenate([values, values.mean(axis=1, keepdims=True)], axis=1)


def _rows(
    rates: dict[str, np.ndarray], errors: dict[str, np.ndarray]
) -> tuple[tuple[str, ...], ...]:
    """The paper's rows, then median and range over the runs."""
    words = {"with_air": "with air", "without_air": "without air"}
    rows = [
        (f"the paper, {words[name]}", "concordance", *map(str, numbers))
        for name, numbers in PRINTED.items()
    ]
    for measure, values in (("concordance", rates), ("RMS error", errors)):
        for name, contender in CONTENDERS.items():
            cells = (_range(column) for column in 100 * with_average(values[name]).T)
            rows.append((contender.label, measure, *cells))
    return tuple(rows)


def _range(column: np.ndarray) -> str:
    return f"{np.median(column):.0f} ({column.min():.0f} .. {column.max():.0f})"


def _columns(
    fits: Fits, rates: dict[str, np.ndarray], errors: dict[str, np.ndarray]
) -> dict[str, list[object]]:
    columns: dict[str, list[object]] = {
        name: [] for name in ("run", "model", "link", "concordance", "rms_error")
    }
    for name in CONTENDERS:
        for number, run in enumerate(fits.runs):
            for place, link in enumerate(LINKS):
                cells = (run.name, name, link, rates[name][number, place])
                error = errors[name][number, place]
                for column, cell in zip(columns.values(), (*cells, error), strict=True):
                    column.append(cell)
    return columns


def _drawn(rates: dict[str, np.ndarray], errors: dict[str, np.ndarray]) -> Figure:
    figure = new_figure(
        11, 5.2, f"Table 3: {len(rates['own'])} runs of a stand-in that MuJoCo simulated"
    )
    left, right = figure.subplots(1, 2)
    _dots(left, rates)
    for name, numbers in PRINTED.items():
        left.plot(
            np.arange(len(_PLACES)) + _offset(name),
            numbers,
            color=INK,
            marker="D",
            markersize=5,
            markerfacecolor=COLOURS[name],
            linewidth=0,
            label="printed in the paper" if name == "with_air" else None,
            zorder=4,
        )
    left.set_yscale("symlog", linthresh=100)
    left.set_ylim(top=130)
    left.yaxis.set_major_formatter("{x:g}")
    left.axhline(100, color=INK, linewidth=0.6)
    plain(left, "concordance (%), linear above -100")
    _dots(right, errors)
    right.set_yscale("log")
    right.yaxis.set_major_formatter("{x:g}")
    plain(right, "RMS error over RMS displacement (%)")
    handles, labels = left.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper right", ncols=3, fontsize=8, frameon=False)
    return figure


def _offset(name: str) -> float:
    return 0.18 * (list(CONTENDERS).index(name) - (len(CONTENDERS) - 1) / 2)


def _dots(panel: Axes, values: dict[str, np.ndarray]) -> None:
    """A dot for each run, and a bar at the median."""
    for name, each in values.items():
        percent = 100 * with_average(each)
        for place, column in enumerate(percent.T):
            at = place + _offset(name)
            panel.plot(
                np.full(len(column), at),
                column,
                color=COLOURS[name],
                marker="o",
                markersize=3,
                markeredgewidth=0,
                alpha=0.5,
                linewidth=0,
            )
            panel.plot(
                [at - 0.07, at + 0.07],
                [np.median(column)] * 2,
                color=COLOURS[name],
                linewidth=2,
                label=CONTENDERS[name].label if place == 0 else None,
            )
    panel.set_xticks(range(len(_PLACES)), _PLACES)
