"""The 1-link experiment as files."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...models import OscillatorModel
from ...recordings import Run, check_output_folder, make_folder, write_files, write_run
from ...report import (
    BLUE,
    GREEN,
    GREY,
    INK,
    VERMILLION,
    columns_of,
    new_figure,
    plain,
    to_csv,
    to_png,
)
from ...schema.parameters import get
from ..synthetic import synthesise
from ._one_link import OneLink, Trial

# Title and colour by compensation.
_COLUMNS = {
    "none": ("without compensation", VERMILLION),
    "branches": ("eq. (12)", BLUE),
    "inverse": ("inverse of the modified Prandtl-Ishlinskii form", GREEN),
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
                axes.set_title(_COLUMNS[compensation][0], fontsize=9, loc="left", color=INK)
    return figure


def _draw(axes: Axes, trial: Trial) -> None:
    ends = np.asarray([-65.0, 65.0])
    axes.plot(ends, ends, color=GREY, linewidth=0.8, linestyle=(0, (4, 3)))
    measured, colour = trial.history.measured, _COLUMNS[trial.compensation][1]
    small: Any = {"linewidth": 0.9, "marker": "o", "markersize": 1.8, "markeredgewidth": 0}
    axes.plot(trial.history.target[measured], trial.angles[measured], color=colour, **small)
    plain(axes)
    axes.set_xlim(*ends)
    axes.set_ylim(-70, 70)
    axes.set_xticks(range(-60, 61, 20))
    axes.set_yticks(range(-60, 61, 20))
    errors = f"error: mean {trial.mean:.1f}, largest {trial.largest:.1f} deg"
    axes.text(0.03, 0.97, errors, transform=axes.transAxes, fontsize=8, color=INK, va="top")


ONE_LINK_FILES = (
    *("fig12.png", "fig12.csv", "errors.csv", "result.json"),
    *("recording.csv", "recording.toml"),
)
"""What the 1-link experiment writes."""

_ERRORS = ("history", "compensation", "mean_error_deg", "largest_error_deg")
_TABLE = ("history", "compensation", "time_s", "target_deg", "command_deg", "angle_deg")


def write_one_link(study: OneLink, folder: Path, *, force: bool = False) -> list[Path]:
    """Write the picture, its numbers, the errors, the recording and the fit; the paths of them."""
    check_output_folder(folder, ONE_LINK_FILES, force=force)
    make_folder(folder)
    errors = [
        (trial.history.name, trial.compensation, f"{trial.mean:.4f}", f"{trial.largest:.4f}")
        for trial in study.trials
    ]
    contents = {
        folder / "fig12.png": to_png(figure_12(study)),
        folder / "fig12.csv": to_csv(one_link_table(study)),
        folder / "errors.csv": to_csv(columns_of(_ERRORS, errors)),
        folder / "result.json": study.result.to_json().encode(),
    }
    write_files(contents, force=force)
    run = study.recording
    recording = folder / "recording.csv"
    write_run(recording, run.times, run.values, definition=run.definition, force=force, digits=7)
    return [*contents, recording, recording.with_suffix(".toml")]


def one_link_table(study: OneLink) -> dict[str, list[str]]:
    """Every sample of every trial, the numbers of fig. 12; an empty cell was not measured."""
    rows = []
    for trial in study.trials:
        plan = trial.history
        for time, target, command, angle in zip(
            plan.times, plan.target, trial.commands, trial.angles, strict=True
        ):
            seen = "" if np.isnan(angle) else f"{angle:.4f}"
            cells = (f"{time:g}", f"{target:g}", f"{command:.4f}", seen)
            rows.append((plan.name, trial.compensation, *cells))
    return columns_of(_TABLE, rows)


# The benchmark of a mass on a spring and damper with a Bouc-Wen element, generated here.
#
# Reference: J. P. Noel, M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity",
# Workshop on Nonlinear System Identification Benchmarks, Brussels 2016.

RATE = 750.0
SAMPLES = 8192
NOISE = 8e-6
_PATHS = ("mass", "damping", "stiffness", "alpha", "beta", "gamma", "delta")


@dataclass(frozen=True)
class BoucWenBenchmark:
    """Runs of the benchmark and what is behind them.

    Attributes:
        multisine: 5 to 150 Hz, 50 N RMS, 8192 samples at 750 Hz, 8e-3 mm RMS of noise.
        sweep: 20 to 50 Hz at 10 Hz a minute, 40 N, without noise.
        truth: parameters and determined products, SI.
    """

    multisine: Run
    sweep: Run
    truth: dict[str, float]


def bouc_wen_benchmark(seed: int = 0) -> BoucWenBenchmark:
    """Generate the benchmark; the phases of the multisine and the noise come from the seed.

    The force of the multisine is one period of a band-limited signal, that of the sweep is
    linear between its rows.
    """
    model = OscillatorModel(interpolation="band_limited").refined(1e-3)
    truth = {path: float(get(model, path)) for path in _PATHS}
    truth |= {name: float(derived.value) for name, derived in model.derived().items()}
    force = multisine(np.random.default_rng(seed))
    # To the digits of a file, so that a run that is read again is the same.
    times = np.round(np.arange(SAMPLES) / RATE, 9)
    recorded = synthesise(
        model,
        times,
        {"input": force},
        ["output"],
        noise={"output": NOISE},
        seed=seed,
        definition={"truth": truth},
        name="bouc_wen_multisine",
    )
    times, force = sweep()
    about: Any = {"definition": {"truth": truth}, "name": "bouc_wen_sweep"}
    model = OscillatorModel().refined(1e-3)
    swept = synthesise(model, times, {"input": force}, ["output"], **about)
    return BoucWenBenchmark(recorded, swept, truth)


def multisine(random: np.random.Generator) -> npt.NDArray[np.float64]:
    """One period of equal amplitudes and random phases, 5 to 150 Hz, 50 N RMS; N."""
    frequencies = np.arange(SAMPLES // 2 + 1) * RATE / SAMPLES
    excited = (frequencies >= 5) & (frequencies <= 150)
    phases = np.exp(2j * np.pi * random.uniform(size=len(frequencies)))
    force = np.fft.irfft(np.where(excited, phases, 0), SAMPLES)
    return np.asarray(50 * force / np.sqrt(np.mean(force**2)))


def sweep() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Times (s) and force (N) of a sine of 40 N from 20 to 50 Hz, 10 Hz a minute."""
    growth = 10 / 60
    times = np.arange(0, 30 / growth, 1 / RATE)
    return times, 40 * np.sin(2 * np.pi * (20 + growth / 2 * times) * times)


def decibels(rms: float) -> float:
    """An RMS error (m) as the literature on the benchmark states it: 20 log10 of it."""
    return float(20 * np.log10(rms))
