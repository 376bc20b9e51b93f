"""The inputs of a synthetic run, and the rows at which it is written."""

import numpy as np
import pytest

from giajax import InputError
from giajax.apps.synthetic import Drive, Move, joint_moves, sampled
from giajax.simulation import logged


def test_ramps_go_on_from_where_the_joint_is():
    drive = joint_moves(
        [Move(3, 0.1, 8.0, 2.0), Move(1, 0.5, 1.0, 1.0), Move(3, 0.4, 2.0, 2.0)], joints=4, end=20.0
    )
    assert drive.interpolation == "linear"
    assert list(drive.values) == ["joint01_command", "joint03_command"]
    at = drive.at(np.array([0.0, 1.5, 3.0, 5.0, 9.0, 11.0]))
    np.testing.assert_allclose(at["joint01_command"], [0, 0.25, 0.5, 0.5, 0.5, 0.5], atol=1e-15)
    np.testing.assert_allclose(at["joint03_command"], [0, 0, 0.2, 0.4, 0.25, 0.1], atol=1e-15)


def test_ramps_that_follow_each_other_meet():
    drive = joint_moves([Move(1, 0.5, 0.0, 1.0), Move(1, -0.5, 1.0, 2.0)], joints=1, end=5.0)
    np.testing.assert_array_equal(drive.times, [0, 1, 3])
    np.testing.assert_array_equal(drive.values["joint01_command"], [0, 0.5, -0.5])


def test_steps_hold():
    drive = joint_moves([Move(1, 0.5, 0.3, 0.0), Move(1, 0.0, 2.0, 0.0)], joints=1, end=5.0)
    assert drive.interpolation == "zoh"
    at = drive.at(np.array([0.0, 0.2999, 0.3, 1.9, 2.0, 4.0]))
    np.testing.assert_array_equal(at["joint01_command"], [0, 0, 0.5, 0.5, 0, 0])


def test_a_step_at_the_start_is_there_from_the_start():
    drive = joint_moves([Move(1, 0.5, 0.0, 0.0)], joints=1, end=5.0)
    np.testing.assert_array_equal(drive.at(np.array([0.0, 1.0]))["joint01_command"], [0.5, 0.5])


def test_a_sample_that_rounding_puts_before_a_step_belongs_after_it():
    drive = joint_moves([Move(1, 0.5, 0.3, 0.0)], joints=1, end=1.0)
    times, values = sampled([drive], start=0.0, duration=1.0, rate=10.0)
    assert len(times) == 11
    assert values["joint01_command"][np.argmin(abs(times - 0.3))] == 0.5


@pytest.mark.parametrize("interpolation", ["zoh", "linear"])
def test_rows_read_back_as_the_same_signal(interpolation):
    random = np.random.default_rng(5)
    knots = np.sort(random.uniform(0, 10, 9))
    drive = Drive(
        knots, {"joint01_command": random.normal(size=9), "wind_x": np.arange(9.0)}, interpolation
    )
    times, values = sampled([drive], start=0.0, duration=10.0, rate=7.0)
    assert len(times) == 71 + 9
    table = np.stack(list(values.values()), axis=1)
    original = logged(drive.times, np.stack(list(drive.values.values()), axis=1), interpolation)
    again = logged(times, table, interpolation)
    for time in random.uniform(0, 10, 50):
        np.testing.assert_allclose(again(time), original(time), atol=1e-5 * 8)


def test_samples_are_at_the_rate_and_end_with_the_run():
    times, values = sampled([], start=2.0, duration=25.0, rate=10.0)
    assert (len(times), times[0], times[-1], values) == (251, 2.0, 27.0, {})


@pytest.mark.parametrize(
    ("moves", "said"),
    [
        ([Move(5, 0.1, 1.0, 0.0)], "joint 5"),
        ([Move(0, 0.1, 1.0, 0.0)], "joint 0"),
        ([Move(1, 0.1, -1.0, 0.0)], "outside the run"),
        ([Move(1, 0.1, 20.0, 0.0)], "outside the run"),
        ([Move(1, 0.1, 1.0, 0.0), Move(2, 0.1, 1.0, 1.0)], "steps and ramps are mixed"),
        ([Move(1, 0.1, 1.0, 1.0), Move(1, 0.2, 1.5, 1.0)], "overlap"),
        ([Move(1, 0.1, 1.0, 0.0), Move(1, 0.2, 1.0, 0.0)], "overlap"),
        ([Move(1, np.inf, 1.0, 0.0)], "finite"),
        ([Move(1, 0.1, 1.0, -1.0)], "positive duration"),
        ([Move(1, 0.1, 1.0, np.nan)], "positive duration"),
    ],
)
def test_movements_that_cannot_be(moves, said):
    with pytest.raises(InputError, match=said):
        joint_moves(moves, joints=4, end=20.0)


@pytest.mark.parametrize(
    ("duration", "rate", "said"),
    [
        (2.55, 10.0, "use 2.6 s"),
        (0.01, 10.0, "use 0.1 s"),
        (0.0, 10.0, "contains no samples"),
        (1.0, -1.0, "contains no samples"),
        (np.nan, 1.0, "contains no samples"),
        (1.0, np.inf, "contains no samples"),
        (1e300, 1e300, "more than 1000000"),
    ],
)
def test_samples_that_cannot_be(duration, rate, said):
    with pytest.raises(InputError, match=said):
        sampled([], start=0.0, duration=duration, rate=rate)
