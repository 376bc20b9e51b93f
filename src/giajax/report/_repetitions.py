"""Display bootstrap and influence: tables, sentences, pictures and sections of a page."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..fitting import FitResult
from ..runtime.text import format_estimate, format_number
from ..studies import Bootstrap, Influence, LeftOut, Repeated
from ._style import (
    BLUE,
    GREY,
    INK,
    LIGHT,
    VERMILLION,
    embedded,
    grid_of,
    new_figure,
    new_plot,
    plain,
    plain_colorbar,
)
from ._views import PageSection, RecordView, Table

_ACROSS = 3
# More histograms are too small to read, and a page needs fewer.
_MOST_DRAWN, _MOST_ON_PAGE = 12, 6


def bootstrap_table(found: Bootstrap) -> tuple[list[str], list[list[str]]]:
    """Return headings, and a row for each parameter and each derived quantity, in SI.

    Monte Carlo errors are one standard deviation. The coverage is that of the 95 % interval.
    """
    headings = ["parameter", "value", "error", "unit", "bias / error", "spread / error"]
    headings += ["percentile interval", "basic interval"]
    judged = any(one.coverage is not None for one in found.parameters.values())
    rows = [
        [
            path,
            *format_estimate(one.value, one.standard_error),
            one.unit or "-",
            _with_error(one.bias, one.bias_error, "+"),
            _with_error(one.ratio, one.ratio_error),
            _ends(one, one.percentile),
            _ends(one, one.basic),
            *([_coverage(one)] if judged else []),
        ]
        for path, one in found.parameters.items()
    ]
    return [*headings, *(["coverage"] if judged else [])], rows


def bootstrap_summary(found: Bootstrap) -> list[str]:
    """Return sentences for the table: the method, the converged repetitions, and omissions."""
    kind = "data simulated with the fitted model and noise model"
    if found.method == "block":
        kind = "data simulated with the fitted model and resampled blocks of residuals"
    how = "with the noise estimated again" if found.whole else "with fixed noise"
    sentences = [f"{found.size} repetitions, seed {found.seed}: {kind}, each fitted {how}"]
    if found.size < found.asked:
        sentences.append(
            f"{found.asked - found.size} of {found.asked} repetitions were not completed"
        )
    share = 100 * found.came_back / found.size
    others = f"; the others failed: {_listed(found.reasons)}" if found.reasons else ""
    sentences.append(f"{found.came_back} of {found.size} fits converged ({share:.3g} %){others}")
    sentences += [
        f"{path} ended at a bound in {count} of {found.came_back} repetitions"
        for path, count in found.at_bounds.items()
    ]
    if found.block_lengths:
        sentences.append(f"samples per block: {_listed(found.block_lengths)}")
    if found.noise_factor != 1:
        sentences.append(
            f"the simulated noise is {found.noise_factor:.3g} times the stated noise, to match "
            "the residuals"
        )
    return [*sentences, *found.failures, *found.notes]


def _listed(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{name} {count}" for name, count in counts.items())


def _drawn(found: Bootstrap, most: int) -> list[tuple[str, Repeated]]:
    return [(path, one) for path, one in found.parameters.items() if len(one.values) > 1][:most]


def _bootstrap_caption(found: Bootstrap) -> str:
    noise = "resampled blocks of residuals" if found.method == "block" else "simulated noise"
    return (
        "Grey: histogram of the estimates of the repetitions that converged, normalised to unit "
        f"area. Each repetition fits data that consist of the predictions of the result and {noise}"
        ". Dashed line: estimate of the result, which is the value from which the data were "
        "generated. Blue curve: normal distribution about this estimate with its standard error. "
        "Orange-red bar: 95 % of the estimates, from the 2.5th to the 97.5th percentile. The "
        "abscissa is in SI units."
    )


def bootstrap_figure(found: Bootstrap, title: str = "") -> Figure:
    """Plot the estimates of the repetitions and their distribution expected from the result."""
    # Imported here, because the import is slow and only this picture needs it.
    from scipy.stats import norm

    drawn = _drawn(found, _MOST_DRAWN)
    across = min(_ACROSS, max(len(drawn), 1))
    down = -(-max(len(drawn), 1) // across)
    title = title or f"{found.came_back} repetitions, {found.method}"
    caption = _bootstrap_caption(found) if drawn else "Histograms need at least two estimates."
    figure = new_figure(3.5 * across + 0.3, 2.5 * down + 0.5, title, caption)
    if not drawn:
        figure.text(0.5, 0.4, "fewer than two repetitions converged", color=GREY, ha="center")
    for (path, one), axes in zip(drawn, grid_of(figure, len(drawn), across), strict=True):
        values = np.asarray(one.values)
        axes.hist(
            values, bins=_bins(values), density=True, color=LIGHT, edgecolor=GREY, linewidth=0.4
        )
        if one.standard_error:
            reach = max(4 * one.standard_error, float(np.max(np.abs(values - one.value))))
            over = np.linspace(one.value - reach, one.value + reach, 200)
            density = norm.pdf(over, one.value, one.standard_error)
            axes.plot(over, density, color=BLUE, linewidth=1.3, label="standard error")
        axes.axvline(one.value, color=BLUE, linewidth=1, linestyle="--", label="result")
        if one.percentile is not None:
            low, high = one.percentile
            at = -0.04 * axes.get_ylim()[1]
            axes.plot(
                [low, high], [at, at], color=VERMILLION, linewidth=3, label="95 % of the estimates"
            )
        plain(axes, path)
        axes.set_xlabel(one.unit)
        axes.set_yticks([])
        axes.spines["left"].set_visible(False)
        axes.locator_params(axis="x", nbins=5)
    if drawn:
        figure.axes[0].legend(fontsize=7, frameon=False, labelcolor=INK)
    return figure


def _with_error(value: float | None, error: float | None, sign: str = "") -> str:
    return "-" if value is None or error is None else f"{value:{sign}.2f} +- {error:.2f}"


def _ends(one: Repeated, ends: tuple[float, float] | None) -> str:
    if ends is None:
        return "-"
    low, high = (format_estimate(end, one.standard_error or one.spread)[0] for end in ends)
    return f"{low} .. {high}"


def _coverage(one: Repeated) -> str:
    if one.coverage is None or one.coverage_interval is None:
        return "-"
    low, high = one.coverage_interval
    return f"{100 * one.coverage:.1f} % ({100 * low:.1f} .. {100 * high:.1f})"


def _bootstrap_section(found: Bootstrap, result: FitResult, folder: Path) -> PageSection:
    first, *others = bootstrap_summary(found)
    return PageSection(
        id="repetitions",
        name="Repetitions",
        heading="Repetitions of the fit",
        intro=f"{first}.",
        table=Table.of_parameters(*bootstrap_table(found)),
        sentences=others,
        plots=[(path, _histogram(one)) for path, one in _drawn(found, _MOST_ON_PAGE)],
        note="Bars: estimates of the repetitions. Dashed line: the result from which their data "
        "were simulated. Red: interval that contains 95 % of the estimates.",
    )


def _bins(values: np.ndarray) -> int:
    return int(np.clip(np.sqrt(len(values)) * 1.5, 8, 40))


def _histogram(one: Repeated) -> str:
    from bokeh.models import Span

    values = np.asarray(one.values)
    counts, edges = np.histogram(values, bins=_bins(values))
    plot: Any = new_plot(180, one.unit or "value", "repetitions")
    bars = plot.quad(
        top=counts, bottom=0, left=edges[:-1], right=edges[1:], fill_color=LIGHT, line_color=BLUE
    )
    for end in one.percentile or ():
        plot.add_layout(Span(location=end, dimension="height", line_color=VERMILLION))
    plot.add_layout(
        Span(location=one.value, dimension="height", line_color=BLUE, line_dash="dashed")
    )
    tips = [("from", "@left"), ("to", "@right"), ("repetitions", "@top")]
    return embedded(plot, bars, tips)


RecordView(
    place=1,
    record=Bootstrap,
    table=lambda found, result, most: Table.of_parameters(*bootstrap_table(found)),
    sentences=lambda found, most: bootstrap_summary(found),
    figure=lambda found, result: bootstrap_figure(found),
    section=_bootstrap_section,
)


# A longer list should be read in the file.
_MOST_PARTS = 30
_MOST_COLUMNS = 12  # with more columns, numbers are not legible


def influence_table(found: Influence, most: int | None = None) -> tuple[list[str], list[list[str]]]:
    """Return headings and a row for each part, the largest shift first.

    Below each parameter is its shift in units of the standard error and, in brackets, its error
    without the part in the same unit.
    """
    paths = _columns(found)
    headings = ["part left out", "kind", "cells", "method", "shift / expected", *paths]
    return headings, [
        [
            *(part.name, part.kind, str(part.cells), "step" if part.exact is None else "fit"),
            format_number(part.surprise, ".1f"),
            *(_cell(part, path) for path in paths),
        ]
        for part in found.parts[:most]
    ]


def influence_summary(found: Influence) -> list[str]:
    """Return sentences for the table: its meaning, failures, and omissions."""
    sentences = [
        "shift of each parameter when the part is left out, in units of the parameter's standard "
        "error; in brackets, the standard error without the part, in the same units; a part "
        "contradicts the others if shift / expected exceeds 3"
    ]
    lost = [part for part in found.parts if None in part.steps.values()]
    for path in found.parameters:
        names = [part.name for part in lost if part.steps.get(path, 0.0) is None]
        if names:
            sentences.append(f"{path} is not determined without {', '.join(names)}")
    sentences += [
        f"the fit without {part.name} did not converge ({part.reason})"
        for part in found.parts
        if part.reason
    ]
    return [*sentences, *found.notes]


_INFLUENCE_CAPTION = (
    "Rows: parts of the data (runs, markers, channels or spans of time) that were left out, the "
    "part with the largest shift first. Columns: parameters. Each number is the estimate without "
    "the part minus the estimate with all data, divided by the standard error with all data. It "
    "is computed from a new fit, or to first order from the derivatives. Red: the estimate "
    "increases without the part. Blue: it decreases. Empty cells: parameters of an omitted run."
)


def influence_figure(found: Influence, title: str = "") -> Figure:
    """Plot the shifts as a map: parts by parameters, the largest shift first."""
    parts, paths = found.parts[:_MOST_PARTS], _columns(found)[:_MOST_COLUMNS]
    title = title or (
        "Parameter shifts without each part of the data, in units of the standard error"
    )
    wide, high = 3.2 + 1.2 * max(len(paths), 2), 1.8 + 0.26 * len(parts)
    figure = new_figure(wide, high, title, _INFLUENCE_CAPTION)
    axes = figure.add_subplot()
    shifts = np.asarray(
        [[part.shifts.get(path, 0.0) for path in paths] for part in parts], dtype=float
    ).reshape(len(parts), len(paths))
    if np.isnan(shifts).any():
        figure.caption += (
            " Grey cells (lost): without the part, the data do not determine the parameter."
        )
    known = np.abs(shifts[np.isfinite(shifts)])
    reach = max(float(np.max(known, initial=0.0)), 1e-3)
    image = axes.imshow(shifts, cmap="RdBu_r", vmin=-reach, vmax=reach, aspect="auto")
    plain(axes)
    axes.grid(False)
    axes.set_facecolor("#CFCFCF")
    for (row, column), shift in np.ndenumerate(shifts):
        strong = np.isfinite(shift) and abs(shift) > 0.6 * reach
        text = f"{shift:+.2f}" if np.isfinite(shift) else "lost"
        # The parameters of a run have no shift without that run.
        text = text if paths[column] in parts[row].shifts else ""
        colour = "white" if strong else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=7, color=colour)
    axes.set_yticks(range(len(parts)), [f"{part.kind} {part.name}" for part in parts])
    axes.set_xticks(range(len(paths)), [path.replace(".", ".\n", 1) for path in paths])
    axes.xaxis.tick_top()
    plain_colorbar(axes, image, pad=0.02)
    if len(found.parts) > len(parts):
        axes.set_xlabel(
            f"{len(found.parts) - len(parts)} more parts have less influence", color=GREY
        )
    return figure


def _columns(found: Influence) -> list[str]:
    """Return the shared parameters, or without any those of single runs, which are too many."""
    shared = [label for label in found.parameters if " of '" not in label]
    return shared or list(found.parameters)


def _cell(part: LeftOut, path: str) -> str:
    if path not in part.shifts:  # a parameter of this part, which is left out with it
        return ""
    shift = part.shifts[path]
    wider = (part.widening if part.exact_widening is None else part.exact_widening)[path]
    if shift is None:
        return "lost" if part.steps[path] is None else "-"
    return f"{shift:+.2f}" + ("" if wider is None else f" ({wider:.2f})")


def _influence_sentences(found: Influence, most: int | None) -> list[str]:
    more = 0 if most is None else len(found.parts) - most
    left_out = [f"and {more} more with less influence (--rows)"] if more > 0 else []
    return left_out + influence_summary(found)


RecordView(
    place=2,
    record=Influence,
    table=lambda found, result, most: Table(*influence_table(found, most), 2),
    sentences=_influence_sentences,
    figure=lambda found, result: influence_figure(found),
    section=lambda found, result, folder: PageSection(
        id="influence",
        name="Influence",
        heading="Influence of each part of the data",
        table=Table(*influence_table(found), 2),
        folded="parts of the data",
        sentences=influence_summary(found),
    ),
)
