"""Display a posterior as a table, as files and as a section of a page."""

import io
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from ..fitting import FitResult, column_factors, in_column_units
from ..recordings import Run, unique_names
from ..runtime.files import read_bytes
from ..runtime.text import InputError, format_estimate, format_number, format_range
from ..studies import Band, Marginal, Posterior, PosteriorSummary
from ._pictures import channel_label, sample_times, time_label
from ._style import (
    BLUE,
    GREEN,
    GREY,
    INK,
    ORANGE,
    PURPLE,
    SKY,
    VERMILLION,
    as_data,
    new_figure,
    plain,
    to_csv,
    to_png,
    unfinished,
)
from ._views import PageSection, RecordView, Table

# Panels of more parameters are too small. Those that differ most from the linear interval are kept.
_MOST_PARAMETERS = 8

_MOST_DOTS = 2000  # more dots overlap and make the file large
_BINS = 40
_RANKS = 20  # number of bins of ranks

_MOST_PANELS = 12


def _corner_caption(*, some: bool, diverging: bool) -> str:
    kept = (
        " Parameters whose posterior interval differs most from the linear interval are shown."
        if some
        else ""
    )
    red = " Orange-red crosses: all divergent draws of the sampler." if diverging else ""
    return (
        "Diagonal: histograms of the draws of all chains from the posterior distribution. Dashed "
        "lines: ends of the 95 % interval of the fit, from the Jacobian at the optimum and "
        f"Student's t. Below the diagonal: draws of each pair of parameters, at most {_MOST_DOTS} "
        f"(blue dots).{red}{kept}"
    )


def corner_figure(found: Posterior, result: FitResult) -> Figure:
    """Plot a histogram of each parameter, and dots for each pair, in the units of the columns.

    Each histogram also shows the linear interval of the fit. Divergent draws are crosses.
    """
    labels = _shown(found)
    factors = column_factors(result.model)
    draws = {label: each.ravel() for label, each in _draws(found, result, labels).items()}
    named = _named(found, result)
    count = len(labels)
    size = max(1.7 * count, 4.2)
    diverging = found.diverging.ravel().astype(bool)
    caption = _corner_caption(some=count < len(found.labels), diverging=bool(diverging.any()))
    title = _title("Posterior", found, result, labels)
    figure = new_figure(size + 1.2, size + 0.9, title, caption)
    grid = figure.subplots(count, count, sharex="col", squeeze=False)
    for row, below in enumerate(labels):
        for column, across in enumerate(labels):
            axes = grid[row, column]
            if column > row:
                axes.set_axis_off()
                continue
            plain(axes)
            axes.xaxis.set_major_locator(MaxNLocator(3))
            axes.yaxis.set_major_locator(MaxNLocator(3))
            if column == row:
                axes.hist(draws[below], bins=_BINS, color=BLUE, alpha=0.6)
                axes.set_yticks([])
                for end in found.summary.parameters[below].linear or ():
                    end *= factors.get(_path(below), 1.0)
                    axes.axvline(end, color=INK, linewidth=0.9, linestyle="--")
            else:
                _dots(axes, draws[across], draws[below], diverging)
                axes.tick_params(labelleft=column == 0)
                axes.set_ylabel("" if column else named[below])
            if row == count - 1:
                axes.set_xlabel(named[across])
    handles = [
        Patch(color=BLUE, alpha=0.6, label="draws"),
        Line2D([], [], color=INK, ls="--", label="linear 95 % interval"),
    ]
    if diverging.any():
        handles.append(Line2D([], [], marker="x", ls="none", color=VERMILLION, label="diverged"))
    figure.legend(handles=handles, loc="outside upper right", fontsize=8, frameon=False, ncols=3)
    return figure


_CHAIN_COLOURS = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY)
_CHAIN_LINES = ("-", "--", "-.", ":")

_TRACE_CAPTION = (
    "Left: draws of each chain in sequence, after its warm-up. Right: histograms of the ranks of "
    f"the draws of each chain among the draws of all chains, in {_RANKS} equal bins. Colours "
    "and line styles distinguish the chains. Thick grey line: number of draws in each bin if the "
    "ranks are uniform. The ranks of chains that have mixed are uniform except for random scatter."
)


