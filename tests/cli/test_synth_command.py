"""`giajax synth`: a run recorded again with errors, or one error message."""

import numpy as np
import pytest

from giajax import read_run
from giajax.cli import main

CSV = "time_s,joint01_command_deg,link02_z_m\n" + "".join(
    f"{t / 10},{min(max(t - 5, 0), 10) * 3},0\n" for t in range(31)
)


@pytest.fixture
def run(tmp_path):
    path = tmp_path / "run.csv"
    path.write_text(CSV)
    path.with_suffix(".toml").write_text("[arm]\nlinks = 2\n")
    return path


@pytest.mark.slow
def test_a_run_is_recorded_again(run, tmp_path):
    out = tmp_path / "new.csv"
    options = ["--noise", "position_m=0.01", "--missing", "10", "--bursts", "10", "--seed", "3"]
    options += ["--outliers", "5", "--outlier-size", "position_m=2", "--set", "camera.origin=0,0,1"]
    assert main(["synth", "--data", str(run), "--to", str(out), *options]) == 0
    new = read_run(out)
    assert new.definition.arm.links == 2
    assert new.definition.sensors.contents() == {}
    assert new.definition.truth["camera.origin"] == [0.0, 0.0, 1.0]
    assert new.noise("link02_z") == pytest.approx(0.01)
    heights = new.values["link02_z"]
    assert 3 <= np.isnan(heights).sum() <= 6
    # One metre below the origin of the camera.
    assert np.nanmedian(heights[:5]) == pytest.approx(-1.0, abs=0.05)
    assert main(["check", "--data", str(out)]) == 0


@pytest.mark.slow
def test_a_file_that_states_a_model_is_true(run, tmp_path):
    """As in `giajax predict`, --model takes a fit or the TOML file of a model."""
    arm = tmp_path / "long.toml"
    arm.write_text("[arm]\nlinks = 2\nlink_length_m = 2.0\n")
    out = tmp_path / "new.csv"
    assert main(["synth", "--data", str(run), "--to", str(out), "--model", str(arm)]) == 0
    new = read_run(out)
    assert new.definition.arm.link_length_m == 2.0
    plain = tmp_path / "plain.csv"
    assert main(["synth", "--data", str(run), "--to", str(plain)]) == 0
    assert np.max(np.abs(new.values["link02_z"] - read_run(plain).values["link02_z"])) > 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--noise", "position_m"], "KEY=VALUE"),
        (["--noise", "height=1"], "height"),
        (["--noise", "angle_deg=1"], "none of the recorded channels"),
        (["--set", "camera.origin=1,2"], "2 values, but has 3 elements"),
        (["--set", "camera.delay=50"], "outside its bounds"),
        (["--outliers", "5"], "fraction and a size"),
        (["--missing", "100"], "fraction missing is 1"),
    ],
)
def test_one_sentence(run, tmp_path, capsys, options, words):
    out = tmp_path / "new.csv"
    assert main(["synth", "--data", str(run), "--to", str(out), *options]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not out.exists()


def test_nothing_is_written_over(run, capsys):
    before = run.read_text()
    assert main(["synth", "--data", str(run), "--to", str(run)]) == 2
    assert "not overwritten" in capsys.readouterr().err
    assert run.read_text() == before
