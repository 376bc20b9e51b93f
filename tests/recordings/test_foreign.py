"""Tables of other programs, in their documented forms, and broken ones."""

import re

import numpy as np
import pytest

from giajax import InputError
from giajax.cli import main
from giajax.recordings import (
    ImportSettings,
    channels_of,
    filmed_beside,
    read_beside,
    read_foreign,
    read_table,
)

# Tracker 6, File > Export > Data (ExportDataDialog.java): a delimiter, names, and the columns of
# each track; only the first rows end with a delimiter. With one track, its name precedes the
# others.
TRACKER = (
    "#multi:\n\telbow\t\ttip of it\t\t\n"
    "t\tx\ty\tx\ty\t\n"
    "0.000000E0\t1.500000E0\t0.000000E0\t2.000000E0\t1.000000E-1\n"
    "4.000000E-2\t\t\t1.990000E0\t2.000000E-1\n"
    "1.200000E-1\t1.480000E0\t1.500000E-1\t1.980000E0\t3.000000E-1\n"
)
TRACKER_ONE = "mass_A\nt\tx\ty\tpixelx\tpixely\n0\t1.5\t-0.5\t10\t20\n0.04\t1.6\t-0.6\t11\t21\n"
# SLEAP, sleap_io.save_csv(format="sleap"): a row for each track and frame, including empty ones.
SLEAP = (
    "track,frame_idx,instance.score,elbow.x,elbow.y,elbow.score,tip.x,tip.y,tip.score\n"
    "arm,0,0.95,100.5,200.25,0.98,150.0,250.0,0.92\n"
    "arm,1,0.94,101.0,201.0,0.40,151.0,251.0,0.91\n"
    "arm,3,,,,,152.0,252.0,0.90\n"
)
# anipose, triangulate.py: x, y, z, error, ncams, score of each point, then M, center and fnum.
ANIPOSE = (
    "tip-end_x,tip-end_y,tip-end_z,tip-end_error,tip-end_ncams,tip-end_score,"
    "M_00,M_01,M_02,center_0,center_1,center_2,fnum\n"
    "1000.0,20.0,-300.0,0.5,3.0,0.99,1.0,0.0,0.0,0.0,0.0,0.0,0\n"
    "1001.0,21.0,-301.0,0.5,3.0,0.10,1.0,0.0,0.0,0.0,0.0,0.0,1\n"
)
# Motive 2 and 3, docs.optitrack.com, Data Export: CSV. An occlusion is a blank cell.
MOTIVE = (
    "Format Version,1.23,Take Name,Take 1,Capture Frame Rate,120.000000,Rotation Type,Quaternion,"
    "Length Units,Millimeters,Coordinate Space,Global\n"
    "\n"
    ",Type,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,"
    "Marker,Marker,Marker\n"
    ",Name,Arm,Arm,Arm,Arm,Arm,Arm,Arm,Arm,Arm:Tip,Arm:Tip,Arm:Tip\n"
    ",ID,A1,A1,A1,A1,A1,A1,A1,A1,B2,B2,B2\n"
    ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error,"
    "Position,Position,Position\n"
    "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z\n"
    "0,0.000000,0,0,0,1,100.0,200.0,300.0,0.1,1000.0,2000.0,3000.0\n"
    "1,0.008333,0,0,0,1,101.0,201.0,301.0,0.1,,,\n"
)
# phyphox, DataExport.java: quoted names with units, numbers as 0.000000000E0.
PHYPHOX = (
    '"Time (s)","Gyroscope x (rad/s)","Gyroscope y (rad/s)","Gyroscope z (rad/s)",'
    '"Absolute (rad/s)"\n'
    "1.000000000E-2,1.000000000E-1,2.000000000E-1,3.000000000E-1,4.000000000E-1\n"
    "2.100000000E-2,1.100000000E-1,2.100000000E-1,3.100000000E-1,4.100000000E-1\n"
    "NaN,NaN,NaN,NaN,NaN\n"
)
# Kinovea, ExporterTXTTrajectory.cs: a section for each track, with spaces between cells.
KINOVEA = (
    "#Kinovea Trajectory data export\n#T X Y\n\n# elbow\n0 100.5 20.25\n40 101 21\n\n\n"
    "# tip\n40 -5 300\n80 -6 301\n\n"
)
# A take with rigid bodies only, whose last column has no axis.
BODY = "\n".join(
    line if "Version" in line else ",".join(line.split(",")[:10]) for line in MOTIVE.split("\n")
)
COLUMNS = "t;joint01_command_deg;z of tip;note\n0;0;1,5;a\n0,1;10;1,6;b\n0,2;20;;c\n"
DEEPLABCUT = (
    "scorer,s,s,s\nbodyparts,tip,tip,tip\ncoords,x,y,likelihood\n0,10.5,20.5,0.9\n1,11.5,21.5,0.9\n"
)
DEEP = "scorer,s,s,s\nbodyparts,tip,tip,tip\ncoords,x,y,z\n0,10,20,30\n1,11,21,31\n"


