"""A short run of a short arm, simulated by the model: quick to fit, with known true values."""

import functools

import numpy as np

from giajax.fitting import predict
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel
from giajax.recordings import Run, read_run, write_run
from giajax.schema.parameters import replace

LINKS = 4
TRUTH = {
    "air.drag_coefficient": 1.1,
    "joints.pitch_stiffness": 2.5,
    "joints.yaw_stiffness": 4.0,
    "joints.damping": 0.1,
}
START = {
    "air.drag_coefficient": 0.9,
    "joints.pitch_stiffness": 3.0,
    "joints.yaw_stiffness": 5.0,
    "joints.damping": 0.07,
}
STARTS = [part for path, value in START.items() for part in ("--start", f"{path}={value}")]
NOISE = 0.01

TIMES = np.linspace(0.0, 4.0, 41)
RAMP = np.clip(TIMES / 0.5, 0, 1)
COMMANDS = {"joint01_command": 0.6 * RAMP, "joint02_command": -0.5 * RAMP}
DEFINITION = {
    "arm": {"links": LINKS},
    "noise": {"position_m": NOISE},
    "uncertainty": {"defaults": False},  # the simulated recording is exact
}


@functools.cache
def predicted(channels):
    """Simulate the true arm, once per session."""
    model = replace(ArmModel(takeichi_20m(LINKS)), TRUTH)
    dummy = {channels[0]: np.zeros_like(TIMES)}
    return predict(
        model, Run.from_arrays(TIMES, {**COMMANDS, **dummy}, definition=DEFINITION), channels
    )


def make_run(
    folder, name="run", *, seed=0, channels=("link02_y", "link04_y", "link04_z"), **written
):
    """Write NAME.csv and its sidecar (noise 0.01 m, a gap per channel), and return its path."""
    noise, recorded = np.random.default_rng(seed), {}
    for channel, values in predicted(tuple(channels)).items():
        recorded[channel] = values + NOISE * noise.normal(size=41)
        recorded[channel][15:20] = np.nan
    path = folder / f"{name}.csv"
    return write_run(path, TIMES, {**COMMANDS, **recorded}, definition=DEFINITION, **written)


def small_run(folder, name="run", **options):
    """Write such a run and read it."""
    return read_run(make_run(folder, name, **options))
