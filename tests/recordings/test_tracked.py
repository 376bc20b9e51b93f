"""Tracked points from other programs: files in their actual form, and invalid ones."""

import time

import numpy as np
import pytest

from giajax import InputError, read_run
from giajax.cli import main
from giajax.recordings import read_deeplabcut, read_kinovea

SCORER = "DLC_resnet50_armSep1shuffle1_100000"
# As pandas writes it: the name of the scorer, the body parts, and x, y, likelihood for each.
DEEPLABCUT = (
    f"scorer,{','.join([SCORER] * 6)}\n"
    "bodyparts,elbow,elbow,elbow,tip end,tip end,tip end\n"
    "coords,x,y,likelihood,x,y,likelihood\n"
    "0,403.84326,520.2443,0.8864096,393.53666,528.21704,0.843187\n"
    "1,404.5,521.0,0.31,394.0,529.0,0.99\n"
    "3,405.0,522.0,0.99,,,\n"
)
ANIMALS = (
    f"scorer,{','.join([SCORER] * 4)}\n"
    "individuals,left,left,right,right\n"
    "bodyparts,tip,tip,tip,tip\n"
    "coords,x,y,x,y\n"
    "0,1.0,2.0,3.0,4.0\n"
    "1,1.5,2.5,3.5,4.5\n"
)
# Kinovea quotes cells, leaves those without a value empty, and ends rows with CRLF.
KINOVEA = (
    '"Time","Marker 1/0/X","Marker 1/0/Y","Marker 2/0/X","Marker 2/0/Y"\r\n'
    '"0","100.5","20.25",,\r\n'
    '"0.04","101","21","-5","300"\r\n'
)


def write(folder, text, name="points.csv"):
    path = folder / name
    path.write_text(text, newline="")
    return path


@pytest.mark.quick
def test_deeplabcut_counts_pictures_and_drops_what_is_unlikely(tmp_path):
    points = read_deeplabcut(write(tmp_path, DEEPLABCUT), rate=50.0)
    np.testing.assert_allclose(points.times, [0, 0.02, 0.06])
    assert list(points.points) == ["elbow", "tip end"]
    elbow = [[403.84326, 520.2443], [np.nan, np.nan], [405, 522]]
    np.testing.assert_array_equal(points.points["elbow"], elbow)
    assert np.isnan(points.points["tip end"][2]).all()
    bolder = read_deeplabcut(write(tmp_path, DEEPLABCUT), rate=50.0, likelihood=0.3)
    np.testing.assert_array_equal(bolder.points["elbow"][1], [404.5, 521.0])


@pytest.mark.quick
def test_deeplabcut_of_several_animals_names_them(tmp_path):
    points = read_deeplabcut(write(tmp_path, ANIMALS), rate=10.0).points
    np.testing.assert_array_equal(points["left/tip"], [[1, 2], [1.5, 2.5]])
    np.testing.assert_array_equal(points["right/tip"], [[3, 4], [3.5, 4.5]])


@pytest.mark.quick
@pytest.mark.parametrize(
    "text",
    [
        KINOVEA,
        KINOVEA.replace(".", ","),
        KINOVEA.replace(".", ",").replace('","', '";"').replace('",,', '";;'),
    ],
    ids=["point", "comma", "semicolon"],
)
def test_kinovea_has_y_upwards_from_its_origin(tmp_path, text):
    points = read_kinovea(write(tmp_path, text), origin=(10.0, 1079.0))
    np.testing.assert_allclose(points.times, [0, 0.04])
    np.testing.assert_allclose(points.points["Marker 1"], [[110.5, 1058.75], [111, 1058]])
    np.testing.assert_allclose(points.points["Marker 2"], [[np.nan, np.nan], [5, 779]])
    later = read_kinovea(write(tmp_path, text), origin=(0, 0), time_unit="ms")
    np.testing.assert_allclose(later.times, [0, 4e-5])


