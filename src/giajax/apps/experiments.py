"""Simulated experiments without a public recording: one link, and a Bouc-Wen benchmark."""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..fitting import FitResult, fit
from ..mechanics.hysteresis import BoucWen, Preisach
from ..models import OscillatorModel, model_for
from ..recordings import Run, check_output_folder, make_folder, write_files, write_run
from ..report import (
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
from ..schema.parameters import get
from .control import compensator_for_loop, compensator_for_model
from .synthetic import synthesise

_Degrees = npt.NDArray[np.float64]

# Commands within this angle are held longer.
_SLOW = 30.0
_SLOW_SECONDS, _SECONDS = 20.0, 5.0

_OTHER = (0, 45, -35, 30, -20, 50, 10, 40, -10, 20, -50, -5, -30, 15, 0)
# Turning points of the paper's history, and of its preparatory movement, deg.
_PAPER = (0, 60, -60, 0)


@dataclass(frozen=True)
class History:
    """Target angles in steps of one degree, and the times at which the joint is at rest, s.

    Attributes:
        measured: which samples are measured, those after the preparatory movement.
    """

    name: str
    times: npt.NDArray[np.float64]
    target: _Degrees
    measured: npt.NDArray[np.bool_]


def history(name: str, turns: Sequence[float]) -> History:
    """Return the paper's preparatory movement, then steps of 1 deg between turning points (deg).

    A step takes 5 s, or 20 s if the command is within 30 deg of 0.
    """
    before = _steps(_PAPER)
    target = np.concatenate([before, _steps(turns)[1:]])
    held = np.where(np.abs(target) <= _SLOW, _SLOW_SECONDS, _SECONDS)
    return History(name, np.cumsum(held), target, np.arange(len(target)) >= len(before) - 1)


def _steps(turns: Sequence[float]) -> _Degrees:
    pieces = [np.linspace(a, b, round(abs(b - a)) + 1)[1:] for a, b in itertools.pairwise(turns)]
    return np.concatenate([[turns[0]], *pieces]).astype(float)


def paper_history() -> History:
    """Return the history 0, 60, -60, 0 deg, after the same movement as preparation."""
    return history("paper", _PAPER)


def other_history() -> History:
    """Return a history of other amplitudes and minor loops, not used for identification."""
    return history("other", _OTHER)


# A simulated 1-link arm that stands in for the paper's prototype of section IV.A.
#
# It contains other elements than the models that are fitted to it: Preisach hysteresis of the film,
# Bouc-Wen hysteresis of the muscles, and a joint that snaps through near 0 deg.

_RANGE = 60.0


@dataclass(frozen=True)
class SimulatedJoint:
    """Angle of a joint as a function of its command, both in degrees, at rest after each step.

    The command passes the hysteresis of film and muscles, which gives a drive x. The angle is
    x + gap exp(-x / decay) on the positive side, and the mirror image on the negative side. Within
    the gap about 0 the stiffness is negative and the joint cannot rest: it snaps through when the
    drive exceeds `snap`. It is therefore soft near 0, and follows the command at larger angles.

    Attributes:
        gap: angles on the positive and the negative side within which the joint cannot rest, deg.
        decay, snap: drives, deg.
        film: share of the film in the drive. The half-width (deg), spread and centre spread (deg)
            of its Preisach density are `film_width`, `film_spread` and `film_scatter`.
        muscle: share of the hysteresis of the muscles in the drive.
        muscle_travel: change of the command (deg) within which a muscle changes its branch.
        pressure_noise: standard deviation of the drive from step to step, deg.
        inclination: inclination of the camera, added to every measured angle, deg.
        marker_noise, marker_distance: standard deviation of the position of a marker, and distance
            between the two markers, m.
    """

    gap: tuple[float, float] = (12.6, 12.3)
    decay: float = 30.0
    snap: float = 0.3
    film: float = 0.95
    film_width: float = 14.0
    film_spread: float = 0.6
    film_scatter: float = 40.0
    muscle: float = 0.04
    muscle_travel: float = 8.0
    pressure_noise: float = 0.05
    inclination: float = 1.5
    marker_noise: float = 0.001
    marker_distance: float = 0.4
    seed: int = 0

    def drive(self, commands: npt.ArrayLike) -> _Degrees:
        """Return the command after the hysteresis of film and muscles, deg, shape (sample,)."""
        u = jnp.asarray(np.asarray(commands, dtype=float) / _RANGE)
        film = Preisach(
            slope=jnp.asarray(0.0),
            saturation=jnp.asarray(1.0),
            coercivity=jnp.asarray(self.film_width / _RANGE),
            coercivity_spread=jnp.asarray(self.film_spread),
            bias=jnp.asarray(0.0),
            interaction=jnp.asarray(self.film_scatter / _RANGE),
            extent=1.1,
            rows=60,
        )
        rate = _RANGE / self.muscle_travel
        muscle = BoucWen(
            elastic=jnp.asarray(0.0),
            alpha=jnp.asarray(rate),
            beta=jnp.asarray(rate),
            gamma=jnp.asarray(0.8),
            delta=jnp.asarray(0.2),
            nu=jnp.asarray(1.0),
        )
        elastic = 1 - self.film - self.muscle
        parts = self.film * film.history(u)[0] + self.muscle * muscle.history(u)[0]
        return _RANGE * np.asarray(elastic * u + parts)

    def rest_angles(self, drive: _Degrees) -> _Degrees:
        """Return the angles at which the joint rests, on its current side of the gap, deg."""
        settled, upper = [], bool(drive[0] >= 0)
        for x in drive:
            if abs(x) > self.snap:
                upper = bool(x > 0)
            side, gap = (1, self.gap[0]) if upper else (-1, self.gap[1])
            settled.append(float(side * (side * x + gap * np.exp(-side * x / self.decay))))
        return np.asarray(settled)

    def angles(self, commands: npt.ArrayLike, *, trial: int = 0) -> _Degrees:
        """Return the true angle after each step of a history of commands, deg, shape (sample,)."""
        drive = self.drive(commands)
        random = np.random.default_rng([self.seed, trial, 1])
        return self.rest_angles(drive + self.pressure_noise * random.standard_normal(len(drive)))

    def measured(self, commands: npt.ArrayLike, *, trial: int = 0) -> _Degrees:
        """Return the angle from two markers seen by an inclined camera, deg, with noise."""
        true = np.deg2rad(self.angles(commands, trial=trial) + self.inclination)
        random = np.random.default_rng([self.seed, trial, 2])
        ahead = self.marker_distance * np.stack([np.cos(true), np.sin(true)])
        one, other = (random.standard_normal(ahead.shape) for _ in range(2))
        seen = ahead + self.marker_noise * (one - other)
        return np.rad2deg(np.arctan2(seen[1], seen[0]))


# Nested and displaced loops: eq. (12) needs only one loop, but an operator with memory needs more.
_NESTED = (0, 50, -50, 40, -40, 30, -30, 20, -20, 10, -10, 0, 50, 20, 45, 10, -45, -15, -40, -5, 0)

# Change of the command over which xi changes from 0 to 1: the paper does not give it.
_TRAVEL = np.deg2rad(40.0)
_THRESHOLDS = 12
_DEAD_ZONES = tuple(float(value) for value in np.deg2rad([0.5, 1, 2, 4, 8, 16, 32, 48]))


@dataclass(frozen=True)
class Trial:
    """One history with one compensation.

    Attributes:
        compensation: "none", "branches" (eq. 12) or "inverse".
        commands: commanded angles, deg.
        angles: measured angles without the offset, deg; NaN during the preparation.
    """

    history: History
    compensation: str
    commands: _Degrees
    angles: _Degrees

    @property
    def errors(self) -> _Degrees:
        """Measured minus target angles where measured, deg."""
        return (self.angles - self.history.target)[self.history.measured]

    @property
    def largest(self) -> float:
        """Largest absolute error, deg."""
        return float(np.max(np.abs(self.errors)))

    @property
    def mean(self) -> float:
        """Mean absolute error, deg."""
        return float(np.mean(np.abs(self.errors)))


@dataclass(frozen=True)
class OneLink:
    """Result of the experiment.

    Attributes:
        trials: trials, by history and then by compensation.
        recording: recording used for identification.
        result: fit of the modified Prandtl-Ishlinskii operator.
        offset: offset of the camera, from the paper's history, deg.
    """

    trials: tuple[Trial, ...]
    recording: Run
    result: FitResult
    offset: float

    def trial(self, history: str, compensation: str) -> Trial:
        """Return the trial of a history and a compensation."""
        return next(
            trial
            for trial in self.trials
            if (trial.history.name, trial.compensation) == (history, compensation)
        )


def one_link(
    joint: SimulatedJoint | None = None,
    *,
    travel: float = _TRAVEL,
    progress: Callable[[str], None] | None = None,
) -> OneLink:
    """Run the experiment.

    On the paper's history the offset is removed as in the paper: for each trial the one that
    minimises the mean error. For the other history the camera has not moved, so the offset of the
    recording is used. The travel is that of eq. (12), rad. Ctrl-C ends the experiment.
    """
    joint = SimulatedJoint() if joint is None else joint
    say = progress or (lambda text: None)
    say("recording the joint")
    recording, offset = _record(joint)
    paper = paper_history()
    say("computing the branches of the loop (eq. (12))")
    on_paper = np.rad2deg(recording.values["angle"][: len(paper.target)])
    branches = compensator_for_loop(_run(paper, on_paper), travel)
    say("fitting the modified Prandtl-Ishlinskii operator")
    result = _identify(recording)
    if result.status == "interrupted":
        # Trials with an incompletely fitted operator would look like complete ones.
        raise KeyboardInterrupt
    inverse = compensator_for_model(result.model)
    trials, number = [], 0
    for plan in (paper, other_history()):
        for name, compensator in (("none", None), ("branches", branches), ("inverse", inverse)):
            say(f"simulating the {plan.name} history, compensation: {name}")
            number += 1
            commands = plan.target
            if compensator is not None:
                aimed = np.clip(np.deg2rad(plan.target), *compensator.reachable)
                # The joint takes no command outside its range.
                commands = np.clip(np.rad2deg(compensator.commands(aimed)), -_RANGE, _RANGE)
            seen = joint.measured(commands, trial=number)
            error = (seen - plan.target)[plan.measured]
            # The median minimises the mean absolute error.
            removed = float(np.median(error)) if plan is paper else offset
            shown = np.where(plan.measured, seen - removed, np.nan)
            trials.append(Trial(plan, name, commands, shown))
    return OneLink(tuple(trials), recording, result, offset)


def record_joint(joint: SimulatedJoint | None = None) -> Run:
    """Return the recording used for identification: the paper's history, then loops within it."""
    recording, _ = _record(SimulatedJoint() if joint is None else joint)
    return recording


def _record(joint: SimulatedJoint) -> tuple[Run, float]:
    plan, paper = history("identification", (*_PAPER, *_NESTED[1:])), paper_history()
    angles = joint.measured(plan.target)
    offset = float(np.median((angles[: len(paper.target)] - paper.target)[paper.measured]))
    return _run(plan, angles - offset), offset


def _identify(recording: Run) -> FitResult:
    """Fit the modified Prandtl-Ishlinskii operator to the recording of a joint."""
    # The operator only approximates the joint, and its inverse must be close to the joint. The
    # residuals are correlated model errors, not noise.
    return fit(
        model_for([recording]), recording, noise_model="white", check=False, max_iterations=150
    )


def _run(plan: History, angles: _Degrees) -> Run:
    seen = np.where(plan.measured, np.deg2rad(angles), np.nan)
    return Run.from_arrays(
        plan.times,
        {"command": np.deg2rad(plan.target), "angle": seen},
        name=plan.name,
        definition={
            "origin": "simulated 1-link arm (giajax hysteresis)",
            "hysteresis": {
                "operator": "modified_prandtl_ishlinskii",
                "thresholds": _THRESHOLDS,
                "upper_dead_zones": list(_DEAD_ZONES),
                "lower_dead_zones": list(_DEAD_ZONES),
            },
        },
    )


# Title and colour of each compensation.
_COLUMNS = {
    "none": ("without compensation", VERMILLION),
    "branches": ("eq. (12)", BLUE),
    "inverse": ("inverse of the modified Prandtl-Ishlinskii form", GREEN),
}
_HISTORIES = {"paper": "the paper's history", "other": "other amplitudes and minor loops"}


_CAPTION = (
    "Dots are measured angles after each step of the target angle, in the order of the connecting "
    "line. On the dashed grey line both angles are equal. Columns: without compensation "
    "(orange-red), with eq. (12) of the paper (blue), and with the inverse of a fitted operator "
    "(green). Upper row: the paper's history of target angles. From each trial, the offset that "
    "minimises its mean error is subtracted. Lower row: a history that was not used for "
    "identification, with the offset of the recording. Errors are absolute values."
)


def figure_12(study: OneLink) -> Figure:
    """Plot one row per history and one column per compensation."""
    histories = list(dict.fromkeys(trial.history.name for trial in study.trials))
    columns = list(dict.fromkeys(trial.compensation for trial in study.trials))
    title = "One link (simulated): measured angle versus target angle, offset removed"
    figure = new_figure(3.6 * len(columns), 3.4 * len(histories) + 0.5, title, _CAPTION)
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
"""Names of the files that the one-link experiment writes."""

_ERRORS = ("history", "compensation", "mean_error_deg", "largest_error_deg")
_TABLE = ("history", "compensation", "time_s", "target_deg", "command_deg", "angle_deg")


def write_one_link(study: OneLink, folder: Path, *, force: bool = False) -> list[Path]:
    """Write figure, table, errors, recording and fit, and return the paths of the files."""
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
    """Return every sample of every trial, as in fig. 12; cells that were not measured are empty."""
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


# The benchmark of a mass with spring, damper and Bouc-Wen element, generated here.
#
# Reference: J. P. Noel, M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity",
# Workshop on Nonlinear System Identification Benchmarks, Brussels 2016.

_RATE = 750.0
_SAMPLES = 8192
NOISE = 8e-6
_PATHS = ("mass", "damping", "stiffness", "alpha", "beta", "gamma", "delta")


@dataclass(frozen=True)
class BoucWenBenchmark:
    """Runs of the benchmark and their true parameters.

    Attributes:
        multisine: 5 to 150 Hz, 50 N RMS, 8192 samples at 750 Hz, noise of 8e-3 mm RMS.
        sweep: 20 to 50 Hz at 10 Hz per minute, 40 N, without noise.
        truth: parameters and identifiable products, SI.
    """

    multisine: Run
    sweep: Run
    truth: dict[str, float]


def bouc_wen_benchmark(seed: int = 0) -> BoucWenBenchmark:
    """Generate the benchmark; the seed determines the phases of the multisine and the noise.

    The force of the multisine is one period of a band-limited signal. The force of the sweep is
    linear between its rows.
    """
    model = OscillatorModel(interpolation="band_limited").refined(1e-3)
    truth = {path: float(get(model, path)) for path in _PATHS}
    truth |= {name: float(derived.value) for name, derived in model.derived().items()}
    force = multisine(np.random.default_rng(seed))
    # Round to the digits of a file, so that a run is the same after it is written and read.
    times = np.round(np.arange(_SAMPLES) / _RATE, 9)
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
    times, force = _sweep()
    about: Any = {"definition": {"truth": truth}, "name": "bouc_wen_sweep"}
    model = OscillatorModel().refined(1e-3)
    swept = synthesise(model, times, {"input": force}, ["output"], **about)
    return BoucWenBenchmark(recorded, swept, truth)


def multisine(random: np.random.Generator) -> npt.NDArray[np.float64]:
    """Return one period with equal amplitudes and random phases, 5 to 150 Hz, 50 N RMS, in N."""
    frequencies = np.arange(_SAMPLES // 2 + 1) * _RATE / _SAMPLES
    excited = (frequencies >= 5) & (frequencies <= 150)
    phases = np.exp(2j * np.pi * random.uniform(size=len(frequencies)))
    force = np.fft.irfft(np.where(excited, phases, 0), _SAMPLES)
    return np.asarray(50 * force / np.sqrt(np.mean(force**2)))


def _sweep() -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return times (s) and force (N) of a sine of 40 N from 20 to 50 Hz at 10 Hz per minute."""
    growth = 10 / 60
    times = np.arange(0, 30 / growth, 1 / _RATE)
    return times, 40 * np.sin(2 * np.pi * (20 + growth / 2 * times) * times)


def decibels(rms: float) -> float:
    """Return an RMS error (m) in decibels, 20 log10 of it, as in the literature."""
    return float(20 * np.log10(rms))
