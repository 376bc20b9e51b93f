"""Figure and JSON text of a fitted wind."""

import dataclasses
import json
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ...recordings import Channel, Run
from ...report import BLUE, GREY, new_figure, plain
from ._fit import WindFit

# Largest number of channels in a figure; more panels would be too small to read.
_MOST = 9
_ACROSS = 3

_CAPTION = (
    "One-sided power spectral densities of the recorded channels of the arm. Grey dots: measured "
    "spectra, averaged over five sine tapers in frequency bands that do not overlap. Blue lines: "
    "spectra of the fitted model, averaged in the same way. The spectra of the model are those of "
    "the response of the linearised arm to the gusts, plus those of the noise."
)


def wind_figure(found: WindFit, title: str = "") -> Figure:
    """Plot the measured and fitted spectra of the channels that move most, at most nine."""
    moves = np.sum(found.fitted, axis=0)
    drawn = np.sort(np.argsort(-moves, kind="stable")[:_MOST])
    across = min(_ACROSS, len(drawn))
    down = -(-len(drawn) // across)
    some = len(drawn) < len(moves)
    caption = _CAPTION + (" The channels that move most are shown." if some else "")
    title = title or "Spectra at rest in a wind"
    figure = new_figure(3.4 * across + 0.4, 2.4 * down + 0.5, title, caption)
    for place, index in enumerate(drawn):
        axes = figure.add_subplot(down, across, place + 1)
        measured, fitted = found.measured[:, index], found.fitted[:, index]
        axes.loglog(found.frequencies, measured, ".", color=GREY, ms=3, label="measured")
        axes.loglog(found.frequencies, fitted, color=BLUE, label="fitted")
        unit = Channel.named(found.channels[index]).si_unit
        # The unit of a rate is a fraction, which needs brackets.
        density = f"({unit})$^2$/Hz" if "/" in unit else f"{unit}$^2$/Hz"
        plain(axes, found.channels[index], "frequency (Hz)", density)
        axes.tick_params(which="both", labelsize=8)
        if place == 0:
            axes.legend(fontsize=8, frameon=False)
    return figure


def wind_json(found: WindFit, run: Run) -> str:
    """Return a fitted wind without its spectra, and its run, as JSON text."""
    facts: dict[str, Any] = {
        "run": run.name,
        "sha256": run.sha256,
        "numbers": {name: dataclasses.asdict(one) for name, one in found.numbers.items()},
        "mean_m_per_s": found.wind.mean.tolist(),
        "free": list(found.free),
        "correlation": found.correlation.tolist(),
        "converged": found.converged,
        "log_likelihood": found.log_likelihood,
        "misfit": {"value": found.misfit[0], "standard_error": found.misfit[1]},
        "channels": list(found.channels),
        "left_out": list(found.left_out),
        "highest_frequency_Hz": float(found.frequencies[-1]),
        "swing_rad": found.swing,
        "means": _means(found),
        "notes": list(found.notes),
    }
    return json.dumps(facts, indent=2, allow_nan=False)


def _means(found: WindFit) -> dict[str, dict[str, float]] | None:
    if np.isnan(found.means).any():
        return None
    names = ("recorded", "fitted", "standard_error")
    return {
        channel: dict(zip(names, map(float, column), strict=True))
        for channel, column in zip(found.channels, found.means.T, strict=True)
    }
