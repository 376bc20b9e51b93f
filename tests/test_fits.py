"""The fit definitions in fits/ reach their expected results."""

from pathlib import Path

import numpy as np
import pytest

from giajax import FitTask, model_for
from giajax.models import capabilities
from giajax.recordings import Definition
from giajax.report import reached
from giajax.schema.parameters import elements, switched_on

# Real recordings have no true values; tests/test_recordings.py checks their predictions.
FITS = [
    path
    for path in sorted((Path(__file__).parents[1] / "fits").glob("*.toml"))
    if not any("recorded/" in name for name in Definition.load(path).fit.data)
]


# Names of the parameters in the sidecars of the other engine.
ENGINE = {
    "air.drag_coefficient": "drag_coefficient",
    "joints.pitch_stiffness": "pitch_stiffness_N_m_per_rad",
    "joints.yaw_stiffness": "yaw_stiffness_N_m_per_rad",
    "joints.damping": "joint_damping_N_m_s_per_rad",
    "joints.memory.strength": "joint_friction_N_m",
}


# With errors of 50 %, a geometry cannot be built, and a camera looks in another direction.
NEARER = {"geometry.": 0.15, "camera.side.": 0.25, "camera.front.": 0.25, "camera.tip.": 0.25}


def true_value(stated, name):
    path, _, index = name.rstrip("]").partition("[")
    if index and path in stated:
        return stated[path][int(index)]
    if name == "joints.memory.yield_angle" and name not in stated:
        return stated["joint_friction_N_m"] / stated["joint_friction_stiffness_N_m_per_rad"]
    return stated.get(name, stated.get(ENGINE.get(name, "")))


@pytest.mark.parametrize("path", FITS, ids=lambda path: path.stem)
def test_it_states_the_truth_and_starts_away_from_it(path):
    task = FitTask.load(path)
    definition, runs = task.definition, task.prepare().runs
    model = switched_on(model_for(runs), definition.fit.free)
    freed = {element.path for path in definition.fit.free for element in elements(model, path)}
    # If only a combination of parameters is determined, the combination has an expected value, too.
    derived = set(definition.figures) & set(capabilities.derived(model))
    assert set(definition.figures) == freed | derived
    truths = [run.definition.truth for run in runs]
    if len({run.model for run in runs}) > 1:
        # Each of the models has only a part of the true values.
        truths = [{path: value for truth in truths for path, value in truth.items()}]
    for stated in truths:
        for name, figure in definition.figures.items():
            if figure.determined is False:
                continue
            truth = true_value(stated, name)
            assert figure.value == truth
            assert figure.standard_errors <= 3
            if name in derived:
                continue
            off = next((by for part, by in NEARER.items() if name.startswith(part)), 0.4)
            start = definition.fit.start.get(name)
            if start is None:  # an option starts at its neutral value
                start = float(elements(model, name)[0].value(model))
            assert start == 0 or abs(np.log(start / truth)) > off


# The other definitions together, or a test of a shorter arm, check the same as these.
LONG = {
    "independent_friction", "two_runs", "independent_pitch_yaw", "independent_wind",
    "joint_memory", "pitch_yaw", "camera_frame", "whole_arm", "full_air", "pixels_side",
}  # fmt: skip
REACHING = [
    pytest.param(path, marks=pytest.mark.long if path.stem in LONG else pytest.mark.slow)
    for path in FITS
]


@pytest.mark.parametrize("path", REACHING, ids=lambda path: path.stem)
def test_it_reaches_its_figures(path):
    task = FitTask.load(path)
    definition, runs = task.definition, task.prepare().runs
    result = task.run(check=False)
    assert result.status == "converged", result.message
    assert result.iterations <= (12 if result.model.kind == "arm" else 40)
    found = reached(result, definition)
    assert len(found) == len(definition.figures)
    missed = [f"{figure.path} {figure.sentence}" for figure in found if not figure.reached]
    assert missed == []
    # The residuals equal the stated noise, within the accuracy for this number of cells.
    cells = sum(np.isfinite(values).sum() for run in runs for values in run.observations.values())
    assert abs(result.reduced_chi_square - 1) < 4 * np.sqrt(2 / cells)
    # Wrong expected values must not be reached.
    path, estimate = next(iter(result.free.items()))
    wrong = {"value": 1.1 * estimate.value, "standard_errors": 3}
    assert not reached(result, Definition.parse({"figures": {path: wrong}}))[0].reached
