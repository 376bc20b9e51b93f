"""`giajax mission` as a user runs it: its output and files, and the input that it refuses."""

import json
from pathlib import Path

import numpy as np
import pytest

from arm_in_window import check_file
from giajax.cli import main
from giajax.recordings import read_run
from giajax.schema import ArmSection

MISSION = Path(__file__).resolve().parents[2] / "missions" / "naraha.toml"


def blind(folder):
    """Write a short mission without pictures; it shares a program with tests/apps/mission."""
    text = MISSION.read_text(encoding="utf-8")
    for told, short in ("limit_s = 720.0", "limit_s = 60.0"), ("[640, 480]", "[1, 1]"):
        assert text.count(told) == 1
        text = text.replace(told, short)
    path = folder / "blind.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.slow
def test_a_mission_and_many(tmp_path, capsys, request):
    file, out, page = blind(tmp_path), tmp_path / "out", tmp_path / "page.html"
    words = ["mission", str(file), "--seed", "3", "--out", str(out)]
    assert main([*words, "--page", str(page), "--case", "2"]) == 0
    printed = capsys.readouterr().out
    fitted = read_run(out / "run.csv").definition.section(ArmSection).values()
    assert fitted["contact.friction"] not in (None, 0.3)
    assert (
        "the tip is not inside the opening after 60 s in a wind of 0.2 m/s: the opening never came"
        in printed
    )
    facts = json.loads((out / "mission.json").read_text(encoding="utf-8"))
    assert facts["reached_s"] is None
    assert facts["ended_s"] == 60.0
    assert [each["obstacle"] for each in facts["touched"]] == ["housetop", "front", "ground"]
    assert (out / "mission.png").read_bytes().startswith(b"\x89PNG")
    run = read_run(out / "run.csv")
    assert " mission " in run.definition.origin
    assert len(run.times) == 601
    assert run.times[0] == 0.0
    assert page.read_bytes().lstrip().lower().startswith(b"<!doctype html")
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err

    many = tmp_path / "many"
    words = ["mission", str(file), "--cases", "1", "--speeds", "0,0.2", "--out", str(many)]
    assert main([*words, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["winds"]
    assert [row["wind_m_per_s"] for row in rows] == [0.0, 0.2]
    assert (many / "cases.csv").read_text(encoding="utf-8").count("\n") == 3
    assert (many / "cases.png").read_bytes().startswith(b"\x89PNG")
    # Last, because the test is skipped here if there is no browser.
    tips = np.stack([run.values[f"tip_{axis}"] for axis in "xyz"], axis=1)
    points = np.concatenate([np.zeros((1, 3)), tips[::20]])
    browser = request.getfixturevalue("browser")
    check_file(browser, tmp_path / "profile", page, points, upright=True)


@pytest.mark.quick
@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--speed", "-1"), "--speed is -1: give a non-negative number"),
        (
            ("--speed", "0.1", "--cases", "3"),
            "--speed applies to a single mission: omit --cases",
        ),
        (("--cases", "3", "--speeds", "a,b"), "--speeds is 'a,b': give non-negative numbers"),
        (
            ("--cases", "3", "--page", "x.html"),
            "--page applies to a single mission: omit --cases",
        ),
        (("--controller", "pid"), "the controller is 'pid': give one of operator, mpc"),
        (("--keep-station", "0"), "--keep-station is 0: give a time from 1 to 3600 s"),
        (
            ("--keep-station", "9", "--cases", "3"),
            "--keep-station applies to a single mission: omit --cases",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(capsys, words, sentence):
    assert main(["mission", str(MISSION), *words]) == 2
    assert sentence in capsys.readouterr().err
