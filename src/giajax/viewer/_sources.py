"""What a file has to show: a run, a fit, or the arm of a definition."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Float
from ..arm import Arm
from ..fitting import load_result, predict
from ..models import (
    AbstractModel,
    ArmModel,
    Scene,
    arm_from_definition,
    arm_scene,
    model_for,
    recorded_markers,
    sensors_from_definition,
)
from ..runs import Definition, Run, read_run
from ..simulation import SimulationError, at_rest
from ..tasks import fitted_runs, stored_result
from ._show import Show


class Posable:
    """An arm whose joints are set by hand: no motion, only where links are.

    Arguments:
        model: of the arm.
        name: what a legend says.
    """

    def __init__(self, model: ArmModel, name: str) -> None:
        self.model = model
        self.name = name

    @property
    def arm(self) -> Arm:
        """The arm."""
        return self.model.arm

    def show(self, angles: Float[np.ndarray, " joint"]) -> Show:
        """The arm at angles of its joints, rad."""
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
    """What there is to see of a file.

    Arguments:
        path: a recorded or simulated run (`RUN.csv`), the folder of a fit or its `result.json`, or
            a TOML file that states an arm.
        data: the runs of a fit, where they lie elsewhere now.
        rename: a run's column name -> the name it has in the column table.
        run: name of the run of a fit; the first one by default.
        name: what a legend says; of the file by default.

    Returns:
        A motion with its recorded markers; of a TOML file an arm without a motion.

    Raises:
        InputError: there is no such file or run, or nothing is seen of its model.
    """
    path = Path(path)
    if path.is_dir() or path.suffix == ".json":
        folder, _ = stored_result(path)
        result = load_result(path)
        chosen = _chosen(fitted_runs(result, data, rename=rename), run, path)
        return _followed(result.model_of(chosen), chosen, name or folder.name)
    if path.suffix == ".toml":
        return _posable(path, name or path.stem)
    chosen = read_run(path, rename=rename)
    return _followed(model_for([chosen]), chosen, name or chosen.name)


def _chosen(runs: list[Run], name: str | None, path: Path) -> Run:
    if not runs:
        raise InputError(f"nothing of the runs of {path} was fitted: there is nothing to show")
    if name is None:
        return runs[0]
    known = {each.name: each for each in runs}
    if name not in known:
        raise InputError(
            f"{path} was not fitted to a run '{name}': choose one of {', '.join(known)}"
        )
    return known[name]


def _posable(path: Path, name: str) -> Posable:
    definition = Definition.load(path)
    if definition.model not in (None, ArmModel.kind):
        raise InputError(f"{path} describes a {definition.model}: give the TOML file of an arm")
    arm, sensors = arm_from_definition(definition), sensors_from_definition(definition)
    return Posable(ArmModel(arm, sensors=sensors), name)


def _followed(model: AbstractModel, run: Run, name: str) -> Show:
    """A model along a run, and what was recorded of it."""
    try:
        scene = model.scene(run)
    except SimulationError as error:
        raise InputError(f"the motion of '{run.name}' cannot be simulated: {error}") from None
    if scene is None:
        raise InputError(
            f"'{run.name}' is of a {run.model}, of which nothing is seen: give an arm's"
        )
    recorded = recorded_markers(scene, run, predict(model, run))
    notes = []
    if recorded is None:
        notes.append("recorded markers are not shown: the axes of their camera are others")
    return Show(name, _finite(scene, run), recorded or {}, tuple(notes))


def _finite(scene: Scene, run: Run) -> Scene:
    if not all(np.all(np.isfinite(line.points)) for line in scene.lines):
        raise InputError(f"the motion of '{run.name}' is not finite: check its parameters")
    return scene