def write(folder, text, name="table.csv"):
    path = folder / name
    path.write_text(text, newline="")
    return path


def german(text, separator=";"):
    """Return the text as a German spreadsheet saves it, with rows of equal length."""
    text = text.replace(",", separator).replace("\t", separator)
    lines = re.sub(r"(?<=[0-9])\.(?=[0-9])", ",", text).splitlines()
    width = max(line.count(separator) for line in lines)
    return "".join(line + separator * (width - line.count(separator)) + "\r\n" for line in lines)


# Text, options, assignment of columns, times, and channels in SI units.
FILES = {
    "Tracker": (
        TRACKER, {"unit": "cm"}, {"tip of it": "tip", "elbow": "link01"}, [0, 0.04, 0.12],
        {"tip_x": [0.02, 0.0199, 0.0198], "tip_z": [0.001, 0.002, 0.003],
         "link01_x": [0.015, np.nan, 0.0148], "link01_z": [0, np.nan, 0.0015]},
    ),
    "Tracker, one track in pixels": (
        TRACKER_ONE, {}, {"mass_A/pixel": "tip"}, [0, 0.04], {"tip_u": [10, 11], "tip_v": [20, 21]},
    ),
    "Tracker, not calibrated": (
        TRACKER_ONE, {"origin": (5.0, 100.0)}, {"mass_A": "tip"}, [0, 0.04],
        {"tip_u": [6.5, 6.6], "tip_v": [100.5, 100.6]},
    ),
    "Tracker, from above": (
        TRACKER_ONE, {"unit": "m", "axes": ("x", "-y")}, {"mass_A": "tip"}, [0, 0.04],
        {"tip_x": [1.5, 1.6], "tip_y": [0.5, 0.6]},
    ),
    "SLEAP": (
        SLEAP, {"frame_rate": 50.0}, {"elbow": "link01", "tip": "tip"}, [0, 0.02, 0.06],
        {"link01_u": [100.5, np.nan, np.nan], "link01_v": [200.25, np.nan, np.nan],
         "tip_u": [150, 151, 152], "tip_v": [250, 251, 252]},
    ),
    "anipose": (
        ANIPOSE, {"frame_rate": 10.0, "unit": "mm"}, {"tip-end": "tip"}, [0, 0.1],
        {"tip_x": [1, np.nan], "tip_y": [0.02, np.nan], "tip_z": [-0.3, np.nan]},
    ),
    "OptiTrack Motive": (
        MOTIVE, {}, {"Arm:Tip": "tip", "Arm": "link01"}, [0, 0.008333],
        {"tip_x": [1, np.nan], "tip_y": [-3, np.nan], "tip_z": [2, np.nan],
         "link01_x": [0.1, 0.101], "link01_y": [-0.3, -0.301], "link01_z": [0.2, 0.201]},
    ),
    "OptiTrack Motive, no markers": (
        BODY, {}, {"Arm": "link01"}, [0, 0.008333],
        {"link01_x": [0.1, 0.101], "link01_y": [-0.3, -0.301], "link01_z": [0.2, 0.201]},
    ),
    "phyphox": (
        PHYPHOX, {}, {"Gyroscope": "imu02", "Gyroscope y": "joint01_rate"}, [0.01, 0.021],
        {"imu02_gyro_x": [0.1, 0.11], "imu02_gyro_y": [0.2, 0.21], "imu02_gyro_z": [0.3, 0.31],
         "joint01_rate": [0.2, 0.21]},
    ),
    "Kinovea as text": (
        KINOVEA, {"time_unit": "ms", "origin": (10.0, 1079.0)}, {"elbow": "link01", "tip": "tip"},
        [0, 0.04, 0.08],
        {"link01_u": [110.5, 111, np.nan], "link01_v": [1058.75, 1058, np.nan],
         "tip_u": [np.nan, 5, 4], "tip_v": [np.nan, 779, 778]},
    ),
    "DeepLabCut in space": (
        DEEP, {"frame_rate": 10.0, "unit": "mm"}, {"tip": "tip"}, [0, 0.1],
        {"tip_x": [0.01, 0.011], "tip_y": [0.02, 0.021], "tip_z": [0.03, 0.031]},
    ),
    "a table": (
        COLUMNS, {"rename": {"t": "time_s", "z of tip": "tip_z_mm"}, "ignore": ["note"]}, {},
        [0, 0.1, 0.2],
        {"joint01_command": np.deg2rad([0, 10, 20]), "tip_z": [0.0015, 0.0016, np.nan]},
    ),
}  # fmt: skip


