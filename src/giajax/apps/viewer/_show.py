"""Scenes with their recorded markers (shows), several of which can share one clock."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from ...fitting import arm_model_of, load_result, predict
from ...mechanics.arm import Arm
from ...models import (
    AbstractModel,
    ArmModel,
    Scene,
    arm_scene,
    capabilities,
    model_for,
    recorded_markers,
    wind_of,
)
from ...recordings import Definition, Run, read_numbers, read_run, stored_result
from ...runtime.arrays import Float
from ...runtime.text import InputError
from ...simulation import SimulationError, at_rest
from ...tasks import fitted_runs
from ..synthetic import logged_motion
from ..tracking import BAND, TRACK_FILES, end_columns


class Bands(NamedTuple):
    """95 % bands of the positions of the link ends along each axis.

    Attributes:
        centres: centres of the bands, m, shape (sample, link, 3); the last link ends at the tip.
        halves: half widths along x, y and z, m, shape (sample, link, 3).
    """

    centres: Float[np.ndarray, "sample link 3"]
    halves: Float[np.ndarray, "sample link 3"]


@dataclasses.dataclass(frozen=True)
class Show:
    """Scene with its recorded markers.

    Attributes:
        name: name in the legend.
        scene: scene to show.
        recorded: recorded points by the names of the scene's markers, m, shape (sample, 3).
        notes: notes on what is not shown, with the reason.
        bands: 95 % bands of the link ends if the scene is an estimate.
        captions: start times, s, and names of the phases of the motion, in order of time.
        measured: recorded values of other channels, SI, by channel name; NaN where a value is
            missing.
    """

    name: str
    scene: Scene
    recorded: Mapping[str, Float[np.ndarray, "sample 3"]] = dataclasses.field(default_factory=dict)
    notes: tuple[str, ...] = ()
    bands: Bands | None = None
    captions: tuple[tuple[float, str], ...] = ()
    measured: Mapping[str, Float[np.ndarray, " sample"]] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        for what, given in (("marker", self.recorded), ("channel", self.measured)):
            for name, values in given.items():
                if len(values) != self.samples:
                    raise InputError(
                        f"the recorded {what} '{name}' has {len(values)} samples, but the scene "
                        f"has {self.samples}: give the same number"
                    )

    @property
    def samples(self) -> int:
        """Number of samples."""
        return self.scene.samples

    @property
    def clock(self) -> Float[np.ndarray, " sample"]:
        """Times of the samples, s; a scene without times is shown at ten samples per second."""
        if self.scene.times is None:
            return np.arange(self.samples) / 10
        return self.scene.times

    def sample_at(self, time: float) -> int:
        """Return the last sample at or before a time, s, or the first sample if there is none."""
        # The tolerance of half a nanosecond covers the rounding errors of accumulated times.
        after = int(np.searchsorted(self.clock, time + 5e-10, side="right"))
        return max(after - 1, 0)

    def caption_at(self, sample: int) -> str:
        """Return the caption of the phase at a sample, or an empty string."""
        time = self.clock[sample] + 5e-10
        return next((name for begin, name in reversed(self.captions) if begin <= time), "")

    def marker_error(self, sample: int) -> float | None:
        """Return the RMS distance between recorded and shown markers at a sample, m."""
        off = [
            self.recorded[name][sample] - self.scene.markers[name][sample] for name in self.recorded
        ]
        known = [each for each in off if np.all(np.isfinite(each))]
        return float(np.sqrt(np.mean(np.sum(np.square(known), axis=1)))) if known else None


def span(shows: Sequence[Show]) -> tuple[float, float]:
    """Return the first and last time of several shows, s."""
    return min(float(show.clock[0]) for show in shows), max(float(show.clock[-1]) for show in shows)


def frames(shows: Sequence[Show], rate: float, most: int) -> Float[np.ndarray, " frame"]:
    """Return the times to draw at, s: every sample up to a rate, Hz, and a number of frames."""
    first, last = span(shows)
    finest = min(float(np.min(np.diff(show.clock), initial=np.inf)) for show in shows)
    count = int(np.ceil((last - first) / max(finest, 1 / rate) - 1e-9)) + 1 if last > first else 1
    return np.linspace(first, last, min(count, most))


class Posable:
    """Arm without a motion, whose joint angles the user sets."""

    def __init__(self, model: ArmModel, name: str) -> None:
        self.model = model
        self.name = name

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.model.arm

    def show(self, angles: Float[np.ndarray, " joint"]) -> Show:
        """Return a show of the arm at given joint angles, rad."""
        pose = at_rest(self.arm, jnp.asarray(angles, dtype=jnp.result_type(float)))
        return Show(self.name, arm_scene(pose, self.model.sensors.marker))


def shown(
    path: str | Path,
    *,
    data: Sequence[str | Path] = (),
    rename: Mapping[str, str] | None = None,
    run: str | None = None,
    name: str | None = None,
) -> Show | Posable:
    """Return the show of a file: a motion with recorded markers, or an arm without a motion.

    Arguments:
        path: a recorded or simulated run (`RUN.csv`), the folder of a fit or its `result.json`, the
            folder of a track, or a TOML file that describes an arm.
        data: run files of a fit, if they have been moved since the fit.
        rename: column names of a run -> their names in the column table.
        run: name of the run of a fit; defaults to the first run.
        name: name in the legend; defaults to the name of the file.

    Raises:
        InputError: the file or the run does not exist, or its model has no scene.
    """
    path = Path(path)
    if (path / TRACK_FILES.facts).exists():
        return _tracked(path, name or path.name)
    if path.is_dir() or path.suffix == ".json":
        folder, _ = stored_result(path)
        result = load_result(path)
        chosen = _chosen(fitted_runs(result, data, rename=rename, folder=folder), run, path)
        return _followed(result.model_of(chosen), chosen, name or folder.name)
    if path.suffix == ".toml":
        definition = Definition.load(path)
        if definition.model not in (None, ArmModel.kind):
            raise InputError(f"{path} describes a {definition.model}: give the TOML file of an arm")
        return Posable(ArmModel.stated_in(definition), name or path.stem)
    chosen = read_run(path, rename=rename)
    return _followed(model_for([chosen]), chosen, name or chosen.name)


def posed(run: Run, name: str) -> Show:
    """Return the show of an arm at the recorded angles of all its joints, without a simulation.

    Raises:
        InputError: the run is not a run of an arm, or an angle is missing.
    """
    model = arm_model_of(model_for([run]))
    columns = [f"joint{joint:02d}_angle" for joint in range(1, model.arm.count + 1)]
    missing = [column for column in columns if column not in run.values]
    if missing:
        raise InputError(
            f"'{run.name}' has no {missing[0]}: give the angles of all {model.arm.count} joints"
        )
    times = run.times
    assert times is not None  # the run of an arm has times
    angles = np.stack([np.asarray(run.values[column]) for column in columns], axis=1)
    if not np.all(np.isfinite(angles)):
        row = int(np.argmin(np.all(np.isfinite(angles), axis=1)))
        raise InputError(f"'{run.name}' has no value of an angle at {times[row]:g} s: fill the gap")
    rates = np.gradient(angles, times, axis=0) if len(times) > 1 else np.zeros_like(angles)
    motion = logged_motion(
        model.arm, times, angles, rates, np.zeros_like(angles), np.zeros((len(times), 3))
    )
    motion = dataclasses.replace(motion, wind=wind_of(model.arm, run))
    scene = arm_scene(motion, model.sensors.marker)
    channels = {**scene.channels, **_numeric(run)}
    return Show(name, dataclasses.replace(scene, channels=channels))


def _numeric(run: Run) -> dict[str, np.ndarray]:
    """Return the channels of a run that contain numbers, SI."""
    return {
        name: values for name, values in run.values.items() if run.channels[name].quantity != "text"
    }


def _tracked(folder: Path, name: str) -> Show:
    """Return the show of the motion that a track estimated, with 95 % bands."""
    show = posed(read_run(folder / TRACK_FILES.estimate), name)
    path = folder / TRACK_FILES.bands
    table = read_numbers(path)
    links = range(sum(line.name == "link" for line in show.scene.lines))
    columns = [[end_columns(link, axis) for axis in "xyz"] for link in links]
    if any(column not in table for link in columns for pair in link for column in pair):
        return dataclasses.replace(
            show,
            notes=(
                "95 % regions are not shown, because the track does not contain them: track the "
                "run again",
            ),
        )
    # Shape (kind, link, axis, sample).
    found = np.array(
        [[[table[pair[kind]] for pair in link] for link in columns] for kind in (0, 1)]
    )
    centres, deviations = np.moveaxis(found, 3, 1)
    if len(centres) != show.samples or not np.all(np.isfinite(found)):
        raise InputError(
            f"{path} has missing rows or cells in {TRACK_FILES.estimate}: track the run again"
        )
    return dataclasses.replace(show, bands=Bands(centres, BAND * deviations))


def _chosen(runs: list[Run], name: str | None, path: Path) -> Run:
    if not runs:
        raise InputError(f"{path} contains no fitted run: there is nothing to show")
    if name is None:
        return runs[0]
    known = {each.name: each for each in runs}
    if name not in known:
        raise InputError(
            f"the run '{name}' is not among the fitted runs of {path}: choose one of "
            f"{', '.join(known)}"
        )
    return known[name]


def _followed(model: AbstractModel, run: Run, name: str) -> Show:
    """Return the show of a model that is simulated along a run, with the recorded markers."""
    try:
        scene = capabilities.scene(model, run)
    except SimulationError as error:
        raise InputError(f"the motion of '{run.name}' cannot be simulated: {error}") from None
    if scene is None:
        raise InputError(
            f"'{run.name}' is a run of the {run.model} model, which has no scene: give a run of an "
            "arm"
        )
    predicted = predict(model, run)
    recorded = recorded_markers(scene, run, predicted)
    if not all(np.all(np.isfinite(line.points)) for line in scene.lines):
        raise InputError(
            f"the motion of '{run.name}' is not finite: check the parameters of the model"
        )
    unknown = (
        "recorded markers are not shown, because the axes of their camera differ from those "
        "of the model",
    )
    # The coordinates of recorded markers are plotted as positions. The samples of a scene of
    # another model may differ from those of its run.
    plotted = {f"{marker}_{axis}" for marker in recorded or {} for axis in "xyz"}
    count = len(scene.lines[0].points)
    others = {
        name: values
        for name, values in _numeric(run).items()
        if name not in plotted and len(values) == count
    }
    measured = {name: each for name, each in others.items() if run.part_of(name) == "measured"}
    channels = {
        **scene.channels,
        **{each: predicted[each] for each in measured.keys() & predicted.keys()},
        **{each: others[each] for each in others.keys() - measured.keys()},
    }
    return Show(
        name,
        dataclasses.replace(scene, channels=channels),
        recorded or {},
        unknown if recorded is None else (),
        measured=measured,
    )


def _length(metres: float) -> str:
    return f"{metres:.2f} m" if metres >= 1 else f"{1e3 * metres:.1f} mm"


_FORCES = {"air": "largest drag on a link", "contact": "largest contact force"}


def words(show: Show, sample: int, colour: str) -> str:
    """Return a description of a sample of a show as Markdown; the colour names its bodies."""
    # Escape the name: Markdown or HTML in a file name would be rendered by the page.
    name = re.sub(r"([!-/:-@\[-`{-~])", r"\\\1", " ".join(show.name.split()))
    said = [f"**{name}** ({colour})"]
    if caption := show.caption_at(sample):
        said.append(caption)
    if show.scene.times is not None and show.samples > 1:
        said.append(f"time {show.clock[sample]:.2f} s")
    if (tip := show.scene.markers.get("tip")) is not None and np.all(np.isfinite(tip[sample])):
        said.append("tip at " + ", ".join(f"{part:.3f}" for part in tip[sample]) + " m")
    if show.bands is not None:
        size = float(np.linalg.norm(show.bands.halves[sample, -1]))
        # The diagonal of the band: the probability is that of a band if one axis dominates, and
        # larger otherwise.
        said.append(f"tip within {_length(size)} of the estimate (probability at least 95 %)")
    if (off := show.marker_error(sample)) is not None:
        said.append(f"RMS distance to the recorded markers {_length(off)}")
    for arrows in show.scene.arrows:
        force = float(np.max(np.linalg.norm(arrows.vectors[sample], axis=-1), initial=0.0))
        if np.any(arrows.vectors):
            said.append(f"{_FORCES.get(arrows.name, arrows.name)} {force:.3g} {arrows.unit}")
    pressures = [line.pressure[sample] for line in show.scene.lines if line.pressure is not None]
    if pressures:
        said.append(f"highest muscle pressure {max(pressures) / 1e5:.2f} bar")
    return "  \n".join([*said, *(f"*{note}*" for note in show.notes)])
