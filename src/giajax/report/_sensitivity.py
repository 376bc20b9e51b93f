"""Sensitivities as pictures and tables: over time, and the information in each body."""

import csv
import io

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from ..recordings import Channel
from ..studies import Sensitivity
from ._style import BLUE, GREY, INK, new_figure, plain

# More names than this beside a map cannot be read.
_MOST_NAMES = 25


def sensitivity_figure(sensitivity: Sensitivity, noise: npt.ArrayLike, title: str = "") -> Figure:
    """How far each body moves with each parameter over time, and its share of the information.

    Arguments:
        sensitivity: of the positions to the parameters.
        noise: standard deviation of white noise, SI: one number, or one per channel.
        title: of the whole.

    Returns:
        The picture.
    """
    names, sizes = sensitivity.lengths()
    shares = information_shares(sensitivity, noise)
    errors = sensitivity.standard_errors(noise)
    rows = len(sensitivity.parameters)
    tall = float(np.clip(0.14 * len(names) + 1.2, 2.2, 5.0))
    figure = new_figure(10, rows * tall + 0.5, title or "Sensitivity of positions to parameters")
    grid = figure.add_gridspec(rows, 2, width_ratios=[3, 1])
    times = (
        np.arange(sizes.shape[1], dtype=float) if sensitivity.times is None else sensitivity.times
    )
    places = np.arange(len(names))
    every = -(-len(names) // _MOST_NAMES)
    for row, path in enumerate(sensitivity.parameters):
        axes = figure.add_subplot(grid[row, 0])
        unit = sensitivity.units[row]
        image = axes.pcolormesh(
            times, places, sizes[row].T, shading="nearest", cmap="cividis", rasterized=True
        )
        plain(axes, f"{path} = {_value(sensitivity, row)}")
        axes.grid(False)
        axes.set_yticks(places[::every], names[::every])
        axes.set_xlabel("time (s)" if sensitivity.times is not None else "sample")
        bar = figure.colorbar(image, ax=axes, pad=0.01)
        of = _quantity_unit(sensitivity)
        bar.set_label(f"|d position / d parameter| ({of} per {unit or '1'})", fontsize=8)
        bar.ax.tick_params(labelsize=8, length=0, labelcolor=INK)
        bar.outline.set_visible(False)
        side = figure.add_subplot(grid[row, 1], sharey=axes)
        side.barh(places, 100 * shares[:, row], color=BLUE, height=0.75)
        plain(side, f"expected error {_error(errors[row], unit)}")
        side.grid(False, axis="y")
        side.tick_params(labelleft=False)
        side.set_xlabel("share of the information (%)")
        if not shares[:, row].any():
            side.text(0.5, 0.5, "none", transform=side.transAxes, color=GREY, ha="center")
    return figure


def information_shares(sensitivity: Sensitivity, noise: npt.ArrayLike) -> np.ndarray:
    """Part of the information about each parameter that each body carries.

    Arguments:
        sensitivity: of the positions to the parameters.
        noise: standard deviation of white noise, SI: one number, or one per channel.

    Returns:
        Shares from 0 to 1, shape (body, parameter).
    """
    alone = np.diagonal(sensitivity.information(noise), axis1=1, axis2=2)
    total = alone.sum(axis=0)
    return np.divide(alone, total, out=np.zeros_like(alone), where=total > 0)


def sensitivity_files(sensitivity: Sensitivity, noise: npt.ArrayLike) -> dict[str, str]:
    """`sensitivity.csv`, derivatives over time, and `information.csv`, by body; as text.

    Arguments:
        sensitivity: of the positions to the parameters.
        noise: standard deviation of white noise, SI: one number, or one per channel.

    Returns:
        Contents by name of the file.
    """
    over_time = io.StringIO()
    writer = csv.writer(over_time, lineterminator="\n")
    units = [Channel.named(name).si_unit for name in sensitivity.channels]
    columns = [f"{n} ({u})" if u else n for n, u in zip(sensitivity.channels, units, strict=True)]
    writer.writerow(["parameter", "unit", "time_s", *columns])
    times = [""] * len(sensitivity.predicted) if sensitivity.times is None else sensitivity.times
    for path, unit, table in zip(
        sensitivity.parameters, sensitivity.units, sensitivity.derivatives, strict=True
    ):
        for time, row in zip(times, table, strict=True):
            shown = f"{time:.9g}" if time != "" else ""
            writer.writerow([path, unit, shown, *(f"{value:.8g}" for value in row)])
    by_body = io.StringIO()
    writer = csv.writer(by_body, lineterminator="\n")
    writer.writerow(["parameter", "unit", "body", "share_percent", "standard_error_alone"])
    shares, alone = information_shares(sensitivity, noise), sensitivity.errors_by_body(noise)
    together = sensitivity.standard_errors(noise)
    for column, (path, unit) in enumerate(
        zip(sensitivity.parameters, sensitivity.units, strict=True)
    ):
        for row, name in enumerate(sensitivity.bodies()):
            share = 100 * shares[row, column]
            writer.writerow([path, unit, name, f"{share:.6g}", _finite(alone[row, column])])
        writer.writerow([path, unit, "all", "100", _finite(together[column])])
    return {"sensitivity.csv": over_time.getvalue(), "information.csv": by_body.getvalue()}


def _finite(value: float) -> str:
    return f"{value:.6g}" if np.isfinite(value) else ""


def _value(sensitivity: Sensitivity, row: int) -> str:
    return f"{sensitivity.values[row]:.4g} {sensitivity.units[row]}".strip()


def _error(error: float, unit: str) -> str:
    return f"{error:.2g} {unit}".strip() if np.isfinite(error) else "infinite"


def _quantity_unit(sensitivity: Sensitivity) -> str:
    units = {Channel.named(name).si_unit for name in sensitivity.channels}
    return units.pop() or "1" if len(units) == 1 else "SI"