@pytest.mark.quick
@pytest.mark.parametrize("name", FILES)
def test_a_file_is_known_by_its_content(tmp_path, name):
    text, settings, parts, times, channels = FILES[name]
    versions = [text] if name in ("a table", "Kinovea as text") else [text, german(text)]
    for version in versions:
        how = ImportSettings(**settings)
        table = read_foreign(write(tmp_path, version), how)
        assert table.program in name or name == "a table"
        np.testing.assert_allclose(table.times, times)
        values = channels_of(table, parts, how=how)
        assert values.keys() == channels.keys()
        for channel, expected in channels.items():
            np.testing.assert_allclose(values[channel], expected, atol=1e-12, err_msg=channel)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("text", "settings", "says"),
    [
        (TRACKER, {}, "Tracker does not give the unit of its coordinates: give --unit m, cm"),
        (TRACKER.replace("4.000000E-2", "no"), {"unit": "m"}, "column 't' has 'no' in row 5"),
        (TRACKER.replace("\ttip of it", "\telbow"), {"unit": "m"}, "two points that are called"),
        (TRACKER.replace("\t2.000000E-1", ""), {"unit": "m"}, "row 5 has 4 cells"),
        (SLEAP.replace("arm,3", "arm,1"), {"frame_rate": 1.0}, "'arm' has two instances in one "
            "frame"),
        (SLEAP.replace("100.5", "1_0"), {"frame_rate": 1.0}, "column 'elbow.x' has '1_0' in row 2"),
        (SLEAP, {}, "SLEAP gives frame numbers instead of times: give --frame-rate"),
        (ANIPOSE.replace("1001.0", "x"), {"frame_rate": 1.0, "unit": "m"}, "has 'x' in row 3"),
        (ANIPOSE.replace("end_y,", "_y,"), {"frame_rate": 1.0, "unit": "m"}, "no columns x and y"),
        (MOTIVE.replace("Frame,Time", "Time"), {}, "is not a file of OptiTrack Motive"),
        (MOTIVE.replace("1,0.008333", "1,0.0"), {}, "must increase from row to row"),
        (MOTIVE.replace("101.0,201.0", "101.0"), {}, "row 9 has 12 cells"),
        (MOTIVE.replace("1,0.008333", "1,"), {}, "but row 9 has no time: add the time"),
        (MOTIVE.replace("1,0.008333", "1,-1"), {}, "but row 9 goes back in time: sort"),
        (MOTIVE.replace("1,0.008333", "1,0"), {}, "but row 9 has the same time as the previous "
            "row"),
        (SLEAP.replace("arm,1", "arm,"), {"frame_rate": 1.0}, "but row 3 has no time"),
        (KINOVEA.replace("80 -6", "40 -6"), {"unit": "m"}, "but row 11 has the same time as the "
            "previous row"),
        (KINOVEA.replace("# tip", "# elbow"), {"unit": "m"}, "two points that are called 'elbow'"),
        (ANIPOSE.replace("1001.0", '"1,001"'), {"frame_rate": 1.0, "unit": "m"},
         "row 3 has '1,001', but other numbers have a decimal point"),
        (PHYPHOX.replace("Absolute (rad/s)", "Time (s)"), {}, "has the column 'Time (s)' 2 times"),
        # Options that have no effect on a table.
        (SLEAP, {"frame_rate": 1.0, "origin": (0, 9)}, "--origin has no effect on this table of"),
        (SLEAP, {"frame_rate": 1.0, "rename": {"tip": "x"}}, "--rename has no effect on this"),
        (DEEPLABCUT, {"frame_rate": 1.0, "unit": "mm"}, "--unit has no effect on this table of"),
        (DEEP, {"frame_rate": 1.0, "origin": (0, 9)}, "--origin has no effect on this table of"),
        (DEEP, {"frame_rate": 1.0}, "does not give the unit of its coordinates: give --unit"),
        (KINOVEA, {"unit": "m", "origin": (0, 9)}, "--unit has no effect on this table of"),
        (TRACKER, {"unit": "m", "time_unit": "ms"}, "--time-unit has no effect on this table of"),
        (TRACKER, {"unit": "m", "likelihood": 0.9}, "--likelihood has no effect on this table"),
        (TRACKER_ONE, {"axes": ("x", "z")}, "--axes has no effect on this table of Tracker"),
        (MOTIVE, {"unit": "m"}, "--unit has no effect on this table of OptiTrack"),
        (PHYPHOX, {"unit": "m"}, "--unit has no effect on this table of phyphox: omit it"),
        (COLUMNS, {"unit": "m"}, "--unit has no effect on this table of a spreadsheet: omit it"),
        (DEEP, {"offset": np.nan}, "--offset or --origin is not finite: give finite numbers"),
        (DEEP, {"until": np.nan}, "--from-time or --until is not a number: give a time"),
        (DEEP, {"likelihood": np.nan}, "the likelihood is nan: give a number from 0 to 1"),
        (PHYPHOX.replace("2.100000000E-2", "2.1e"), {}, "'Time (s)' has '2.1e' in row 3"),
        (PHYPHOX.replace("2.100000000E-2", "NaN"), {}, "but row 3 has no time: add the time"),
        (PHYPHOX, {"frame_rate": -1.0}, "the frame rate is -1"),
        (KINOVEA.replace("40 101 21", "40 101"), {"unit": "m"}, "row 6 has 2 cells"),
        (KINOVEA.replace("40 101", "0:00:00:03 101"), {"unit": "m"}, "'0:00:00:03' in row 6"),
        (COLUMNS, {"rename": {"t": "time_s"}}, "'z of tip' is not in the column table"),
        (COLUMNS, {"rename": {"t": "time_s", "T": "tip_z_m"}}, "has no column 'T'"),
        ("a,b\n1,2\n", {}, "DeepLabCut (the rows scorer, bodyparts and coords); SLEAP"),
        ("\x89PNG\r\n\x1a\n\0\0", {}, "is in none of the formats that can be read: DeepLabCut"),
        ("", {}, "is in none of the formats that can be read"),
        ("q," * 100_001 + "q", {}, "has 100,002 cells in a row, but may have at most 100,000"),
        (DEEP, {"frame_rate": 1.0, "unit": "inch"}, "the unit of a length is 'inch'"),
        (DEEP, {"frame_rate": 1.0, "unit": "m", "axes": ("x", "z")}, "has 3 coordinates, but"),
        (DEEP, {"axes": ("x", "u")}, "the axes are x,u: give each"),
    ],
)  # fmt: skip
def test_a_broken_file_is_one_sentence(tmp_path, text, settings, says):
    with pytest.raises(InputError) as caught:
        read_foreign(write(tmp_path, text), ImportSettings(**settings))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def imported(folder, text, *options):
    """Import a file, and return the run or the exit status."""
    source, out = write(folder, text), folder / "run.csv"
    status = main(["import", str(source), *options, "--to", str(out), "--force"])
    return status or read_table(out)