@pytest.mark.quick
@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("time_s,tip_u_px\n0,1\n", "is not a file of DeepLabCut"),
        (
            DEEPLABCUT.replace("404.5", "left"),
            "'elbow x' has 'left' in row 5, but must have",
        ),
        (DEEPLABCUT.replace("1,404.5", "404.5"), "row 5 has 6 cells"),
        (DEEPLABCUT.replace("\n3,", "\n1,"), "must increase from row to row"),
        (DEEPLABCUT.replace("x,y,l", "x,z,l", 1), "'elbow' has no columns x and y"),
        (DEEPLABCUT.split("\n0,")[0] + "\n", "no rows"),
        (DEEPLABCUT.replace("tip end", "elbow"), "two points that are called 'elbow'"),
        (DEEPLABCUT.replace("coords,x,", "coords,"), "row 3 has 6 cells"),
        (DEEPLABCUT.replace("elbow,elbow", "el" + "b" * 200_000), "200,002 characters"),
        (DEEPLABCUT.replace("elbow,", '"elbow",', 1).replace("404.5", '"404.5"1'), "quotation"),
        ("", "is not a file of DeepLabCut"),
        *(
            (DEEPLABCUT.replace("404.5", cell), f"{cell!r} in row 5")
            for cell in ("1_0", "\u0661", "\uff11", "1e", "0x10", "True")
        ),
        *(
            (
                DEEPLABCUT.replace("404.5", cell),
                f"has {float(cell):g} in row 5, but values must be at most 1e+30 in magnitude",
            )
            for cell in ("inf", "-Infinity", "1e400", "1e31")
        ),
    ],
    ids=lambda value: value[-40:],
)
def test_a_bad_file_of_deeplabcut_is_one_sentence(tmp_path, text, says):
    with pytest.raises(InputError) as caught:
        read_deeplabcut(write(tmp_path, text), rate=50.0)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("text", "says"),
    [
        (KINOVEA.replace("Marker 2", "Marker 1"), "two points that are called 'Marker 1/0'"),
        (KINOVEA.replace('"101"', '"1_0"'), "column 'Marker 1/0/X' has '1_0' in row 3"),
        (KINOVEA.replace('"101"', '"inf"'), "has inf in row 3"),
        (KINOVEA.replace('"101"', '"1,0,1"'), "row 3 has '1,0,1', but other numbers have"),
        (KINOVEA.replace('"101"', '"101'), "row 3"),
        (KINOVEA.replace('"101",', '"101",,'), "row 3 has 6 cells"),
        (KINOVEA.replace('"101"', "1" * 140_000), "140,000 characters"),
    ],
    ids=lambda value: value[-40:],
)
def test_a_cell_of_kinovea_is_read_as_that_of_a_run(tmp_path, text, says):
    with pytest.raises(InputError) as caught:
        read_kinovea(write(tmp_path, text), origin=(0.0, 0.0))
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.quick
def test_time_grows_no_faster_than_points(tmp_path):
    """8,000 points took a minute when each was compared with all others."""
    number = 8_000
    names = [f"point {index}" for index in range(number)]

    def row(first, cells):
        return ",".join([first, *cells])

    lines = [
        row("scorer", ["s"] * (3 * number)),
        row("bodyparts", [name for name in names for _ in range(3)]),
        row("coords", ["x", "y", "likelihood"] * number),
        *(row(str(picture), ["1.5", "", "0.9"] * number) for picture in range(3)),
    ]
    path = write(tmp_path, "\n".join(lines) + "\n")
    began = time.process_time()
    points = read_deeplabcut(path, rate=1.0).points
    assert time.process_time() - began < 5
    assert list(points) == names
    np.testing.assert_array_equal(points[names[-1]], [[1.5, np.nan]] * 3)
    columns = [f"{name}/0/{axis}" for name in names for axis in "XY"]
    path = write(tmp_path, "\n".join([row("Time", columns), row("0", ["1.5", ""] * number)]))
    began = time.process_time()
    points = read_kinovea(path, origin=(0.0, 0.0)).points
    assert time.process_time() - began < 5
    np.testing.assert_array_equal(points[names[-1]], [[1.5, np.nan]])


