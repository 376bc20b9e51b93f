"""The TOML vocabulary: every key is read, wrong keys are named, given values are preserved."""

import datetime
import tomllib

import numpy as np
import pytest

from giajax.recordings import Definition, oddities, read_run, to_toml
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

FULL = """
schema_version = 1
model = "arm"
origin = "by hand: \\"quoted\\", \\\\ and ü"
licence = "MIT"
sha256 = "1ab6f569574f32b8c1a02be82fa8a87a956d5a341ca979a34305fc1ce45e979d"
free_motion = false
[arm]
preset = "takeichi_20m"
links = 3
link_length_m = [1, 0.5, 0.25]
link_diameter_m = 0.3
link_mass_kg = [0.1, 0.2, 0.3]
link_inertia_transverse_kg_m2 = 4e-3
link_inertia_axial_kg_m2 = 0
link_centre_of_mass_m = -0.1
joint_axes = ["pitch", "yaw", [1, 0, 0]]
base_rotation_deg = [0, -90, 0]
air_density_kg_per_m3 = 1.2
gravity_m_per_s2 = 9.81
[sensors]
camera_rotation_deg = [0, 5, 0]
camera_origin_m = [0, 0.1, 0]
camera_scale = 1.01
camera_delay_s = -0.1
marker_along_m = 0.1
marker_left_m = [0.1, 0, -0.1]
marker_up_m = 0.15
marker_tip_m = [0, 0, 0.1]
encoder_offset_deg = [1, 2, 3]
encoder_scale = 1
encoder_delay_s = 0.02
[initial]
angle_deg = [10, 20, 30]
rate_deg_per_s = 0
[command]
interpolation = "zoh"
[wind]
interpolation = "zoh"
velocity_m_per_s = [0, 0.2, 0]
[noise]
position_m = 0.01
angle_deg = 0.5
rate_deg_per_s = 1.0
link03_z_cm = 2
[truth]
note = "free"
when = 2024-05-01
nested = {a = 1, b = [1, 2]}
[fit]
data = ["a.csv", "../b.csv"]
free = ["air.drag_coefficient"]
loss = "huber"
out = "result"
start = {"air.drag_coefficient" = 0.6}
[fit.fix]
joints.damping = 0.05
"links.mass[2]" = 0.1
[figures."air.drag_coefficient"]
value = 1.05
standard_errors = 2.5
relative_error = 0.015
[figures."joints.yaw_stiffness"]
determined = false
"""


def loaded(tmp_path, text, name="run.toml"):
    path = tmp_path / name
    path.write_text(text, encoding="utf-8")
    return Definition.load(path)


def test_every_key_is_read(tmp_path):
    d = loaded(tmp_path, FULL)
    assert (d.model, d.licence, d.free_motion) == ("arm", "MIT", False)
    assert d.origin == 'by hand: "quoted", \\ and ü'
    assert d.arm.link_length_m == [1.0, 0.5, 0.25]
    assert d.arm.joint_axes == ["pitch", "yaw", [1.0, 0.0, 0.0]]
    assert (d.arm.links, d.arm.link_diameter_m, d.arm.gravity_m_per_s2) == (3, 0.3, 9.81)
    assert d.sensors.camera_rotation_deg == [0.0, 5.0, 0.0]
    assert (d.sensors.camera_delay_s, d.sensors.encoder_offset_deg) == (-0.1, [1.0, 2.0, 3.0])
    assert d.initial.angle_deg == [10.0, 20.0, 30.0]
    assert (d.command.interpolation, d.wind.interpolation) == ("zoh", "zoh")
    assert d.wind.velocity_m_per_s == [0.0, 0.2, 0.0]
    assert (d.noise.position_m, d.noise.columns) == (0.01, {"link03_z_cm": 2.0})
    assert d.truth["nested"] == {"a": 1, "b": [1, 2]}
    assert d.fit.data == ["a.csv", "../b.csv"]
    assert d.fit.start == {"air.drag_coefficient": 0.6}
    # For TOML, an unquoted dotted path is a nested table, but it means the same path.
    assert d.fit.fix == {"joints.damping": 0.05, "links.mass[2]": 0.1}
    assert d.figures["air.drag_coefficient"].standard_errors == 2.5
    assert d.figures["joints.yaw_stiffness"].determined is False


def test_to_toml_and_load_return_what_was_given(tmp_path):
    first = loaded(tmp_path, FULL)
    second = loaded(tmp_path, first.to_toml(), "again.toml")
    assert second.contents() == first.contents()
    assert second.to_toml() == first.to_toml()
    assert first.truth["when"] == datetime.date(2024, 5, 1)
    # Integers in place of floats become floats, and keys that were not given stay absent.
    assert Definition.parse({"noise": {"position_m": 1}}).contents() == {
        "noise": {"position_m": 1.0}
    }


