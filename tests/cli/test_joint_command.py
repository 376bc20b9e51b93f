"""`giajax joint`: figures and numbers of one joint at rest."""

import csv

import numpy as np
import pytest

from giajax.cli import main

PICTURES = ("fig09.png", "fig10.png", "corrections.png", "joint.png", "equilibria.png")
WIDTHS = {"fig09.png": 10, "fig10.png": 10, "corrections.png": 8}  # inches; all others are 11


def rows(path):
    with path.open() as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joint") / "new" / "out"
    formats = ["--format", "svg", "--format", "pdf", "--dpi", "65"]
    assert main(["joint", "--out", str(folder), "--target-angle", "25", *formats]) == 0
    return folder


@pytest.mark.long
def test_a_neck_of_the_help_is_drawn_and_one_that_muscles_crush_is_refused(tmp_path, capsys):
    assert main(["joint", "--out", str(tmp_path), "--set", "neck.radius=0.045"]) == 0
    found = rows(tmp_path / "equilibria.csv")
    # The straight neck is tight, and the pressures for angles above 51 degrees crush it.
    assert max(float(row["stiffness_N_m_per_rad"]) for row in found) > 100
    assert max(abs(float(row["target_deg"])) for row in found) == 51
    assert main(["joint", "--out", str(tmp_path / "no"), "--set", "neck.radius=0.01"]) != 0
    assert "make neck.pressure or neck.radius larger" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (
            ["neck.length=0.03"],
            "neck.length has no effect on a joint without a neck: also set neck.radius",
        ),
        (["neck.radius=0.06", "neck.length=0"], "neck.length is 0: make it positive"),
    ],
)
def test_necks_that_are_none(words, sentence, tmp_path, capsys):
    given = [part for word in words for part in ("--set", word)]
    assert main(["joint", "--out", str(tmp_path / "out"), *given]) != 0
    assert sentence in capsys.readouterr().err


@pytest.mark.slow
def test_it_draws_and_writes_the_numbers(written):
    for name in PICTURES:
        content = (written / name).read_bytes()
        assert content.startswith(b"\x89PNG")
        assert int.from_bytes(content[16:20]) == 65 * WIDTHS.get(name, 11)
        for ending, begin in ((".svg", b"<?xml"), (".pdf", b"%PDF")):
            assert (written / name).with_suffix(ending).read_bytes().startswith(begin)
    plain, corrected = rows(written / "fig09.csv"), rows(written / "fig10.csv")
    assert len(plain) == len(corrected) == 242
    at = {float(row["angle_deg"]): row for row in corrected if row["side"] == "inner"}
    assert float(at[60]["force_N"]) == pytest.approx(2.97, abs=0.005)
    assert float(at[60]["contraction"]) == pytest.approx(0.194, abs=5e-4)
    at = {float(row["angle_deg"]): row for row in plain if row["side"] == "outer"}
    assert float(at[-60]["force_N"]) == pytest.approx(2.93, abs=0.005)
    assert at[-60]["branch"] == "outer, wrapped"


@pytest.mark.slow
def test_the_points_are_where_they_should_be(written):
    points = {}
    for row in rows(written / "points.csv"):
        points.setdefault(float(row["angle_deg"]), {})[row["point"]] = np.array(
            [float(row["x_m"]), float(row["y_m"])]
        )
    inner, outer = points[30], points[-30]
    assert set(inner) == set("ABCDEH")
    assert set(outer) == set("BDEMNOPQ")
    # H is on the bisector, half a wire from B and D, below A and C.
    assert inner["H"][0] == 0
    for end in "BD":
        assert np.linalg.norm(inner["H"] - inner[end]) == pytest.approx(0.17, abs=1e-8)
    assert inner["H"][1] < inner["C"][1]
    # The muscle passes P and Q at the same height, and goes down to M and N.
    assert outer["P"][1] == outer["Q"][1] == outer["O"][1] > outer["N"][1]
    for letter, image in (("A", "C"), ("B", "D")):
        np.testing.assert_allclose(inner[letter], inner[image] * [-1, 1])
    # The angles and lengths of the links are preserved.
    for point, size in (("C", np.hypot(0.9, 0.18)), ("D", np.hypot(0.03, 0.04))):
        assert np.linalg.norm(inner[point]) == pytest.approx(size, abs=1e-8)


@pytest.mark.slow
def test_corrections_are_those_of_the_joint(tmp_path, written, capsys):
    out = tmp_path / "out"
    assert main(["joint", "--out", str(out), "--set", "alpha.offset=0.05"]) == 0
    capsys.readouterr()

    def curve(folder, reading, side):
        table = rows(folder / "corrections.csv")
        chosen = [row for row in table if (row["reading"], row["side"]) == (reading, side)]
        return {float(row["angle_deg"]): float(row["added_torque_N_m"]) for row in chosen}

    for reading in ("continuous", "printed"):
        mine, paper = curve(out, reading, "inner"), curve(written, reading, "inner")
        for angle, alpha in ((0.0, 0.05), (30.0, 0.05), (60.0, 0.05 + 400 / 1600)):
            assert mine[angle] == pytest.approx(alpha, abs=1e-8)
            assert paper[angle] == pytest.approx(alpha - 0.02, abs=1e-8)
        assert curve(out, reading, "outer") == curve(written, reading, "outer")
    assert curve(out, "continuous", "outer")[-60.0] == pytest.approx(-0.3, abs=1e-8)
    assert curve(out, "printed", "outer")[-60.0] == pytest.approx(-1.2, abs=1e-8)


