"""`prediction.toml` of a fit is the sidecar of a run, whose fit reproduces the parameters."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax import FitTask, Run, model_for, replace
from giajax.fitting import predict
from giajax.recordings import write_run
from giajax.report import write_result
from giajax.schema import KINDS
from giajax.schema.parameters import switched_on

TIMES = np.linspace(0.0, 2.0, 41)
LOOPS = np.sin(np.linspace(0.0, 12.0, 60)) * np.linspace(1.0, 0.4, 60)

# The recorded channels, the sidecar, and the true values. All constants differ from the defaults of
# the model.
CASES = {
    "arm": {
        "times": TIMES,
        "inputs": {"joint01_command": 0.5 * np.clip(TIMES / 0.4, 0, 1)},
        "outputs": ["link02_x", "link02_z", "joint01_angle", "joint02_angle"],
        "definition": {
            "arm": {"links": 2, "link_mass_kg": [0.06, 0.05], "joint_axes": ["pitch", "pitch"]},
            "sensors": {"encoder_scale": 1.02, "marker_up_m": 0.15},
            "wind": {"velocity_m_per_s": [0.3, 0.0, 0.1]},
            "command": {"interpolation": "zoh"},
            "uncertainty": {"defaults": False},
        },
        "truth": {
            "air.drag_coefficient": 1.3,
            "joints.pitch_stiffness": 2.4,
            "joints.damping": 0.12,
            "camera.origin[2]": 0.1,
        },
    },
    "joint": {
        "inputs": {
            "angle": np.radians(np.linspace(-60.0, 60.0, 41)),
            "side": np.where(np.arange(41) < 20, "outer", "inner").astype(object),
        },
        "outputs": ["contraction", "force"],
        "definition": {"joint": {"torque_N_m": 0.4, "muscle_length_m": 1.9, "blend_deg": 2.0}},
        "truth": {"alpha.offset": 0.035, "alpha.threshold": 0.66, "beta.offset": 0.012},
    },
    "muscle": {
        "inputs": {
            "pressure": np.tile([1e5, 2e5, 3e5], 20),
            "contraction": np.tile(np.linspace(0.0, 0.2, 30), 2),
            "phase": np.repeat(["fill", "exhaust"], 30).astype(object),
        },
        "outputs": ["force"],
        "definition": {
            "muscle": {"law": "braided", "length_m": 1.5, "friction": "coulomb"},
        },
        "truth": {
            "muscle.effectiveness": 0.85,
            "muscle.end_correction": 1.2,
            "friction.half_width[0]": 0.9,
        },
    },
    "hysteresis": {
        "inputs": {"input": LOOPS},
        "outputs": ["output"],
        "definition": {
            "hysteresis": {"operator": "prandtl_ishlinskii", "thresholds": [0.1, 0.4]},
        },
        "truth": {"elastic": 0.5, "weights[0]": 0.4, "weights[1]": 0.2, "offset": 0.1},
    },
    "oscillator": {
        "times": np.arange(200) / 750,
        "inputs": {"input": 60 * np.sin(np.arange(200) ** 2 / 1200)},
        "outputs": ["output"],
        "definition": {"oscillator": {"interpolation": "linear"}},
        "truth": {"mass": 2.2, "offset": 1e-4},
    },
}


def test_every_kind_is_among_the_cases():
    assert set(CASES) == set(KINDS)


def record(path, kind, case):
    """Write a run simulated by a model of this kind, with noise of a thousandth of its range."""
    definition = {"model": kind, **case["definition"]}
    times, inputs = case.get("times"), case["inputs"]
    rows = len(next(iter(inputs.values())))
    blank = Run.from_arrays(
        times,
        {**inputs, **{name: np.zeros(rows) for name in case["outputs"]}},
        definition=definition,
    )
    assumed = model_for([blank])
    truth = replace(switched_on(assumed, case["truth"]), case["truth"])
    clean = predict(truth, blank, case["outputs"])
    noise = np.random.default_rng(3)
    recorded = {
        name: values + 1e-3 * np.ptp(values) * noise.normal(size=rows)
        for name, values in clean.items()
    }
    return write_run(path, times, {**inputs, **recorded}, definition=definition)


@pytest.mark.slow
@pytest.mark.parametrize("kind", CASES)
def test_a_fit_of_a_prediction_gives_the_parameters_back(kind, tmp_path):
    case = CASES[kind]
    path = record(tmp_path / "run.csv", kind, case)
    start = {path: 1.1 * value for path, value in case["truth"].items()}
    ready = FitTask.of(path).on_top(free=list(start), start=start).prepare()
    result = ready.run(check=False)
    assert result.status == "converged"
    write_result(result, ready.runs, tmp_path / "out")

    start = {path: 0.8 * estimate.value for path, estimate in result.free.items()}
    prediction = tmp_path / "out" / "prediction.csv"
    task = FitTask.of(prediction).on_top(free=list(start), start=start)
    again = task.run(check=False)
    assert again.status == "converged"
    # A prediction has nine digits per cell, and its sidecar has the values that generated it.
    for name, estimate in result.parameters.items():
        assert_allclose(again.parameters[name].value, estimate.value, rtol=1e-5, err_msg=name)
    assert again.model.kind == kind
