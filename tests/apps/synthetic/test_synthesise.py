"""Runs simulated by a model: the recorded channels, and the same motion after reading back."""

import numpy as np
import pytest

from giajax import (
    ArmModel,
    InputError,
    SimulationError,
    model_for,
    read_run,
    takeichi_20m,
    write_run,
)
from giajax.apps.synthetic import Move, joint_moves, sampled, synthesise
from giajax.fitting import predict
from giajax.models import arm_from_definition
from giajax.recordings import Definition

CHANNELS = ("joint02_angle", "link03_z", "tip_x", "tip_y", "tip_z")
MOVES = (Move(1, 0.5, 0.5, 1.0), Move(2, -0.3, 0.77, 1.0))


@pytest.fixture(scope="module")
def model():
    return ArmModel(takeichi_20m(3))


def rows(moves=MOVES, duration=4.0):
    drive = joint_moves(list(moves), joints=3, end=duration)
    return sampled([drive], start=0.0, duration=duration, rate=20.0)


@pytest.fixture(scope="module")
def clean(model):
    times, inputs = rows()
    return synthesise(model, times, inputs, CHANNELS)


def noisy(model, **options):
    times, inputs = rows()
    options = {"noise": {"position": 0.02, "angle": 0.01}, **options}
    return synthesise(model, times, inputs, options.pop("channels", CHANNELS), **options)


def test_a_run_states_its_arm(clean, model):
    assert (clean.model, list(clean.observations)) == ("arm", list(CHANNELS))
    assert clean.definition.arm.links == 3
    made = model_for([clean])
    assert made.definition()["arm"] == model.definition()["arm"]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("moves", "interpolation"),
    [
        ((Move(1, 0.5, 0.51, 1.003), Move(2, -0.3, 0.77, 1.0)), "linear"),
        ((Move(1, 0.5, 0.5, 0.0), Move(2, -0.3, 0.777, 0.0)), "zoh"),
    ],
)
def test_what_is_written_is_read_as_the_same_motion(tmp_path, model, moves, interpolation):
    times, inputs = rows(moves)
    definition = {"command": {"interpolation": interpolation}}
    made = synthesise(model, times, inputs, CHANNELS, definition=definition)
    path = write_run(tmp_path / "run.csv", made.times, made.values, definition=made.definition)
    run = read_run(path)
    predicted = predict(ArmModel(arm_from_definition(run.definition)), run)
    assert np.ptp(run.values["tip_z"]) > 0.5
    for name, values in run.observations.items():
        np.testing.assert_allclose(values, predicted[name], atol=2e-7)


def test_noise_is_white_and_as_large_as_stated(model, clean):
    run = noisy(model)
    assert run.noise("tip_x") == pytest.approx(0.02)
    assert run.noise("joint02_angle") == pytest.approx(0.01)
    for name in CHANNELS:
        error = (run.values[name] - clean.values[name]) / run.noise(name)
        # The tolerance is four standard deviations of each estimate, for about 80 samples.
        count = len(error)
        assert abs(error.mean()) < 4 / np.sqrt(count)
        assert abs(error.std() - 1) < 4 / np.sqrt(2 * count)
        assert abs(np.mean(error[1:] * error[:-1])) < 4 / np.sqrt(count)


@pytest.mark.slow
def test_the_noise_of_a_channel_depends_on_the_seed_and_its_name_alone(model):
    run = noisy(model, missing=0.2)
    same = noisy(model, missing=0.2, channels=("tip_z", "tip_x", "link01_y"))
    other = noisy(model, missing=0.2, seed=1)
    # Not bit for bit, because another set of channels is another program with other rounding.
    np.testing.assert_allclose(run.values["tip_z"], same.values["tip_z"], rtol=0, atol=1e-12)
    assert not np.allclose(np.nan_to_num(run.values["tip_z"]), np.nan_to_num(other.values["tip_z"]))
    error = run.values["tip_z"] - noisy(model).values["tip_z"]
    np.testing.assert_array_equal(error[~np.isnan(error)], 0)


def test_gaps_leave_every_channel_a_value(model):
    count = len(rows()[0])
    for missing in (0.0, 0.1, 0.999):
        run = noisy(model, missing=missing)
        for values in run.observations.values():
            assert np.isnan(values).sum() == int(missing * count)
        for values in run.commands.values():
            assert not np.isnan(values).any()


def test_noise_of_the_definition_counts_too(model):
    times, inputs = rows()
    definition = Definition.parse({"noise": {"tip_x_m": 0.5}})
    run = synthesise(model, times, inputs, CHANNELS, definition=definition)
    assert (
        np.diff(run.values["tip_x"], 2).std() > 0.5 > 0.05 > np.diff(run.values["tip_z"], 2).std()
    )


@pytest.mark.parametrize("missing", [-0.1, 1.0, np.nan])
def test_a_fraction_that_is_none(model, missing):
    with pytest.raises(InputError, match="missing fraction"):
        noisy(model, missing=missing)


def test_channels_that_the_arm_does_not_have(model):
    with pytest.raises(InputError, match=r"link 4.*3 links"):
        noisy(model, channels=("link04_x",))
    with pytest.raises(InputError, match=r"'wind_x' is an input of the model"):
        noisy(model, channels=("wind_x",))


@pytest.mark.slow
def test_a_simulation_that_fails():
    times, inputs = rows()
    with pytest.raises(SimulationError, match="step limit"):
        synthesise(ArmModel(takeichi_20m(3), max_steps=5), times, inputs, ["tip_z"])
