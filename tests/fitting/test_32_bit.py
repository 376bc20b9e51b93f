"""A fit in 32-bit arithmetic, in a separate process: one warning, and estimates near the truth."""

import json
import subprocess
import sys

import pytest

SCRIPT = """
import json, warnings
import numpy as np
import giajax
from giajax.apps.synthetic import synthesise

arm = giajax.replace(giajax.takeichi_20m(3), {"air.drag_coefficient": 1.5})
times = np.linspace(0.0, 6.0, 61)
ramp = np.clip(times - 0.5, 0, 1)
run = synthesise(
    giajax.ArmModel(arm), times, {"joint01_command": 0.6 * ramp, "joint02_command": 0.4 * ramp},
    ["link03_z", "link03_y", "tip_x"], noise={"position": 0.01},
)
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    result = giajax.fit(giajax.model_for([run]), run)
    giajax.fit(giajax.model_for([run]), run, max_iterations=1, check=False)
print(json.dumps({
    "status": result.status,
    "message": result.message,
    "warnings": [str(w.message) for w in caught],
    "pull": (result.parameters["air.drag_coefficient"].value - 1.5)
    / result.parameters["air.drag_coefficient"].standard_error,
    "check": result.gradient_check.relative_difference,
}))
"""


@pytest.mark.slow
def test_a_fit_in_32_bit():
    ended = subprocess.run(
        [sys.executable, "-c", SCRIPT], capture_output=True, text=True, check=True
    )
    said = json.loads(ended.stdout)
    assert said["status"] == "converged", said["message"]
    assert len(said["warnings"]) == 1
    assert "32-bit" in said["warnings"][0]
    assert abs(said["pull"]) < 3
    assert said["check"] < 0.1