def test_nothing_given_is_an_empty_definition():
    d = Definition()
    assert d.contents() == {}
    assert d.arm.links is None
    assert d.command.interpolation == "linear"
    assert d.to_toml() == "schema_version = 1\n"


def test_the_upper_definition_wins_key_by_key():
    below = Definition.parse(
        {
            "origin": "x",
            "arm": {"links": 3, "link_mass_kg": 0.1},
            "command": {"interpolation": "zoh"},
            "noise": {"position_m": 0.01, "link01_x_m": 0.1},
            "fit": {"start": {"a": 1.0, "b": 2.0}, "free": ["a"]},
            "figures": {"a": {"determined": False}},
        }
    )
    above = Definition.parse(
        {
            "arm": {"link_mass_kg": 0.2},
            "noise": {"link01_x_m": 0.2},
            "fit": {"start": {"b": 3.0}, "free": ["b"]},
            "figures": {"a": {"relative_error": 0.1}},
        }
    )
    merged = below.merged_with(above)
    assert merged.origin == "x"
    assert (merged.arm.links, merged.arm.link_mass_kg) == (3, 0.2)
    # A default of the overriding definition does not override a given value.
    assert merged.command.interpolation == "zoh"
    assert (merged.noise.position_m, merged.noise.columns) == (0.01, {"link01_x_m": 0.2})
    assert (merged.fit.start, merged.fit.free) == ({"a": 1.0, "b": 3.0}, ["b"])
    assert merged.figures["a"].relative_error == 0.1
    assert merged.figures["a"].determined is None
    assert below.arm.link_mass_kg == 0.1


def test_two_definitions_that_contradict_each_other_are_refused():
    lists = Definition.parse({"arm": {"link_mass_kg": [0.1, 0.2]}})
    with pytest.raises(InputError, match=r"link_mass_kg has 2 values.*links is 3"):
        lists.merged_with(Definition.parse({"arm": {"links": 3}}))


def test_arrays_and_tuples_of_a_notebook_are_lists():
    d = Definition.parse({"arm": {"links": np.int64(2), "link_mass_kg": np.array([0.1, 0.2])}})
    assert (d.arm.links, d.arm.link_mass_kg) == (2, [0.1, 0.2])
    assert Definition.parse({"wind": {"velocity_m_per_s": (0, 0, 1)}}).wind.velocity_m_per_s == [
        0.0, 0.0, 1.0,
    ]  # fmt: skip


def test_gravity_that_a_fit_found_a_little_below_zero_is_read_again(tmp_path):
    """An arm that swings freely in it passes the check, like one with balanced weight and lift."""
    (tmp_path / "run.csv").write_text(
        "time_s,tip_z_m\n" + "".join(f"{k},{0.1 * np.cos(0.2 * k)}\n" for k in range(90))
    )
    text = 'schema_version = 1\nmodel = "arm"\nfree_motion = true\n[arm]\nlinks = 2\n'
    text += "link_length_m = 1.0\ngravity_m_per_s2 = -0.05\n"
    assert loaded(tmp_path, text).arm.gravity_m_per_s2 == -0.05
    oddities(read_run(tmp_path / "run.csv"))


