"""Runs from arrays: the information for a model, and invalid arrays."""

import math

import numpy as np
import pytest

from giajax.recordings import Definition, Run
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

TIMES = [0.0, 0.1, 0.2, 0.3]
NAN = math.nan


def arm(times=TIMES, noise=None, definition=None, **values):
    values = values or {"joint01_command": [0.0, 0.5, 0.5, 0.5], "link20_z": [0.0, NAN, 1.0, 2.0]}
    return Run.from_arrays(times, values, noise=noise, definition=definition)


def test_channels_are_sorted_into_commands_winds_and_observations():
    zeros = np.zeros(4)
    names = ["joint01_command", "joint02_angle", "joint02_rate", "link06_z", "tip_x", "wind_y"]
    run = arm(**dict.fromkeys(names, zeros))
    assert run.model == "arm"
    assert list(run.commands) == ["joint01_command"]
    assert list(run.winds) == ["wind_y"]
    assert list(run.observations) == ["joint02_angle", "joint02_rate", "link06_z", "tip_x"]
    assert set(run.channels) == set(run.values) == set(names)
    assert (run.path, run.sha256, run.name) == (None, None, "run")


def test_a_run_is_frozen_and_leaves_the_callers_arrays_alone():
    mine = np.zeros(4)
    run = arm(joint01_command=mine)
    mine[0] = 7.0
    assert run.values["joint01_command"][0] == 0.0
    assert mine.flags.writeable
    with pytest.raises(ValueError, match="read-only"):
        run.values["joint01_command"][0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        run.times[0] = 1.0


@pytest.mark.parametrize(
    ("names", "model", "given", "predicted"),
    [
        (["joint01_angle", "joint01_command"], "arm", ["joint01_command"], ["joint01_angle"]),
        (["command", "angle"], "hysteresis", ["command"], ["angle"]),
        (["input", "output"], "hysteresis", ["input"], ["output"]),
        (["angle", "side", "force"], "joint", ["angle", "side"], ["force"]),
        (["pressure", "contraction", "force"], "muscle", ["pressure", "contraction"], ["force"]),
    ],
)
def test_channels_tell_the_model(names, model, given, predicted):
    values = {name: ["inner"] * 4 if name == "side" else [0.0, 0.1, 0.2, 0.3] for name in names}
    run = Run.from_arrays(TIMES if model == "arm" else None, values)
    assert run.model == model
    assert list(run.commands) == given
    assert list(run.observations) == predicted


def test_noise_of_a_column_wins_over_its_quantity():
    run = arm(
        definition={"noise": {"position_m": 0.02, "link06_z_cm": 5.0, "angle_deg": 90.0}},
        joint01_command=np.zeros(4),
        link06_z=np.zeros(4),
        tip_x=np.zeros(4),
        joint01_angle=np.zeros(4),
        joint01_rate=np.zeros(4),
    )
    assert run.noise("link06_z") == pytest.approx(0.05, rel=1e-15)
    assert run.noise("tip_x") == 0.02
    assert run.noise("joint01_angle") == pytest.approx(math.pi / 2, rel=1e-15)
    assert run.noise("joint01_rate") is None
    assert run.noise("joint01_command") is None
    with pytest.raises(KeyError):
        run.noise("link07_z")


def test_noise_given_to_from_arrays_is_in_si_units():
    run = arm(
        noise={"position": 0.01, "angle": 0.02, "rate": 0.03, "tip_x": 0.04},
        joint01_command=np.zeros(4),
        link06_z=np.zeros(4),
        tip_x=np.zeros(4),
        joint01_angle=np.zeros(4),
        joint01_rate=np.zeros(4),
    )
    names = ["link06_z", "joint01_angle", "joint01_rate", "tip_x"]
    found = [run.noise(name) for name in names]
    np.testing.assert_allclose(found, [0.01, 0.02, 0.03, 0.04], rtol=1e-15)
    # The argument takes precedence over the definition, and the run keeps it.
    run = arm(noise={"position": 0.01}, definition={"noise": {"position_m": 1.0}, "origin": "x"})
    assert (run.definition.noise.position_m, run.definition.origin) == (0.01, "x")


def test_free_motion_needs_to_be_said():
    angles = {"joint01_angle": [1.0, 0.9, 0.7, 0.5]}
    with pytest.raises(InputError, match="no command column"):
        Run.from_arrays(TIMES, angles)
    with pytest.raises(InputError, match="no command column"):
        Run.from_arrays(TIMES, angles, definition={"free_motion": False})
    for definition in ({"free_motion": True}, {"initial": {"angle_deg": 60}}):
        assert Run.from_arrays(TIMES, angles, definition=definition).commands == {}
    with pytest.raises(InputError, match="free_motion = true is set, but the run has command"):
        arm(definition={"free_motion": True})


def test_require_observations():
    arm().require_observations()
    run = arm(joint01_command=np.zeros(4))
    with pytest.raises(InputError, match="no measured channel to fit"):
        run.require_observations()


def test_static_runs_have_no_times():
    run = Run.from_arrays(None, {"side": ["inner", "outer"], "angle": [0.1, -0.1],
                                 "force": [1.5, NAN]})  # fmt: skip
    assert run.times is None
    assert run.values["side"].dtype == object
    assert list(run.values["side"]) == ["inner", "outer"]
    single = {"pressure": [1e5], "contraction": [0.1], "force": [2.0]}
    assert len(Run.from_arrays(None, single).values["force"]) == 1


COMMAND = {"joint01_command": [0.0, 0.1, 0.2, 0.3]}
# times, values, definition, and a required part of the message
WRONG = {
    "time repeats": ([0, 1, 1, 2], COMMAND, {}, ["sample 2", "from 1 s to 1 s", "increase"]),
    "time falls": ([0, 1, 0.5, 2], COMMAND, {}, ["sample 2", "from 1 s to 0.5 s"]),
    "time missing": ([0, NAN, 1, 2], COMMAND, {}, ["sample 1", "empty"]),
    "time infinite": ([0, 1, 2, math.inf], COMMAND, {}, ["sample 3", "infinite"]),
    "no sample times": (None, COMMAND, {}, ["no sample times", "arm run"]),
    "one sample": ([0.0], {"joint01_command": [0.0]}, {}, ["1 sample,", "at least 2"]),
    "no sample": ([], {"joint01_command": []}, {}, ["0 samples", "at least 2"]),
    "no channel": (TIMES, {}, {}, ["only a time column"]),
    "lengths": (TIMES, {"joint01_command": [0.0, 1.0]}, {}, ["has 2 samples", "must have 4"]),
    "shape": (TIMES, {"joint01_command": np.zeros((4, 1))}, {}, ["(4, 1)", "one dimension"]),
    "text": (TIMES, {"joint01_command": ["a"] * 4}, {}, ["joint01_command", "numbers"]),
    "complex": (TIMES, {"joint01_command": [1j] * 4}, {}, ["joint01_command", "numbers"]),
    "unit": (TIMES, {"joint01_command_deg": [0.0] * 4}, {}, ["rename it to 'joint01_command'"]),
    "unknown": (TIMES, {"link6_z": [0.0] * 4}, {}, ["did you mean 'link06_z'"]),
    "time twice": (TIMES, {"time": TIMES, **COMMAND}, {}, ["'time'", "first argument"]),
    "nothing measured": (TIMES, {**COMMAND, "tip_x": [NAN] * 4}, {}, ["'tip_x'", "no value"]),
    "infinite": (TIMES, {**COMMAND, "tip_x": [0, 1, math.inf, NAN]}, {}, ["'tip_x'", "sample 2"]),
    "gap in command": (TIMES, {"joint01_command": [0, NAN, 1, 1]}, {},
                       ["'joint01_command'", "sample 1", "fill the gap"]),
    "gap in wind": (TIMES, {**COMMAND, "wind_x": [0, 0, 0, NAN]}, {}, ["'wind_x'", "sample 3"]),
    "link": (TIMES, {**COMMAND, "link21_z": [0.0] * 4}, {}, ["link 21", "20 links"]),
    "joint": (TIMES, {"joint04_command": [0.0] * 4}, {"arm": {"links": 3}},
              ["joint 4", "3 links"]),
    "lists": (TIMES, COMMAND, {"arm": {"link_mass_kg": [1, 2]}}, ["link_mass_kg has 2", "is 20"]),
    "initial": (TIMES, COMMAND, {"initial": {"rate_deg_per_s": [1, 2]}},
                ["initial.rate_deg_per_s has 2", "20 joints"]),
    "two winds": (TIMES, {**COMMAND, "wind_x": [0.0] * 4},
                  {"wind": {"velocity_m_per_s": [0, 0, 1]}}, ["constant wind", "'wind_x'"]),
    "noise": (TIMES, COMMAND, {"noise": {"tip_x_m": 0.1}}, ["'tip_x_m'", "measured column"]),
    "noise of command": (TIMES, COMMAND, {"noise": {"joint01_command_deg": 1}}, ["measured"]),
    "model": (TIMES, COMMAND, {"model": "muscle"}, ["'muscle'", "belongs to the model 'arm'"]),
    "foreign": (TIMES, {**COMMAND, "pressure": [1.0] * 4}, {}, ["'pressure_kPa'", "'arm'"]),
    "no model": (None, {"force": [1.0] * 4}, {}, ["do not determine the model", 'model = "..."']),
    "side": (None, {"side": ["inner", "left"], "force": [1, 2]}, {}, ["'left'", "inner or outer"]),
    "key": (TIMES, COMMAND, {"arm": {"lings": 3}}, ["arm.lings", "arm.links"]),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_no_model_could_use_is_one_sentence(case):
    times, values, definition, parts = WRONG[case]
    with pytest.raises(InputError) as caught:
        Run.from_arrays(times, values, name="mine", definition=definition)
    assert "\n" not in str(caught.value)
    for part in parts:
        assert part in str(caught.value)


def test_noise_of_something_else_is_refused():
    sentence = r"'length' has no noise: give the noise of position, angle, rate"
    with pytest.raises(InputError, match=sentence):
        arm(noise={"length": 0.1})
    with pytest.raises(InputError, match="positive"):
        arm(noise={"position": -0.1})


def test_an_unknown_preset_has_an_unknown_number_of_links():
    definition = Definition.parse({"arm": {"preset": "mine"}})
    assert arm(definition=definition, joint31_command=np.zeros(4)).model == "arm"
