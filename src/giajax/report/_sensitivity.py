"""Plots and tables of sensitivities: versus time, and the information in each body."""

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from ..recordings import Channel
from ..studies import Sensitivity
from ._style import BLUE, GREY, columns_of, new_figure, plain, plain_colorbar, to_csv

_MOST_NAMES = 25  # more names next to a map are not legible

_CAPTION = (
    "Each row shows one parameter, whose value is stated above the map. Left: share of each body "
    "or channel in the Fisher information on this parameter alone, for white noise. Right: norm "
    "of the derivative of the position of each body, or absolute value of the derivative of each "
    "other channel, with respect to the parameter, versus time or sample; the rows are in the "
    "order of the left panel, and each map has its own scale. The expected standard error is the "
    "Cramer-Rao bound for a fit of all these parameters to all channels."
)


def sensitivity_figure(sensitivity: Sensitivity, noise: npt.ArrayLike, title: str = "") -> Figure:
    """Plot the sensitivity of each body to each parameter versus time, and its information.

    `noise` is the standard deviation of white noise, SI: one number, or one for each channel.
    """
    names, sizes = sensitivity.lengths()
    shares = information_shares(sensitivity, noise)
    errors = sensitivity.standard_errors(noise)
    rows = len(sensitivity.parameters)
    tall = float(np.clip(0.14 * len(names) + 1.2, 2.2, 5.0))
    title = title or "Sensitivity of positions to parameters"
    figure = new_figure(10, rows * tall + 0.5, title, _CAPTION)
    grid = figure.add_gridspec(rows, 2, width_ratios=[1, 3.4])
    counted = np.arange(sizes.shape[1], dtype=float)
    times = counted if sensitivity.times is None else sensitivity.times
    units = {Channel.named(name).si_unit for name in sensitivity.channels}
    of = units.pop() or "1" if len(units) == 1 else "SI"
    places = np.arange(len(names))
    every = -(-len(names) // _MOST_NAMES)
    for row, path in enumerate(sensitivity.parameters):
        unit, value = sensitivity.units[row], sensitivity.values[row]
        side = figure.add_subplot(grid[row, 0])
        side.barh(places, 100 * shares[:, row], color=BLUE, height=0.75)
        plain(side, "Share of the information", "share (%)")
        side.grid(False, axis="y")
        side.set_yticks(places[::every], names[::every])
        if not shares[:, row].any():
            side.text(0.5, 0.5, "none", transform=side.transAxes, color=GREY, ha="center")
        axes = figure.add_subplot(grid[row, 1], sharey=side)
        image = axes.pcolormesh(
            times, places, sizes[row].T, shading="nearest", cmap="cividis", rasterized=True
        )
        stated = f"{path} = {value:.4g} {unit}".rstrip()
        error = f"expected standard error {_error(errors[row], unit)}"
        across = "time (s)" if sensitivity.times is not None else "sample"
        plain(axes, f"{stated}; {error}", across)
        axes.grid(False)
        axes.tick_params(labelleft=False, left=False)
        bar = plain_colorbar(axes, image, pad=0.01)
        per = f"{of} per {unit}" if unit else of
        bar.set_label(f"change of position per change of parameter ({per})", fontsize=8)
    return figure


def information_shares(sensitivity: Sensitivity, noise: npt.ArrayLike) -> np.ndarray:
    """Return the fraction of the information on each parameter that each body provides.

    `noise` is the standard deviation of white noise, SI: one number, or one for each channel.
    Fractions are from 0 to 1, of shape (body, parameter).
    """
    alone = np.diagonal(sensitivity.information(noise), axis1=1, axis2=2)
    total = alone.sum(axis=0)
    return np.divide(alone, total, out=np.zeros_like(alone), where=total > 0)


def sensitivity_files(sensitivity: Sensitivity, noise: npt.ArrayLike) -> dict[str, str]:
    """Return `sensitivity.csv` (derivatives versus time) and `information.csv` (by body) as text.

    `noise` is the standard deviation of white noise, SI: one number, or one for each channel.
    """
    parameters = list(zip(sensitivity.parameters, sensitivity.units, strict=True))
    units = [Channel.named(name).si_unit for name in sensitivity.channels]
    columns = [f"{n} ({u})" if u else n for n, u in zip(sensitivity.channels, units, strict=True)]
    times = [""] * len(sensitivity.predicted)
    if sensitivity.times is not None:
        times = [f"{time:.9g}" for time in sensitivity.times]
    over_time = [
        [*about, time, *(f"{value:.8g}" for value in row)]
        for about, table in zip(parameters, sensitivity.derivatives, strict=True)
        for time, row in zip(times, table, strict=True)
    ]
    shares, alone = information_shares(sensitivity, noise), sensitivity.errors_by_body(noise)
    by_body: list[list[str]] = []
    for column, about in enumerate(parameters):
        for row, name in enumerate(sensitivity.bodies()):
            share = f"{100 * shares[row, column]:.6g}"
            by_body.append([*about, name, share, _finite(alone[row, column])])
        together = sensitivity.standard_errors(noise)[column]
        by_body.append([*about, "all", "100", _finite(together)])
    headings = ["parameter", "unit", "body", "share_percent", "standard_error_alone"]
    tables = {
        "sensitivity.csv": columns_of(["parameter", "unit", "time_s", *columns], over_time),
        "information.csv": columns_of(headings, by_body),
    }
    return {name: to_csv(table).decode() for name, table in tables.items()}


def _finite(value: float) -> str:
    return f"{value:.6g}" if np.isfinite(value) else ""


def _error(error: float, unit: str) -> str:
    return f"{error:.2g} {unit}".strip() if np.isfinite(error) else "infinite"