@pytest.mark.slow
def test_stops_and_branches_that_are_never_reached_are_told(tmp_path, capsys):
    strong = ["--torque", "3", "--set", "muscle.pressure_limit=40e3", "--target-angle", "60"]
    geometry = ["--set", "geometry.anchor_y=0.14"]
    assert main(["joint", "--out", str(tmp_path), *strong, *geometry]) == 0
    table = rows(tmp_path / "equilibria.csv")
    assert {"at_lower_stop", "at_upper_stop", "indifferent"} <= set(table[0])
    out = capsys.readouterr().out
    assert "required pressure exceeds the pressure limit" in out
    assert "below 0.00 deg" in out
    assert "nan" not in out


@pytest.mark.slow
def test_the_equilibria_hold_the_target(written):
    table = rows(written / "equilibria.csv")
    target = {float(row["target_deg"]) for row in table}
    assert len(target) == 121
    for angle in target:
        found = [row for row in table if float(row["target_deg"]) == angle]
        assert min(abs(float(row["angle_deg"]) - angle) for row in found) < 1e-6
    several = [angle for angle in target if sum(float(r["target_deg"]) == angle for r in table) > 1]
    assert max(np.abs(several)) < 25
    assert 20.0 in several


@pytest.mark.slow
def test_it_says_where_the_pressures_hold_the_joint(tmp_path, capsys):
    arguments = ["joint", "--out", str(tmp_path), "--torque", "0.4", "--angle", "45"]
    assert main([*arguments, "--set", "muscle.diameter=0.0045", "--target-angle", "-30"]) == 0
    out, err = capsys.readouterr()
    assert "above 3.64 deg" in out
    assert "-30.00" in out
    assert "stable" in out
    assert "computing all equilibria" in err
    assert {row["angle_deg"] for row in rows(tmp_path / "points.csv")} == {"45"}
    torque = {row["torque_N_m"] for row in rows(tmp_path / "fig09.csv")}
    assert torque == {"0.4"}


@pytest.mark.parametrize("name", ["joint.png", "joint.svg", "joint.caption.txt"])
def test_nothing_is_written_over_without_force(tmp_path, capsys, name):
    (tmp_path / name).write_text("mine")
    assert main(["joint", "--out", str(tmp_path), "--format", "svg"]) == 2
    out, err = capsys.readouterr()
    assert (out, err.count("\n")) == ("", 1)
    assert f"{name} exists" in err
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_format_or_a_resolution_that_there_is_not(tmp_path, capsys):
    assert main(["joint", "--out", str(tmp_path / "new"), "--format", "gif"]) == 2
    assert capsys.readouterr().err == "giajax: --format is 'gif': give png, svg or pdf\n"
    assert main(["joint", "--out", str(tmp_path / "new"), "--dpi", "5"]) == 2
    assert "'--dpi'" in capsys.readouterr().err
    assert not (tmp_path / "new").exists()
    # Without a folder, this command only prints.
    assert main(["fill", "--format", "svg"]) == 2
    assert "no picture is written without --out" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["run.csv", "there/run.csv"])
def test_a_name_of_a_file_is_no_folder(tmp_path, capsys, name):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "run.csv").write_text("mine")
    assert main(["joint", "--out", str(tmp_path / name)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    # The command fails before anything is computed.
    assert "solving" not in err
    assert "the output must be a folder" in err
    assert not (tmp_path / "run.csv").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--angle", "70"], "from -60 to 60 deg"),
        (["--target-angle", "-90"], "from -60 to 60 deg"),
        (["--set", "geometry.wire_length=0.05"], "cannot be built"),
        (["--set", "geometry.wire_lenght=0.3"], "did you mean 'joint.geometry.wire_length'"),
        (["--set", "alpha.offset"], "PATH=VALUE"),
        (["--set", "muscle.diameter=-1"], "outside its bounds"),
        (["--torque", "0"], "positive torque"),
        (["none.toml"], "does not exist"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_status_2(arguments, sentence, tmp_path, capsys):
    assert main(["joint", "--out", str(tmp_path / "out"), *arguments]) == 2
    out, err = capsys.readouterr()
    assert sentence in err
    assert out == ""
    assert len([line for line in err.splitlines() if line.startswith("giajax: ")]) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_definition_states_joint_and_muscle(tmp_path, capsys):
    stated = tmp_path / "mine.toml"
    stated.write_text('[joint]\ncorrection = "none"\n[muscle]\ndiameter_m = 0.0045\n')
    out = tmp_path / "out"
    assert main(["joint", "--out", str(out), str(stated)]) == 0
    capsys.readouterr()
    assert (out / "fig09.csv").read_bytes() == (out / "fig10.csv").read_bytes()
    stated.write_text("[joint]\nwire = 3\n")
    assert main(["joint", "--out", str(out), str(stated)]) == 2
    assert "wire" in capsys.readouterr().err
    for line in ("length_m = 1.5", 'friction = "coulomb"', "friction_pressures_kPa = [50, 100]"):
        stated.write_text(f"[muscle]\n{line}\n")
        assert main(["joint", "--out", str(tmp_path / "no"), str(stated)]) == 2
        assert f"[muscle] {line.split(' ')[0]} is not used here" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("name", ["joint", "muscle"])
def test_a_run_is_checked_and_fitted_like_any_other(name, tmp_path, capsys):
    from pathlib import Path

    run = Path(__file__).parents[2] / "data" / "synthetic" / f"{name}.csv"
    assert main(["check", "--data", str(run)]) == 0
    assert name in capsys.readouterr().out
    assert main(["fit", "--data", str(run), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    assert (tmp_path / "out" / "result.json").exists()
    template = tmp_path / f"{name}.csv"
    template.write_bytes(run.read_bytes())
    assert main(["init", "--data", str(template)]) == 0
    assert f"[{name}]" in template.with_suffix(".toml").read_text()
    assert main(["check", "--data", str(template)]) == 0