def trace_figure(found: Posterior, result: FitResult) -> Figure:
    """Plot the draws of each chain in order, and histograms of their ranks, one line per chain.

    Ranks are computed among the draws of all chains. Chains that have mixed have uniform ranks:
    Vehtari, Gelman, Simpson, Carpenter and Buerkner, Bayesian Analysis 16 (2021) 667.
    """
    from scipy.stats import rankdata  # a second to import

    labels = _shown(found)
    title, named = _title("Chains of the posterior", found, result, labels), _named(found, result)
    figure = new_figure(8.5, 1.5 * len(labels) + 1.0, title, _TRACE_CAPTION)
    grid = figure.subplots(len(labels), 2, squeeze=False, width_ratios=(2, 1), sharex="col")
    for row, (label, draws) in zip(grid, _draws(found, result, labels).items(), strict=True):
        # Equal draws of a chain that does not move have equal ranks.
        ranks = rankdata(draws, method="average").reshape(draws.shape)
        for chain, (values, placed) in enumerate(zip(draws, ranks, strict=True)):
            style: dict[str, Any] = {
                "color": _CHAIN_COLOURS[chain % len(_CHAIN_COLOURS)],
                "linestyle": _CHAIN_LINES[chain % len(_CHAIN_LINES)],
                "label": f"chain {chain + 1}",
            }
            row[0].plot(np.arange(1, values.size + 1), values, linewidth=0.6, alpha=0.8, **style)
            row[1].hist(placed, bins=_RANKS, range=(1, ranks.size), histtype="step", **style)
        row[1].axhline(draws.shape[1] / _RANKS, color=GREY, linewidth=2.5, alpha=0.5)
        row[0].set_ylabel(named[label], fontsize=8)
        row[1].set_ylabel("draws", fontsize=8)
        for axes in row:
            plain(axes)
    grid[-1, 0].set_xlabel("draw")
    grid[-1, 1].set_xlabel("rank among all draws")
    handles = grid[0, 0].get_legend_handles_labels()[0]
    handles.append(Line2D([], [], color=GREY, lw=2.5, alpha=0.5, label="uniform ranks"))
    figure.legend(handles=handles, loc="outside lower center", fontsize=8, frameon=False, ncols=5)
    return figure


