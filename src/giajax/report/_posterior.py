"""A posterior as a table and as files."""

import io
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, column_factors, in_column_units
from ..runs import Run, unique_names
from ..study import Band, Marginal, Posterior, PosteriorSummary
from ._abscissa import sample_times
from ._csv import to_csv
from ._posterior_figures import bands_figure, corner_figure
from ._style import to_png

POSTERIOR_HEADINGS = [
    *("parameter", "unit", "mean", "deviation", "95 % interval", "linear interval"),
    *("R-hat", "ESS bulk", "ESS tail"),
]

# What a posterior is kept in, beside a file of draws whose format is that of what is installed.
POSTERIOR, CORNER, BANDS, TABLE = (
    *("posterior.json", "posterior.png", "posterior_bands.png", "posterior_bands.csv"),
)
DRAWS = ("posterior.nc", "posterior.npz")
POSTERIOR_FILES = (POSTERIOR, CORNER, BANDS, TABLE, *DRAWS)


def posterior_rows(summary: PosteriorSummary, result: FitResult) -> list[list[str]]:
    """A row of text for each parameter, under `POSTERIOR_HEADINGS`, in the columns' units.

    Arguments:
        summary: of the posterior.
        result: of the fit that it is of.
    """
    return [_row(label, one) for label, one in in_units_of(summary, result).items()]


def in_units_of(summary: PosteriorSummary, result: FitResult) -> dict[str, Marginal]:
    """What is known of each parameter, in the columns' units."""
    factors = column_factors(result.model)
    units = {path: one.unit for path, one in in_column_units(result.free, result.model).items()}
    found = {}
    for label, one in summary.parameters.items():
        path = label.partition(" of ")[0]
        factor = factors.get(path.partition("[")[0], 1.0)
        found[label] = one.times(factor, units.get(path, one.unit))
    return found


def _row(label: str, one: Marginal) -> list[str]:
    digits = _digits(one)
    return [
        label,
        one.unit or "-",
        f"{one.mean:.{digits}g}",
        f"{one.deviation:.2g}",
        _ends(one.interval, digits),
        "-" if one.linear is None else _ends(one.linear, digits),
        "-" if one.r_hat is None else f"{one.r_hat:.3f}",
        "-" if one.ess_bulk is None else f"{one.ess_bulk:.0f}",
        "-" if one.ess_tail is None else f"{one.ess_tail:.0f}",
    ]


def _digits(one: Marginal) -> int:
    """As many as tell the ends of the interval apart."""
    size = max(map(abs, one.interval))
    width = one.interval[1] - one.interval[0]
    return int(np.clip(np.ceil(np.log10(size / width)) + 3, 3, 12)) if width > 0 else 6


def _ends(ends: tuple[float, float], digits: int) -> str:
    return f"{ends[0]:.{digits}g} .. {ends[1]:.{digits}g}"


def posterior_files(found: Posterior, result: FitResult, runs: Sequence[Run]) -> dict[str, bytes]:
    """A posterior as files: contents by name.

    `posterior.json` is the summary; `posterior.nc` has the draws, as ArviZ reads them, or without
    ArviZ `posterior.npz`; `posterior.png` shows pairs of parameters, and `posterior_bands.csv` and
    `.png` where each channel is predicted to be.

    Arguments:
        found: the posterior.
        result: of the fit that it is of.
        runs: what was fitted, in their order.
    """
    names = unique_names(runs)
    name, draws = draws_file(found)
    return {
        POSTERIOR: found.summary.to_json().encode(),
        name: draws,
        TABLE: bands_table(runs, names, found.bands),
        CORNER: to_png(corner_figure(found, result)),
        BANDS: to_png(bands_figure(runs, found.bands, result)),
    }


def draws_file(found: Posterior) -> tuple[str, bytes]:
    """Name and content of a file of the draws: ArviZ's, or NumPy's where that is not installed."""
    try:
        tree = found.to_arviz()
    except InputError:
        buffer = io.BytesIO()
        np.savez_compressed(
            buffer,
            parameters=np.array(found.labels),
            samples=found.samples,
            lp=-found.energy,
            diverging=found.diverging,
        )
        return DRAWS[1], buffer.getvalue()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / DRAWS[0]
        tree.to_netcdf(str(path))
        return DRAWS[0], path.read_bytes()


def bands_table(
    runs: Sequence[Run], names: Sequence[str], bands: Sequence[Mapping[str, Band]]
) -> bytes:
    """Where each channel is predicted to be, a row for each run, channel and sample, as CSV.

    Arguments:
        runs: what was fitted.
        names: of the runs, each another one.
        bands: of each run, by channel.
    """
    words = ("run", "channel", "unit")
    numbers = ("time_s", "recorded", "median", "low", "high", "low_with_noise", "high_with_noise")
    columns: dict[str, list[object]] = {name: [] for name in (*words, *numbers)}
    for run, name, by_channel in zip(runs, names, bands, strict=True):
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
