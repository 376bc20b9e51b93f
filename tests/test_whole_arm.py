"""Corrections of the joints from the arm alone, which a test bench determines separately."""

from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from giajax import FitTask, load_result, read_run

WHOLE = Path(__file__).parents[1] / "fits" / "whole_arm.toml"


@pytest.mark.long
def test_without_the_bench_only_the_difference_of_alpha_and_beta_is_determined(tmp_path):
    """Beta decreases with the angle, so its curvature adds to that of alpha."""
    task = FitTask.load(WHOLE)
    arm, _, loop = task.data
    result = task.on_top(data=[arm, loop]).run(check=False)
    assert result.status == "converged", result.message
    pair = {"alpha.curvature", "beta.curvature"}
    for path, estimate in result.free.items():
        assert (estimate.standard_error is None) == (path in pair), path
    (finding,) = [each for each in result.findings if each.code == "only_combinations"]
    assert "only beta.curvature + 1 alpha.curvature = " in finding.sentence
    value, error = finding.sentence.partition(" = ")[2].split(" +- ")
    error = float(error.split(":")[0])
    assert abs(float(value) - (0.9 + 0.5)) < 3 * error
    assert error < 0.03
    assert result.parameters["drive.passive_stiffness"].sources["whole_loop"] > 3
    assert result.parameters["air.drag_coefficient"].sources["whole_arm"] is None
    # The bench measures torques, which determine the scale of all forces.
    assert not any("per unit of mass" in sentence for sentence in result.conditions)
    path = tmp_path / "result.json"
    path.write_text(result.to_json())
    again = load_result(path)
    assert again.model.kind == "arm+hysteresis"
    bench = read_run(loop)
    assert_allclose(again.predict(bench)["output"], result.predictions[1]["output"], atol=1e-9)
