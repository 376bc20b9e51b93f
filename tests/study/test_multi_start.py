"""Several starts find the valley that one start misses, and say how many did."""

import numpy as np
import pytest

from giajax import Run
from giajax.report import summary
from giajax.study import misfit, multi_start
from toy_model import TRUTH, Decay, height, run


def test_the_best_of_several_starts_is_the_result():
    """The others are within the spread of the first, and the best end is the result."""
    told = []
    result = multi_start(
        Decay(),
        run(),
        starts=4,
        spread=0.5,
        seed=1,
        start={"amplitude": 0.5, "decay": 3.0},
        announce=lambda number, start: told.append((number, dict(start))),
    )
    assert result.status == "converged"
    assert [number for number, _ in told] == [1, 2, 3, 4]
    assert told[0][1] == {"amplitude": 0.5, "decay": 3.0, "offset": 0.1}
    assert len({start["decay"] for _, start in told}) == 4
    for _, start in told:
        assert 3.0 / 1.5 <= start["decay"] <= 3.0 * 1.5
    for path in ("amplitude", "decay", "offset"):
        estimate = result.parameters[path]
        assert abs(estimate.value - TRUTH[path]) < 3.5 * estimate.standard_error
    assert misfit(result) == pytest.approx(min(s.misfit for s in result.starts), abs=1e-3)
    assert result.gradient_check is not None
    assert "of 4 ended here" in summary(result)
    assert result.config["start"] == {"amplitude": 0.5, "decay": 3.0}


def test_a_start_that_fails_is_passed_over():
    """The decay fails above 8, where some of the starts are."""
    result = multi_start(
        Decay(), run(), starts=6, spread=2.0, seed=0, start={"decay": 5.0}, check=False
    )
    failed = [start for start in result.starts if start.status == "failed"]
    assert failed
    assert result.status == "converged"


def test_ends_are_compared_by_likelihood_when_the_noise_is_estimated():
    times = np.linspace(0.0, 4.0, 60)
    noisy = height(times) + 0.01 * np.random.default_rng(0).normal(size=60)
    unknown = Run.from_arrays(times, {"tip_z": noisy}, definition={"free_motion": True})
    result = multi_start(Decay(), unknown, starts=2, start={"decay": 2.0}, check=False)
    (channel,) = result.runs[0].channels.values()
    assert channel.noise == pytest.approx(0.01, rel=0.3)
    assert misfit(result) == pytest.approx(result.cost + 60 * np.log(channel.noise))