def _draws(found: Posterior, result: FitResult, labels: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the draws of each chain by label, in the units of the columns."""
    factors = column_factors(result.model)
    return {label: found.draws_of(label) * factors.get(_path(label), 1.0) for label in labels}


def _title(about: str, found: Posterior, result: FitResult, labels: Sequence[str]) -> str:
    more = len(found.labels) - len(labels)
    return about + unfinished(result) + (f"; {more} more parameters" if more else "")


def _units(found: PosteriorSummary, result: FitResult) -> dict[str, str]:
    """Return the unit of each parameter, as in the columns."""
    known = in_column_units(result.free, result.model)
    return {
        label: known.get(label.partition(" of ")[0], one).unit or ""
        for label, one in found.parameters.items()
    }


def _named(found: Posterior, result: FitResult) -> dict[str, str]:
    """Return the name of each parameter on an axis, with its unit."""
    units = _units(found.summary, result)
    return {label: _short(label) + (unit and f", {unit}") for label, unit in units.items()}


def _path(label: str) -> str:
    return label.partition(" of ")[0].partition("[")[0]


def _short(label: str) -> str:
    """Break a label such as `joints.pitch_stiffness` into two lines, to fit a narrow panel."""
    return label.replace(".", ".\n", 1)


def _shown(found: Posterior) -> list[str]:
    """Return the labels of the parameters that are drawn, in order."""

    def unlike(label: str) -> float:
        one = found.summary.parameters[label]
        if one.linear is None or one.interval[1] == one.interval[0]:
            return float("inf")
        ends = zip(one.interval, one.linear, strict=True)
        return max(abs(a - b) for a, b in ends) / (one.interval[1] - one.interval[0])

    kept = sorted(found.labels, key=unlike, reverse=True)[:_MOST_PARAMETERS]
    return [label for label in found.labels if label in kept]


def _dots(axes: Axes, across: np.ndarray, up: np.ndarray, diverging: np.ndarray) -> None:
    kept = np.unique(np.linspace(0, len(up) - 1, _MOST_DOTS).round().astype(int))
    axes.plot(across[kept], up[kept], "o", ms=1.6, color=BLUE, alpha=0.35, markeredgewidth=0)
    axes.plot(across[diverging], up[diverging], "x", ms=3.5, color=VERMILLION)


_BANDS_CAPTION = (
    "All values are relative to the median of the predictions of the posterior draws. Grey dots: "
    "recorded values. Orange-red band: predictions from the 2.5th to the 97.5th percentile, which "
    "represent the uncertainty of the parameters. Pale blue band: 95 % band of a recorded value, "
    "the root sum of squares of this uncertainty and of the noise estimated by the fit. The "
    "percentage above a panel is the fraction of the recorded values within the pale blue band."
)


def bands_figure(
    runs: Sequence[Run], bands: Sequence[Mapping[str, Band]], result: FitResult
) -> Figure:
    """Plot recorded values and their posterior prediction bands, in the units of their files.

    With many channels, those with the most cells outside of their bands are shown.
    """
    panels = [(at, name) for at, by_channel in enumerate(bands) for name in by_channel]

    def within(panel: tuple[int, str]) -> float:
        band = bands[panel[0]][panel[1]]
        return 1.0 if band.within is None else band.within

    kept = sorted(panels, key=within)[:_MOST_PANELS]
    drawn = [panel for panel in panels if panel in kept]
    columns = 1 if len(drawn) == 1 else 2 if len(drawn) <= 6 else 3
    rows = -(-len(drawn) // columns)
    more = len(panels) - len(drawn)
    title = f"Posterior predictions{unfinished(result)}"
    title += f"; {more} more channels are in posterior_bands.csv" if more else ""
    caption = _BANDS_CAPTION + " The channels with the lowest fractions are shown." * bool(more)
    figure = new_figure(max(4.2 * columns, 6.5), 2.3 * rows + 0.7, title, caption)
    grid = figure.subplots(rows, columns, squeeze=False)
    for position, axes in enumerate(grid.flat):
        if position >= len(drawn):
            axes.set_visible(False)
            continue
        at, name = drawn[position]
        _draw_band(axes, runs[at], name, bands[at][name], several=len(runs) > 1)
        if position + columns >= len(drawn):
            axes.set_xlabel(time_label(runs[at]))
    dots: dict[str, Any] = {"marker": "o", "ls": "none", "markersize": 3, "color": GREY}
    handles = [
        Line2D([], [], label="recorded minus median", **dots),
        Patch(color=VERMILLION, alpha=0.5, label="95 % from the parameters"),
        Patch(color=BLUE, alpha=0.15, label="95 % from parameters and noise"),
    ]
    figure.legend(handles=handles, loc="outside lower center", fontsize=8, frameon=False, ncols=3)
    return figure


def _draw_band(axes: Axes, run: Run, name: str, band: Band, *, several: bool) -> None:
    """Draw a band relative to its median, because it is often narrower than a line."""
    channel, over = run.channels[name], sample_times(run)
    median = channel.from_si(band.median)
    ends = (*band.with_noise(), band.low, band.high)
    low, high, least, most = (channel.from_si(each) - median for each in ends)
    axes.fill_between(over, low, high, color=BLUE, alpha=0.15, linewidth=0)
    axes.fill_between(over, least, most, color=VERMILLION, alpha=0.5, linewidth=0)
    recorded = channel.from_si(run.observations[name]) - median
    axes.plot(over, recorded, linestyle="none", marker="o", markersize=1.8, color=GREY, alpha=0.7)
    title = channel_label(channel)
    plain(axes, f"{run.name}: {title}" if several else title)
    if band.within is not None:
        axes.set_title(f"{band.within:.1%} in the 95 % band", fontsize=8, loc="right", color=GREY)


POSTERIOR_HEADINGS = [
    *("parameter", "unit", "mean", "deviation", "95 % interval", "linear interval"),
    *("R-hat", "ESS bulk", "ESS tail"),
]

# Files of a posterior. The format of the draws depends on the installed packages.
POSTERIOR, CORNER, TRACE = "posterior.json", "posterior.png", "posterior_trace.png"
BANDS, TABLE = "posterior_bands.png", "posterior_bands.csv"
DRAWS = ("posterior.nc", "posterior.npz")
POSTERIOR_FILES = (POSTERIOR, CORNER, TRACE, BANDS, TABLE, *DRAWS)


def posterior_rows(summary: PosteriorSummary, result: FitResult) -> list[list[str]]:
    """Return a row of text for each parameter, under `POSTERIOR_HEADINGS`, in column units.

    Parameters without an effect on any channel, which were held, come last.
    """
    factors, units = column_factors(result.model), _units(summary, result)
    rows = []
    for label, marginal in summary.parameters.items():
        rows.append(_row(label, marginal.times(factors.get(_path(label), 1.0), units[label])))
    known = in_column_units(result.parameters, result.model)
    for path in summary.held:
        one = known.get(path)  # missing for a single element or a parameter of a single run
        shown, unit = ("-", "") if one is None else (format_estimate(one.value, None)[0], one.unit)
        rows.append([path, unit or "-", shown, "-", "not determined", *["-"] * 4])
    return rows


def _row(label: str, one: Marginal) -> list[str]:
    deviation = one.deviation
    ranges = [format_range(ends, deviation) for ends in (one.interval, one.linear)]
    sizes = [format_number(ess, ".0f") for ess in (one.ess_bulk, one.ess_tail)]
    numbers = format_estimate(one.mean, deviation)
    return [label, one.unit or "-", *numbers, *ranges, format_number(one.r_hat, ".3f"), *sizes]


def posterior_files(found: Posterior, result: FitResult, runs: Sequence[Run]) -> dict[str, bytes]:
    """Return the files of a posterior: contents by name.

    `posterior.json` is the summary. `posterior.nc` contains the draws for ArviZ, or without ArviZ
    `posterior.npz`. `posterior.png` shows pairs of parameters, `posterior_trace.png` the draws of
    each chain, and `posterior_bands.csv` and `.png` the prediction bands of each channel. The runs
    are in the order of the fit.
    """
    name, draws = draws_file(found)
    return {
        POSTERIOR: found.summary.to_json().encode(),
        name: draws,
        TABLE: _bands_table(runs, found.bands),
        CORNER: to_png(corner_figure(found, result)),
        TRACE: to_png(trace_figure(found, result)),
        BANDS: to_png(bands_figure(runs, found.bands, result)),
    }


def draws_file(found: Posterior) -> tuple[str, bytes]:
    """Return name and contents of the file of draws: for ArviZ if installed, or for NumPy."""
    try:
        tree = found.to_arviz()
    except InputError:
        buffer = io.BytesIO()
        draws: dict[str, Any] = {
            "samples": found.samples,
            "lp": -found.energy,
            "diverging": found.diverging,
        }
        np.savez_compressed(buffer, parameters=np.array(found.labels), **draws)
        return DRAWS[1], buffer.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / DRAWS[0]
        tree.to_netcdf(str(path))
        return DRAWS[0], path.read_bytes()


def _bands_table(runs: Sequence[Run], bands: Sequence[Mapping[str, Band]]) -> bytes:
    """Return the prediction bands as CSV, with a row for each run, channel and sample."""
    words = ("run", "channel", "unit")
    numbers = ("time_s", "recorded", "median", "low", "high", "low_with_noise", "high_with_noise")
    columns: dict[str, list[object]] = {name: [] for name in (*words, *numbers)}
    for run, name, by_channel in zip(runs, unique_names(runs), bands, strict=True):
        times = sample_times(run)
        for channel, band in by_channel.items():
            about = run.channels[channel]
            ends = (run.observations[channel], band.median, band.low, band.high, *band.with_noise())
            cells = (times, *(about.from_si(each) for each in ends))
            for column, values in zip(numbers, cells, strict=True):
                columns[column] += values.tolist()
            for column, word in zip(words, (name, channel, about.unit), strict=True):
                columns[column] += [word] * len(times)
    return to_csv(columns)


_MOST_BYTES = 600_000  # a page must stay below 5 MB, so a larger picture is only in its file
_PICTURES = {
    CORNER: "pairs of parameters",
    TRACE: "draws of each chain, and their ranks",
    BANDS: "recorded channels with the bands of the posterior",
}


def _table(summary: PosteriorSummary, result: FitResult, most: int | None = None) -> Table:
    return Table.of_parameters(POSTERIOR_HEADINGS, posterior_rows(summary, result)[:most], 2)


def _chains(summary: PosteriorSummary) -> str:
    return f"{summary.chains} chains of {summary.draws} draws; {summary.divergences} draws diverged"


def _sentences(summary: PosteriorSummary, most: int | None) -> list[str]:
    held = (
        [f"fixed, because no channel responds: {', '.join(summary.held)}"] if summary.held else []
    )
    return [_chains(summary), *held, *(f"warning: {doubt}" for doubt in summary.warnings)]


def _section(summary: PosteriorSummary, result: FitResult, folder: Path) -> PageSection:
    note = f"{_chains(summary)}; the noise is fixed at its fitted value"
    if summary.held:
        note += f", as are parameters without an effect on any channel ({', '.join(summary.held)})"
    note += (
        ". R-hat is 1 if the chains agree; ESS is the equivalent number of independent draws; the "
        "linear interval is computed from the Jacobian alone."
    )
    shares = [
        (share, f"{channel} of {run}")
        for run, by_channel in summary.within.items()
        for channel, share in by_channel.items()
        if share is not None
    ]
    if shares:
        least, where = min(shares)
        note += (
            f" The 95 % band contains at least {least:.1%} of the recorded values of each channel "
            f"(lowest: {where})."
        )
    return PageSection(
        id="posterior",
        name="Posterior",
        heading="Posterior",
        warnings=summary.warnings,
        table=_table(summary, result),
        note=note,
        pictures=[
            (data, words) for name, words in _PICTURES.items() if (data := _picture(folder / name))
        ],
    )


def _picture(path: Path) -> str:
    try:
        content = read_bytes(path, _MOST_BYTES)
    except (OSError, InputError):
        return ""
    return as_data(content)


RecordView(place=3, record=PosteriorSummary, table=_table, sentences=_sentences, section=_section)