# The input, and a required part of the message.
WRONG = [
    ('[arm]\nlink_lenght_m = 1', ["unknown key arm.link_lenght_m", "arm.link_length_m?"]),
    ("[arms]\nlinks = 3", ["unknown key arms", "did you mean arm?"]),
    ("links = 3", ["unknown key links", "belongs in [arm]"]),
    ("[arm]\nsha256 = 3", ["unknown key arm.sha256", "top of the file"]),
    ("[arm]\ncolour = 3", ["unknown key arm.colour", "giajax init"]),
    ("arm = 3", ["[arm] must be a table"]),
    ("[arm]\nlinks = 2.5", ["arm.links = 2.5", "whole number"]),
    ("[arm]\nlinks = 0", ["arm.links = 0", "from 1 to 1000"]),
    ("[arm]\nlinks = true", ["arm.links = true", "whole number"]),
    ("[arm]\nlink_length_m = 0", ["arm.link_length_m = 0", "positive number"]),
    ("[arm]\nlink_length_m = nan", ["arm.link_length_m = nan", "positive number"]),
    ("[arm]\nlink_mass_kg = inf", ["arm.link_mass_kg = inf", "positive number"]),
    ('[arm]\nlink_mass_kg = "0.1"', ["arm.link_mass_kg = '0.1'", "positive number"]),
    ("[arm]\nlink_mass_kg = true", ["arm.link_mass_kg = true", "positive number"]),
    ("[arm]\nlinks=2\nlink_mass_kg = [1, -1]", ["arm.link_mass_kg = [1, -1]", "one for each link"]),
    ("[arm]\nlinks = 2\nlink_mass_kg = [1]", ["link_mass_kg has 1 values", "links is 2"]),
    ("[arm]\nlink_mass_kg = [1]\nlink_length_m = [1, 2]",
     ["link_mass_kg has 1 values", "link_length_m has 2"]),
    ("[arm]\nlinks = 2\njoint_axes = ['yaw']", ["joint_axes has 1 values", "links is 2"]),
    ("[arm]\njoint_axes = ['yaw', 'roll']", ["arm.joint_axes", "'roll'", '"pitch_yaw"']),
    ("[arm]\njoint_axes = [[0, 0, 0]]", ["arm.joint_axes", "non-zero length"]),
    ("[arm]\nbase_rotation_deg = [1, 2]", ["base_rotation_deg = [1, 2]", "three numbers"]),
    ("[arm]\ngravity_m_per_s2 = -9.81", ["gravity_m_per_s2 = -9.81", "acts along -z"]),
    ("[initial]\nfree = 1", ["initial.free = 1", "true or false"]),
    ("[initial]\nfirst_row = true\nangle_deg = 1", ["must be set only once"]),
    ("[[arm.point_masses]]\nlink = 1\nmass_kg = 0.1", ["position_m"]),
    ("[[arm.point_masses]]\nlink = 0\nmass_kg = 0.1\nposition_m = 1", ["link = 0"]),
    ("[arm]\nstrip_points = 0", ["arm.strip_points = 0", "from 1 to 20"]),
    ("[arm]\ndrag = 'tip'", ["arm.drag = 'tip'", "centre"]),
    ("[initial]\nangle_deg = 'up'", ["initial.angle_deg = 'up'", "a number or a list"]),
    ("[command]\ninterpolation = 'cubic'", ["command.interpolation = 'cubic'", '"linear"']),
    ("[wind]\nvelocity_m_per_s = 0.2", ["wind.velocity_m_per_s = 0.2", "three numbers"]),
    ("[noise]\nposition_m = 0", ["noise.position_m = 0", "positive"]),
    ("[noise]\nposition = 0.1", ["[noise] key 'position'", "position_m"]),
    ("[noise]\nlink06_z = 0.1", ["[noise] key 'link06_z'", "a column of the run"]),
    ("[noise]\nlink06_z_m = -1", ["noise.link06_z_m = -1", "positive"]),
    ("[fit]\nloss = 'cauchy'", ["fit.loss = 'cauchy'", '"soft_l1"']),
    ("[fit]\ndata = 'a.csv'", ["fit.data = 'a.csv'", "list of file names"]),
    ("[fit.start]\nair.drag_coefficient = 'x'", ['fit.start."air.drag_coefficient" = \'x\'']),
    ("[figures.a]\nvalu = 1", ["unknown key figures.a.valu", "did you mean figures.a.value?"]),
    ("[figures.a]\nvalue = 1", ["[figures.a]", "standard_errors"]),
    ("[figures.a]\ndetermined = false\nrelative_error = 0.1", ["[figures.a]", "determined"]),
    ("[figures]\na = 3", ["[figures.a] must be a table"]),
    ("schema_version = 2", ["schema_version = 2", "must be 1"]),
    ("model = 'leg'", ["model = 'leg'", '"hysteresis"']),
    ("sha256 = 'abc'", ["sha256 = 'abc'", "64 hexadecimal"]),
    ("free_motion = 1", ["free_motion = 1", "true or false"]),
    ("this is not toml", ["not valid TOML", "line 1"]),
]  # fmt: skip


@pytest.mark.parametrize(("text", "parts"), WRONG, ids=[text for text, _ in WRONG])
def test_a_wrong_key_or_value_is_one_sentence(tmp_path, text, parts):
    with pytest.raises(InputError) as caught:
        loaded(tmp_path, text)
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "pydantic" not in sentence
    assert len(sentence) < 300 + len(str(tmp_path))
    for part in [str(tmp_path / "run.toml"), *parts]:
        assert part in sentence


def test_files_that_are_no_definition(tmp_path):
    with pytest.raises(InputError, match="does not exist"):
        Definition.load(tmp_path / "none.toml")
    with pytest.raises(InputError, match="cannot be read"):
        Definition.load(tmp_path)
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not text"):
        Definition.load(tmp_path / "binary.toml")
    (tmp_path / "bom.toml").write_bytes(b'\xef\xbb\xbfmodel = "arm"\r\n')
    assert Definition.load(tmp_path / "bom.toml").model == "arm"


def test_toml_text_is_read_back_by_the_standard_library():
    data = {
        "text": 'a "b"\n\t\\ \x7f é',
        "number": 1e-7,
        "whole": -3,
        "yes": True,
        "list": [1.5, [2, "x"], {"k": 1}],
        "none": None,
        "odd key.with dot": 1,
        "empty": {},
        "table": {"x": 1, "inner": {"air.drag": 2.5}},
        "last": "plain values stay above tables",
    }
    expected = {name: value for name, value in data.items() if name != "none"}
    assert tomllib.loads(to_toml(data)) == expected
    with pytest.raises(InputError, match=r"truth\.a is nan"):
        to_toml({"truth": {"a": float("nan")}})
