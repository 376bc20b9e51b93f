"""The column table: the meaning of column names, and units checked by hand."""

import math

import numpy as np
import pytest

from giajax.recordings import Channel, parse_column, parse_columns
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

# column, name, kind, index, component, quantity, unit, value as recorded, the same in SI
COLUMNS = [
    ("time_s", "time", "time", None, None, "time", "s", 2.5, 2.5),
    ("time_ms", "time", "time", None, None, "time", "ms", 2500.0, 2.5),
    ("joint01_command_deg", "joint01_command", "joint_command", 1, None, "angle", "deg", 30.0,
     math.pi / 6),
    ("joint20_angle_rad", "joint20_angle", "joint_angle", 20, None, "angle", "rad", -0.5, -0.5),
    ("joint03_rate_deg_per_s", "joint03_rate", "joint_rate", 3, None, "angular_velocity",
     "deg_per_s", 180.0, math.pi),
    ("joint03_rate_rad_per_s", "joint03_rate", "joint_rate", 3, None, "angular_velocity",
     "rad_per_s", 0.1, 0.1),
    ("link06_x_m", "link06_x", "link_position", 6, 0, "length", "m", 1.25, 1.25),
    ("link06_y_cm", "link06_y", "link_position", 6, 1, "length", "cm", 12.3, 0.123),
    ("link120_z_mm", "link120_z", "link_position", 120, 2, "length", "mm", -7.0, -0.007),
    ("tip_y_m", "tip_y", "tip_position", None, 1, "length", "m", 19.8, 19.8),
    ("wind_z_m_per_s", "wind_z", "wind", None, 2, "velocity", "m_per_s", 0.2, 0.2),
    ("input_kPa", "input", "input", None, None, "pressure", "kPa", 101.0, 101e3),
    ("output_deg_per_s", "output", "output", None, None, "angular_velocity", "deg_per_s", 90.0,
     math.pi / 2),
    ("input", "input", "input", None, None, "ratio", "", 0.4, 0.4),
    ("command_deg", "command", "command", None, None, "angle", "deg", 60.0, math.pi / 3),
    ("angle_deg", "angle", "angle", None, None, "angle", "deg", -60.0, -math.pi / 3),
    ("contraction", "contraction", "contraction", None, None, "ratio", "", 0.19, 0.19),
    ("force_mN", "force", "force", None, None, "force", "mN", 1540.0, 1.54),
    ("torque_N_m", "torque", "torque", None, None, "torque", "N_m", 0.3, 0.3),
    ("pressure_MPa", "pressure", "pressure", None, None, "pressure", "MPa", 0.1, 1e5),
    ("pressure_bar", "pressure", "pressure", None, None, "pressure", "bar", 7.0, 7e5),
    ("position_mm", "position", "position", None, None, "length", "mm", 25.7, 0.0257),
    ("side", "side", "side", None, None, "text", "", None, None),
    ("phase", "phase", "phase", None, None, "text", "", None, None),
]  # fmt: skip


@pytest.mark.parametrize("row", COLUMNS, ids=[row[0] for row in COLUMNS])
def test_a_column_means_what_the_table_says(row):
    column, name, kind, index, component, quantity, unit, recorded, si = row
    channel = parse_column(column)
    assert channel == Channel(name, kind, index, component, quantity, unit)
    assert channel.column == column
    if recorded is not None:
        np.testing.assert_allclose(channel.to_si(recorded), si, rtol=1e-15)
        np.testing.assert_allclose(channel.from_si(si), recorded, rtol=1e-15)


def test_si_units_are_the_ones_results_are_given_in():
    units = {
        "joint01_rate": "rad/s", "link01_x": "m", "wind_x": "m/s", "torque": "N m",
        "pressure": "Pa", "contraction": "", "time": "s", "joint01_angle": "rad", "force": "N",
    }  # fmt: skip
    assert {name: Channel.named(name).si_unit for name in units} == units


def test_conversion_keeps_shape_and_missing_cells():
    channel = parse_column("link01_x_cm")
    values = channel.to_si([[100.0, np.nan], [0.0, -50.0]])
    np.testing.assert_array_equal(values, [[1.0, np.nan], [0.0, -0.5]])


# The column name, and a required part of the message: the name and the remedy.
WRONG = [
    ("link06_z_ft", ["'link06_z_ft'", "'ft'", "m, cm or mm"]),
    ("link06_z", ["'link06_z'", "does not give its unit", "--rename link06_z=link06_z_m"]),
    ("Link6_Z_m", ["did you mean 'link06_z_m'", "--rename Link6_Z_m=link06_z_m"]),
    ("Link 6 z_m", ["--rename 'Link 6 z_m=link06_z_m'"]),
    ("link6_z_m", ["did you mean 'link06_z_m'"]),
    ("link006_z_m", ["did you mean 'link06_z_m'"]),
    ("link00_z_m", ["did you mean 'link01_z_m'"]),
    ("joint1_cmd_deg", ["did you mean 'joint01_command_deg'"]),
    ("joint01_command_m", ["'m'", "deg or rad"]),
    ("time_min", ["'min'", "s or ms"]),
    ("side_deg", ["side has no unit", "--rename side_deg=side"]),
    ("temperature", ["'temperature'", "jointNN_command", "--rename temperature=NEW", "remove it"]),
    ("link06_w_m", ["did you mean 'link06_"]),
    ("", ["--rename OLD=NEW"]),
    ("a\nb" * 50, ["\\n", "...", "--rename OLD=NEW"]),
]


@pytest.mark.parametrize(("column", "parts"), WRONG, ids=[repr(c)[:20] for c, _ in WRONG])
def test_what_is_not_in_the_table_is_named_with_a_remedy(column, parts):
    with pytest.raises(InputError) as caught:
        parse_column(column)
    sentence = str(caught.value)
    assert "\n" not in sentence
    for part in parts:
        assert part in sentence


def test_a_channel_comes_once():
    assert list(parse_columns(["time_s", "link06_z_m"])) == ["time_s", "link06_z_m"]
    with pytest.raises(InputError, match="'link06_z_m' and 'link06_z_cm' both give link06_z"):
        parse_columns(["link06_z_m", "time_s", "link06_z_cm"])
    with pytest.raises(InputError, match="'link06_z_m' is given twice"):
        parse_columns(["link06_z_m", "link06_z_m"])


def test_named_takes_the_channel_without_its_unit():
    assert Channel.named("link06_z").column == "link06_z_m"
    assert Channel.named("joint01_angle").unit == "rad"
    assert Channel.named("joint01_angle", "deg").column == "joint01_angle_deg"
    assert Channel.named("pressure").unit == "kPa"  # the table has no column in Pa
    assert Channel.named("output", "N").quantity == "force"
    with pytest.raises(InputError, match="SI units: rename it to 'link06_z'"):
        Channel.named("link06_z_m")
    with pytest.raises(InputError, match="did you mean 'link06_z'"):
        Channel.named("lnk06_z")
    with pytest.raises(InputError, match="m, cm or mm"):
        Channel.named("link06_z", "deg")
