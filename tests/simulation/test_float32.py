"""Simulation in JAX's default precision, in a separate process: less exact, but finite."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose

from giajax.mechanics.arm import takeichi_20m
from giajax.simulation import joint_ramps, simulate

PROGRAM = """
import json, sys
import jax, jax.numpy as jnp, numpy as np
from giajax.mechanics.arm import takeichi_20m
from giajax.schema.parameters import replace
from giajax.simulation import joint_ramps, simulate

arm = takeichi_20m(4)
command = joint_ramps(4, {1: 0.5, 2: 0.3}, start=0.5, duration=1.0)
times = np.linspace(0.0, 5.0, 26)

@jax.jit
def move(vector):
    by_name = dict(zip(["air.drag_coefficient", "joints.damping"], vector[:2]))
    options = {"wind": vector[2:], "steps_for": "derivatives", "throw": False}
    motion = simulate(replace(arm, by_name), command, times, solver=sys.argv[1], **options)
    return motion.tip, motion.successful

tip, successful = move(jnp.array([1.2, 0.05, 0.0, 0.0, 0.0]))
slopes = jax.jacfwd(lambda x: move(x)[0][-1])(jnp.array([1.2, 0.05, 0.0, 0.0, 0.0]))
print(json.dumps({
    "dtypes": [str(tip.dtype), str(slopes.dtype)],
    "successful": bool(successful),
    "tip": np.asarray(tip).tolist(),
    "slopes": np.asarray(slopes).tolist(),
}))
"""


@pytest.mark.parametrize(
    "solver",
    [
        pytest.param("tsit5", marks=pytest.mark.long),
        pytest.param("springs5", marks=pytest.mark.slow),
    ],
)
def test_a_simulation_in_32_bit_is_near_that_in_64_bit(solver):
    environment = os.environ | {"JAX_ENABLE_X64": "0", "PYTHONWARNINGS": "error"}
    ended = subprocess.run(
        [sys.executable, "-c", PROGRAM, solver], capture_output=True, text=True, env=environment
    )
    assert ended.returncode == 0, ended.stderr
    found = json.loads(ended.stdout)
    assert found["dtypes"] == ["float32", "float32"]
    assert found["successful"]
    command = joint_ramps(4, {1: 0.5, 2: 0.3}, start=0.5, duration=1.0)
    expected = simulate(takeichi_20m(4), command, np.linspace(0.0, 5.0, 26))
    assert_allclose(found["tip"], expected.tip, rtol=0, atol=2e-4)
    slopes = np.array(found["slopes"])
    assert np.all(np.isfinite(slopes))
    assert np.all(np.abs(slopes).max(axis=0) > 1e-3)
