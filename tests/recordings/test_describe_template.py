"""The parts of `giajax check` and `giajax init`."""

import json
import re

import numpy as np
import pytest

from giajax.recordings import Definition, Run, describe, read_run, sidecar_template
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

CSV = (
    "time_s,joint01_command_deg,joint02_command_deg,link06_z_m,link12_z_cm,wind_x_m_per_s\n"
    "0,0,0,0.5,,0.2\n"
    "1,0,0,0.25,,0.2\n"
    "2,30,0,,150,0.2\n"
    "3,30,0,-1,200,0.2\n"
    "5,30,0,0,,0.2\n"
)


def test_description_of_a_run(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(CSV)
    (tmp_path / "run.toml").write_text(
        'origin = "x"\n[arm]\nlinks = 12\n[noise]\nlink12_z_cm = 2\n[truth]\na = 1\n'
    )
    facts = describe(read_run(path))
    assert json.loads(json.dumps(facts, allow_nan=False)) == facts
    assert (facts["model"], facts["rows"], facts["path"]) == ("arm", 5, str(path))
    assert facts["time"] == {
        "start_s": 0.0, "end_s": 5.0, "duration_s": 5.0, "interval_median_s": 1.0,
        "interval_min_s": 1.0, "interval_max_s": 2.0,
    }  # fmt: skip
    assert facts["command"] == {
        "channels": ["joint01_command", "joint02_command"], "joints": [1, 2],
        "moving": ["joint01_command"], "interpolation": "linear", "corners": 2,
    }  # fmt: skip
    assert facts["wind"]["channels"] == ["wind_x"]
    assert facts["sidecar"]["keys"] == ["origin", "arm.links", "noise.link12_z_cm", "truth"]
    assert facts["sidecar"]["checksum"] == "not stated"
    by_name = {channel["name"]: channel for channel in facts["channels"]}
    assert by_name["link12_z"] == {
        "name": "link12_z", "column": "link12_z_cm", "unit": "cm", "part": "measured", "count": 2,
        "missing_percent": pytest.approx(60.0), "min": 150.0, "max": 200.0, "noise": 2.0,
    }  # fmt: skip
    assert by_name["link06_z"]["noise"] is None
    assert by_name["joint01_command"]["max"] == pytest.approx(30.0)
    notes = "\n".join(facts["notes"])
    assert "noise of link06_z is not specified" in notes
    assert "wind_y and wind_z are not recorded" in notes
    assert "[arm] names no preset" in notes


def test_held_commands_have_a_corner_at_each_jump():
    definition = {"command": {"interpolation": "zoh"}}
    run = Run.from_arrays(
        np.arange(6.0), {"joint01_command": [0, 1, 1, 1, 2, 2]}, definition=definition
    )
    assert describe(run)["command"]["corners"] == 2


def test_the_force_of_an_oscillator_runs_as_its_section_says():
    times = np.arange(4.0)
    columns = {"input": [0.0, 1.0, 0.0, -1.0], "output": [0.0, 1.0, 0.0, -1.0]}
    for section, expected in (({}, ("linear", 1)), ({"interpolation": "band_limited"},
                                                    ("band_limited", 0))):  # fmt: skip
        run = Run.from_arrays(
            times, columns, definition={"model": "oscillator", "oscillator": section}
        )
        command = describe(run)["command"]
        assert (command["interpolation"], command["corners"]) == expected


def test_a_rounded_ramp_has_corners_only_at_its_ends():
    times = np.linspace(0.0, 4.0, 41)
    ramp = np.interp(times, [1.0, 2.5], [0.0, 40.0])
    rounded = np.array([float(f"{value:.6g}") for value in ramp])
    run = Run.from_arrays(times, {"joint01_command": np.radians(rounded)})
    assert describe(run)["command"]["corners"] == 2


def test_notes_say_what_is_assumed():
    facts = describe(Run.from_arrays([0.0, 1.0], {"joint01_command": [0.0, 1.0]}))
    notes = "\n".join(facts["notes"])
    for part in ["preset takeichi_20m", "straight and at rest", "still air", "linear",
                 "can be simulated, but not fitted"]:  # fmt: skip
        assert part in notes
    assert (facts["sidecar"], facts["wind"]) == (None, None)


def test_a_preset_that_no_one_named_is_said():
    """Values that come from the preset are named if they are few; with a given preset, none are."""

    def notes(**arm):
        run = Run.from_arrays([0.0, 1.0], {"joint01_command": [0.0, 1.0]}, definition={"arm": arm})
        return [note for note in describe(run)["notes"] if "preset" in note]

    assert notes(preset="takeichi_20m", links=2) == []
    (sentence,) = notes(preset="chain", links=1, link_length_m=0.5, link_diameter_m=0.1)
    assert "give link_mass_kg, joints.pitch_stiffness, joints.damping, joint_axes, and" in sentence
    assert "joints.* in [arm.parameters]" in sentence
    (sentence,) = notes(links=2, link_length_m=0.5, joint_axes="pitch_yaw")
    assert sentence.startswith("[arm] names no preset: the constants of the preset takeichi_20m")
    assert 'for example to "chain"' in sentence
    sizes = {"link_length_m": 0.5, "link_diameter_m": 0.1, "link_mass_kg": 0.1}
    joints = {"joints.pitch_stiffness": 1.0, "joints.yaw_stiffness": 1.0, "joints.damping": 0.0}
    (sentence,) = notes(**sizes, parameters=joints)
    assert ": gravity, air.drag_coefficient, joint_axes of the preset takeichi_20m" in sentence
    sizes |= {"joint_axes": ["pitch", [0.0, 1.0, 1.0]], "links": 2}
    known = joints | {"air.drag_coefficient": 1.0}
    assert notes(**sizes, gravity_m_per_s2=9.81, parameters=known) == []
    assert notes(preset="chain", **sizes, parameters=joints) == []


def test_lists_of_an_own_arm_say_how_many_links_it_has():
    arm = {"preset": "chain", "link_mass_kg": [0.1, 0.2, 0.3]}
    with pytest.raises(InputError, match="refers to link 5, but the arm has only 3 links"):
        Run.from_arrays([0.0, 1.0], {"joint01_command": [0, 1], "link05_z": [0, 1]},
                        definition={"arm": arm})  # fmt: skip


def test_assumed_muscles_of_an_own_arm_are_said():
    arm = {"preset": "chain", "muscles": "pitch", "parameters": {"geometry.anchor_x": 0.4}}
    run = Run.from_arrays([0.0, 1.0], {"joint01_command": [0.0, 1.0]}, definition={"arm": arm})
    (note,) = (note for note in describe(run)["notes"] if note.startswith("the muscles are"))
    assert "geometry.anchor_y" in note
    assert "geometry.anchor_x" not in note


def test_winds_of_some_links_are_told():
    times, definition = [0.0, 1.0], {"arm": {"links": 2}}
    names = [f"link{link:02d}_wind_{axis}" for link in (1, 2) for axis in "xyz"]
    for count, told in ((6, False), (3, True)):
        winds = {name: [0.0, 0.1] for name in names[:count]}
        run = Run.from_arrays(times, {"joint01_command": times, **winds}, definition=definition)
        notes = "\n".join(describe(run)["notes"])
        assert ("wind is not recorded for all links and axes" in notes) == told


def test_text_channels_are_counted():
    sides = {"side": ["inner", "outer", "inner"], "angle": [0.1, -0.1, 0.2]}
    run = Run.from_arrays(None, {**sides, "force": [1, 2, 3]})
    facts = describe(run)
    assert facts["channels"][0]["texts"] == {"inner": 2, "outer": 1}
    assert facts["command"] is None


def test_what_a_joint_or_a_muscle_assumes_is_told():
    joint = Run.from_arrays(None, {"angle": [0.1], "side": ["inner"], "force": [1.0]})
    told = " ".join(describe(joint)["notes"])
    assert "the default geometry of giajax" in told
    assert "torque is not recorded: 0.3 N m" in told
    channels = {"pressure": [1e5], "contraction": [0.1], "phase": ["fill"], "force": [1.0]}
    muscle = Run.from_arrays(None, channels)
    told = " ".join(describe(muscle)["notes"])
    assert "a braided muscle is assumed" in told
    assert "specifies no friction" in told
    section = {"muscle": {"law": "braided", "friction": "coulomb"}}
    stated = Run.from_arrays(None, channels, definition=section)
    assert all("noise" in note for note in describe(stated)["notes"])


def leap_notes(run):
    return [note for note in describe(run)["notes"] if "time step" in note]


def test_a_leap_of_the_time_step_is_noted_with_its_row(tmp_path):
    """This may be a change of unit: from line 6 on, the time steps are a thousand times larger."""
    path = tmp_path / "run.csv"
    rows = ["0,0", "0.01,1", "0.02,2", "0.03,3", "70,3", "80,3", "90,3"]
    path.write_text("time_s,input_m,output_m\n" + "".join(f"{row},1\n" for row in rows))
    (note,) = leap_notes(read_run(path))
    assert note.startswith("the time step changes from 0.01 s to 70 s in row 6: check the unit")
    (note,) = leap_notes(read_run(path, rename={"time_s": "time_ms"}))
    assert "from 1e-05 s to 0.07 s in row 6" in note


def test_a_gap_is_two_leaps_and_another_rate_none():
    def run(steps):
        times = np.concatenate([[0.0], np.cumsum(steps)])
        return Run.from_arrays(times, {"joint01_command": np.zeros_like(times)})

    (note,) = leap_notes(run([0.01] * 5 + [10.0] + [0.01] * 5))
    assert "from 0.01 s to 10 s in sample 6, and 1 more time after it" in note
    assert leap_notes(run([0.01] * 5 + [9.0] + [0.02] * 5)) == []
    assert leap_notes(run([0.01])) == []


PRESET = {"preset": "takeichi_20m"}


def offered(text):
    """Return the template with every offered key enabled."""
    return re.sub(r"^# (\w+ = )", r"\1", text, flags=re.MULTILINE)


@pytest.mark.parametrize(
    ("text", "stated", "keys"),
    [
        (
            CSV,
            {"model": "arm", "arm": PRESET},
            {"arm", "sensors", "initial", "command", "wind", "noise"},
        ),
        (
            "time_s,joint01_angle_deg,joint22_rate_rad_per_s\n0,1,2\n1,1,2\n",
            {"model": "arm", "free_motion": True, "arm": PRESET | {"links": 22}},
            {"arm", "sensors", "initial", "wind", "noise", "free_motion"},
        ),
        ("command_deg,angle_deg\n0,1\n", {"model": "hysteresis"}, {"hysteresis", "noise"}),
        ("angle_deg,side,force_N\n1,inner,1\n", {"model": "joint"}, {"joint", "noise"}),
        (
            "pressure_bar,contraction,phase,force_N\n1,0,fill,1\n",
            {"model": "muscle"},
            {"muscle", "noise"},
        ),
        ("force_N,angle_deg\n0,1\n", {}, set()),
    ],
    ids=["commanded", "free", "hysteresis", "joint", "muscle", "unclear"],
)
def test_every_line_of_the_template_is_legal(tmp_path, text, stated, keys):
    path = tmp_path / "run.csv"
    path.write_text(text)
    template = sidecar_template(path)
    sidecar = tmp_path / "run.toml"
    sidecar.write_text(template)
    given = Definition.load(sidecar).contents()
    # No fact of the file has to be filled in, and no other key has a value.
    assert len(given.pop("sha256")) == 64
    assert given.pop("schema_version") == 1
    assert {name: value for name, value in given.items() if value != {}} == stated
    sidecar.write_text(offered(template))
    everything = Definition.load(sidecar).contents()
    common = {"schema_version", "model", "origin", "licence", "sha256"}
    assert set(everything) == common | keys
    for section in {"hysteresis", "joint", "muscle"} & keys:
        assert set(everything[section]) == set(type(getattr(Definition(), section)).model_fields)
    if "arm" in keys:
        # A wind field is a user-defined class.
        assert {"wind_field", *everything["arm"]} == set(type(Definition().arm).model_fields)
        read_run(path)
