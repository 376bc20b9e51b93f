"""What the arm alone tells of the corrections of its joints, of which a bench tells each."""

from pathlib import Path

import pytest

from giajax import FitTask

WHOLE = Path(__file__).parents[1] / "fits" / "whole_arm.toml"


@pytest.mark.slow
def test_without_the_bench_only_the_difference_of_alpha_and_beta_is_determined():
    """Beta is a fall, so that its curvature adds to that of alpha."""
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