@pytest.mark.quick
def test_options_cut_shift_turn_and_choose(tmp_path, capsys):
    """Each option acts on the clock or the axes of the run."""
    plain = ["--unit", "m", "--point", "elbow=link01", "--point", "tip of it=tip"]
    whole = imported(tmp_path, TRACKER, *plain)
    assert "3 pictures, 5 of 6 points found" in capsys.readouterr().out
    later = imported(tmp_path, TRACKER, *plain, "--offset", "-0.02", "--from-time", "0.01")
    np.testing.assert_allclose(later.times, [0.02, 0.1])
    late = imported(tmp_path, TRACKER, *plain, "--until", "0.05", "--flip", "z")
    np.testing.assert_allclose(late.times, [0, 0.04])
    np.testing.assert_allclose(late.values["tip_z"], -whole.values["tip_z"][:2])
    np.testing.assert_allclose(late.values["tip_x"], whole.values["tip_x"][:2])
    twice = imported(tmp_path, TRACKER, *plain, "--flip", "z", "--flip", "tip_z")
    np.testing.assert_array_equal(twice.values["tip_z"], -whole.values["tip_z"])
    for choice in (
        ["--only", "tip"],
        ["--only", "tip*"],
        ["--ignore", "elbow"],
        ["--ignore", "link01_?"],
    ):
        assert set(imported(tmp_path, TRACKER, *plain, *choice).values) == {"tip_x", "tip_z"}
    # A film at 240 frames per second, shown at 25: the stamps are those of the player.
    fast = imported(tmp_path, TRACKER, *plain, "--frame-rate", "240")
    np.testing.assert_allclose(fast.times, np.array([0, 1, 3]) / 240)
    for text, wrong, says in [
        (TRACKER, ["--flip", "w"], "--flip w is not one of"),
        (TRACKER, ["--only", "nose"], "--only nose is not one of"),
        (TRACKER, ["--from-time", "9"], "no row is between 9 and inf s"),
        (TRACKER, ["--point", "elbow=imu01"], "'elbow' twice"),
        (TRACKER.replace("1.200000E-1", "1.000000E-1"), ["--frame-rate", "9"], "constant frame"),
    ]:
        capsys.readouterr()
        assert imported(tmp_path, text, *plain, *wrong) == 2
        assert says in capsys.readouterr().err