@pytest.mark.quick
@pytest.mark.parametrize(
    "text", [DEEPLABCUT, KINOVEA.replace("1/0/Y", "2/0/Y", 1), '"Time"\r\n"0"\r\n', ""]
)
def test_a_bad_file_of_kinovea_is_one_sentence(tmp_path, text):
    with pytest.raises(InputError, match="is not a file of Kinovea"):
        read_kinovea(write(tmp_path, text), origin=(0.0, 0.0))


@pytest.mark.quick
def test_two_cameras_and_a_log_become_one_run(tmp_path, capsys):
    """Each camera and the log keep their own times; commands are interpolated."""
    log = write(tmp_path, "time_s,joint01_command_deg\n0,0\n0.05,10\n", "log.csv")
    film, other = write(tmp_path, DEEPLABCUT), write(tmp_path, KINOVEA, "kinovea.csv")
    first, run = tmp_path / "first.csv", tmp_path / "run.csv"
    options = ["--frame-rate", "50", "--point", "elbow=link03", "--point", "tip end=tip"]
    arguments = [str(film), *options, "--camera", "side", "--command", str(log)]
    assert main(["import", *arguments, "--to", str(first)]) == 0
    assert "3 pictures, 4 of 6 points found" in capsys.readouterr().out
    options = ["--origin", "0,1079", "--point", "Marker 1=mark01", "--camera", "top"]
    arguments = [str(other), *options, "--command", str(first)]
    assert main(["import", *arguments, "--to", str(run)]) == 0
    table = read_run(run)
    np.testing.assert_allclose(table.times, [0, 0.02, 0.04, 0.05, 0.06])
    command = np.deg2rad([0, 4, 8, 10, 10])
    np.testing.assert_allclose(table.values["joint01_command"], command)
    np.testing.assert_allclose(table.values["side.link03_u"][[0, 4]], [403.84326, 405])
    assert np.isnan(table.values["side.link03_u"][1:4]).all()
    np.testing.assert_allclose(table.values["top.mark01_v"][[0, 2]], [1058.75, 1058])
    # The template has a section for each camera and landmark, and the noise of the pixels.
    assert main(["init", "--data", str(run)]) == 0
    text = run.with_suffix(".toml").read_text()
    for line in ("[camera.side]", "[camera.top]", "[landmark.mark01]", "# pixel_px = 2.0"):
        assert line in text


@pytest.mark.quick
@pytest.mark.parametrize(
    ("options", "says"),
    [
        ([], "DeepLabCut gives frame numbers instead of times: give --frame-rate"),
        (["--frame-rate", "50"], "no tracked point is assigned to a channel"),
        (["--frame-rate", "50", "--point", "nose=tip"], "there is no tracked point 'nose'"),
        (
            ["--frame-rate", "50", "--point", "elbow=wrist"],
            "is called 'wrist', which a camera cannot record",
        ),
        (["--frame-rate", "50", "--point", "elbow"], "--point 'elbow' must be OLD=NEW"),
        (["--frame-rate", "0", "--point", "elbow=tip"], "the frame rate is 0"),
        (["--origin", "5", "--point", "elbow=tip"], "give two numbers"),
        (
            ["--frame-rate", "50", "--point", "elbow=tip", "--likelihood", "1"],
            "not found in any row",
        ),
        (
            ["--frame-rate", "50", "--likelihood", "60"],
            "the likelihood is 60: give a number from 0 to 1",
        ),
        (
            ["--frame-rate", "50", "--origin", "0,9"],
            "--origin has no effect on this table of DeepLab",
        ),
        (
            ["--frame-rate", "50", "--point", "elbow=tip", "--point", "tip end=tip"],
            "are called 'tip'",
        ),
    ],
)
def test_what_an_import_must_say(tmp_path, capsys, options, says):
    film, out = write(tmp_path, DEEPLABCUT), tmp_path / "run.csv"
    assert main(["import", str(film), *options, "--to", str(out)]) == 2
    assert says in capsys.readouterr().err
    assert not out.exists()
