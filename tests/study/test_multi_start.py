"""Several starts find the valley that one start misses, and say how many did."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from giajax import Run, load_result
from giajax.report import summary
from giajax.study import _multi_start, misfit, multi_start
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
    assert channel.innovation <= channel.noise
    assert misfit(result) == pytest.approx(result.cost + 60 * np.log(channel.innovation))


# Any finished fit will do where none is run.
FINISHED = Path(__file__).parents[1] / "fitting" / "earlier"


@pytest.mark.parametrize("interrupted_at", [1, 2, 3, 4])
def test_an_interruption_keeps_the_best_start_so_far(monkeypatch, interrupted_at):
    """Before the second start, or the last check, has evaluated anything."""
    finished = dataclasses.replace(load_result(FINISHED), starts=())
    calls = []

    def solve(setup, **_):
        calls.append(setup)
        if len(calls) == interrupted_at:
            raise KeyboardInterrupt
        return finished

    # One after the other, or the third start would be called before the second is interrupted.
    monkeypatch.setenv("GIAJAX_CORES", "1")
    monkeypatch.setattr(_multi_start, "solve", solve)
    monkeypatch.setattr(_multi_start, "inside_bounds", lambda setup, values: {"decay": 2.0})
    if interrupted_at == 1:
        with pytest.raises(KeyboardInterrupt):
            multi_start(Decay(), run(), starts=3)
        return
    result = multi_start(Decay(), run(), starts=3)
    assert len(calls) == interrupted_at
    assert result.status == "interrupted"
    assert result.parameters == finished.parameters
    at = "before its result was checked" if interrupted_at == 4 else f"at start {interrupted_at}"
    assert f"; interrupted {at}" in result.message
    ends = [start.status for start in result.starts]
    assert ends == ["converged"] * min(interrupted_at - 1, 3) + ["interrupted"] * (
        interrupted_at < 4
    )