@pytest.mark.quick
def test_a_table_and_a_film_beside_each_other(tmp_path, capsys):
    """The commands come from the log of a spreadsheet with any delimiter."""
    names = ["--rename", "t=time_s", "--rename", "z of tip=tip_z_m", "--ignore", "note"]
    log = imported(tmp_path, COLUMNS, *names)
    assert set(log.values) == {"joint01_command", "tip_z"}
    assert imported(tmp_path, COLUMNS, *names[:-2], "--only", "time_s") == 2
    assert "no channel is left: correct --only" in capsys.readouterr().err
    film = write(tmp_path, DEEPLABCUT, "film.csv")
    both, words = tmp_path / "both.csv", ["--frame-rate", "20", "--point", "tip=tip"]
    beside = ["--command", str(tmp_path / "run.csv"), "--to", str(both)]
    assert main(["import", str(film), *words, *beside]) == 0
    run = read_table(both)
    np.testing.assert_allclose(run.times, [0, 0.05, 0.1, 0.2])
    np.testing.assert_allclose(run.values["joint01_command"], np.deg2rad([0, 5, 10, 20]))
    np.testing.assert_allclose(run.values["tip_z"], [1.5, np.nan, 1.6, np.nan])
    np.testing.assert_allclose(run.values["tip_u"], [10.5, 11.5, np.nan, np.nan])


@pytest.mark.quick
def test_commands_that_are_held_stay_so_beside_a_film(tmp_path):
    """The sidecar of the other file declares this, also for a table with several clocks."""
    log = write(tmp_path, "time_s,joint01_command_deg,wind_x_m_per_s\n0,0,1\n0.1,10,3\n", "log.csv")
    log.with_suffix(".toml").write_text('model = "arm"\n[command]\ninterpolation = "zoh"\n')
    rows, values = np.array([0.05, 0.15]), {"joint02_command": np.array([1.0, 4.0])}
    for held, second in (True, [1, 1, 1, 4]), (False, [1, 1, 2.5, 4]):
        _, table = filmed_beside(rows, values, read_beside(log), held=held)
        np.testing.assert_allclose(table["joint01_command"], np.deg2rad([0, 0, 10, 10]))
        np.testing.assert_allclose(table["wind_x"], [1, 2, 3, 3])
        np.testing.assert_allclose(table["joint02_command"], second)


@pytest.mark.quick
def test_what_drives_and_stands_in_the_table_is_known_at_the_other_times(tmp_path):
    """Commands of the imported table are interpolated between its rows, too."""
    names = ["--rename", "t=time_s", "--ignore", "note", "--ignore", "z of tip"]
    other = write(tmp_path, "time_s,joint02_angle_deg\n0.05,1\n", "other.csv")
    run = imported(tmp_path, COLUMNS, *names, "--command", str(other))
    np.testing.assert_allclose(run.values["joint01_command"], np.deg2rad([0, 5, 10, 20]))


@pytest.mark.quick
@pytest.mark.parametrize(
    ("text", "parts", "says"),
    [
        (PHYPHOX, {"Gyroscope": "link01"}, "for which no rates can be recorded: name it imu06"),
        (MOTIVE, {"Arm": "imu01"}, "for which no position can be recorded: name it link06 or tip"),
        (PHYPHOX, {"Gyroscope w": "imu01"}, "must be one of Gyroscope, Absolute"),
        (PHYPHOX, {}, "for example with --point 'Gyroscope=tip'"),
        (
            PHYPHOX.replace("Gyroscope", "Linear Acceleration").replace("rad/s", "m/s^2"),
            {"Linear Acceleration": "imu01"},
            "but its signal does not contain gravity, unlike the signal of an accelerometer: "
            "record",
        ),
    ],
)
def test_a_thing_is_what_its_quantity_can_be(tmp_path, text, parts, says):
    with pytest.raises(InputError) as caught:
        channels_of(read_foreign(write(tmp_path, text)), parts)
    assert says in str(caught.value)
