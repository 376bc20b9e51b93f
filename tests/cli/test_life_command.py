"""`giajax life`: its files, and the input that it refuses."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from arm_in_window import check_file
from giajax.cli import main
from giajax.recordings import read_run

MISSION = Path(__file__).resolve().parents[2] / "missions" / "naraha.toml"


@pytest.mark.slow
def test_it_writes_what_it_says(tmp_path, capsys, request):
    out = tmp_path / "out"
    words = ["life", str(MISSION), "--out", str(out), "--set", "hand.speed=0.2"]
    assert main(words) == 0
    printed = capsys.readouterr().out
    names = {"life.json", "life.csv", "life.png", "life.html", "run.csv", "run.toml"}
    assert {path.name for path in out.iterdir()} == names
    assert all(name in printed for name in names)
    facts = json.loads((out / "life.json").read_text(encoding="utf-8"))
    assert facts["helium_imbalance"] < 1e-10
    assert facts["energy_imbalance"] < 1e-6
    assert facts["momentum_imbalance"] < 1e-6
    assert facts["unrolling"]["hand_speed_m_per_s"] == 0.2
    assert facts["phases"][0]["end_s"] == pytest.approx((19.8 - 0.1) / 0.2)
    with (out / "life.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["phase"] for row in rows] == [each["phase"] for each in facts["phases"]]
    assert float(rows[-1]["end_s"]) == pytest.approx(facts["duration_s"])
    assert (out / "life.html").read_bytes().lstrip().lower().startswith(b"<!doctype html")
    run = read_run(out / "run.csv")
    assert run.times[-1] == pytest.approx(
        facts["phases"][4]["end_s"] - facts["phases"][4]["begin_s"]
    )
    assert " life " in run.definition.origin
    assert main(words) == 2
    assert "--force" in capsys.readouterr().err
    # The arm is unrolled away from the building, raised, and flown. This comes last, because the
    # test is skipped here if there is no browser.
    seen = [[0.0, 0.0, 0.0], [-20.0, 0.0, 0.0], [0.0, 0.0, 20.0]]
    tips = np.stack([run.values[f"tip_{axis}"] for axis in "xyz"], axis=1)
    points = np.concatenate([seen, tips[::100]])
    check_file(request.getfixturevalue("browser"), tmp_path / "profile", out / "life.html", points)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ([], "missing argument 'MISSION'"),
        (["none.toml"], "does not exist: give the path of a TOML file"),
        (["arm.toml"], "has no [mission]: add one"),
        ([str(MISSION), "--set", "roll.radios=1"], "there is no parameter 'roll.radios'"),
        ([str(MISSION), "--set", "supply.flow=-1"], "supply.flow = -1 m^3/s is outside its bounds"),
        ([str(MISSION), "--set", "roll.radius=0.04"], "give a roll larger than its core"),
        (
            [str(MISSION), "--set", "air.added_mass_coefficient=1"],
            "cannot be balanced: remove the coefficient",
        ),
        ([str(MISSION), "--quiet"], "--quiet suppresses all tables"),
    ],
)
def test_what_is_wrong_is_one_sentence(words, sentence, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "arm.toml").write_text("[arm]\nlinks = 3\n", encoding="utf-8")
    assert main(["life", *words]) == 2
    error = capsys.readouterr().err
    assert sentence in error
    assert not [path for path in tmp_path.iterdir() if path.name != "arm.toml"]
