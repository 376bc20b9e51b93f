"""The channels and the windows of a run that a fit uses."""

import numpy as np
import pytest

from giajax import InputError, Run
from giajax.recordings import observing, windows

pytestmark = pytest.mark.quick

TIMES = np.linspace(0.0, 2.1, 211)


def swing(**definition):
    values = {f"joint0{j}_{kind}": np.sin(j * TIMES + k) for j in (1, 2) for k, kind in
              enumerate(("angle", "rate"))}  # fmt: skip
    stated = definition or {"initial": {"first_row": True}}
    return Run.from_arrays(TIMES, values, name="swing", definition=stated)


def test_absolute_angles_are_sums_of_joint_angles():
    run = observing(swing(), ["link02_angle", "joint01_rate"])
    assert list(run.observations) == ["link02_angle", "joint01_rate"]
    expected = run.values["joint01_angle"] + run.values["joint02_angle"]
    np.testing.assert_array_equal(run.observations["link02_angle"], expected)
    assert run.channels["link02_angle"].column == "link02_angle_rad"
    # A channel that is not compared can still give the initial state.
    assert "joint02_rate" in run.values


@pytest.mark.parametrize("name", ["link03_angle", "tip_z", "joint01_command"])
def test_a_channel_that_is_not_there_is_one_sentence(name):
    with pytest.raises(InputError, match=r"has no channel .*: choose among .*joint01_angle"):
        observing(swing(), [name])


def test_windows_follow_each_other_without_overlap():
    run = swing()
    parts = windows(run, 0.5)
    assert len(parts) == 4
    assert [len(part.times) for part in parts] == [50, 50, 50, 50]
    joined = np.concatenate([part.times for part in parts])
    np.testing.assert_array_equal(joined, TIMES[:200])
    assert parts[2].times[0] == pytest.approx(1.0)
    assert parts[2].values["joint02_angle"][0] == np.sin(2 * parts[2].times[0])
    assert len({part.name for part in parts}) == 4


def loop():
    values = np.sin(TIMES)
    return Run.from_arrays(TIMES, {"input": values, "output": values}, name="loop")


def test_a_window_longer_than_the_run_is_the_run():
    (part,) = windows(swing(), 2.5)
    assert len(part.times) >= 210


@pytest.mark.parametrize(
    ("run", "length", "sentence"),
    [
        (swing(), 0.03, "fewer than 4 samples"),
        (swing(initial={"angle_deg": 1.0}), 0.5, "first_row = true"),
        (loop(), 0.5, "hysteresis model .* omit the windows"),
    ],
)
def test_windows_that_cannot_be(run, length, sentence):
    with pytest.raises(InputError, match=sentence):
        windows(run, length)
