"""With `--quiet`, a successful command prints nothing but writes its files."""

import shutil
from pathlib import Path

import pytest

from giajax.cli import main

MUSCLE = Path(__file__).resolve().parents[1] / "earlier" / "results" / "muscle"
FILM = "time_s,x\n0,1\n0.1,2\n0.2,4\n"
TARGET = "time_s,output\n0,0\n1,0.1\n2,0\n"
LOOPS = MUSCLE.parent / "loops" / "fit"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return a run of a muscle, its fit, and the input files of other commands."""
    folder = tmp_path_factory.mktemp("quiet")
    shutil.copytree(MUSCLE, folder, dirs_exist_ok=True)
    shutil.copytree(LOOPS, folder / "loops")
    shutil.copy(folder / "run.csv", folder / "bare.csv")
    (folder / "film.csv").write_text(FILM)
    (folder / "target.csv").write_text(TARGET)
    (folder / "arm.toml").write_text("[arm]\nlinks = 2\n")
    return folder


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("init --data bare.csv", "bare.toml"),
        ("import film.csv --rename x=tip_z_m --to made.csv", "made.csv"),
        ("examples --copy all", "all/fits/base_step.toml"),
        ("simulate --arm arm.toml --ramp 1=9 --duration 1 --to run_2.csv", "run_2.csv"),
        ("synth --data run.csv --to again.csv", "again.csv"),
        ("predict fit --data run.csv --to errors.csv", "errors.csv"),
        ("compare fit fit --page both.html", "both.html"),
        ("report fit --page report.html", "report.html"),
        ("suspects fit --data run.csv --out asked", "asked/suspects.json"),
        ("influence fit --data run.csv --spans 2 --no-figures --out parts", "parts/influence.json"),
        ("compensate loops --target target.csv --to commands.csv", "commands.csv"),
        ("fill --no-curve --out filled", "filled/filling.json"),
        ("unroll --out unrolled", "unrolled/unrolling.json"),
    ],
)
def test_a_quiet_command_prints_nothing_and_writes(folder, monkeypatch, capsys, words, written):
    monkeypatch.chdir(folder)
    assert main([*words.split(), "--quiet"]) == 0
    assert capsys.readouterr() == ("", "")
    assert (folder / written).stat().st_size > 0
    assert main([*words.split(), "--quiet"]) == 2
    assert "exists" in capsys.readouterr().err


@pytest.mark.parametrize(
    "words",
    [
        "predict fit --data run.csv",
        "compare fit fit",
        "suspects fit",
        "wind --data run.csv",
        "fill",
        "unroll",
        "mission mission.toml",
        "life mission.toml",
        "examples",
    ],
)
def test_what_would_neither_print_nor_write_says_so(folder, monkeypatch, capsys, words):
    monkeypatch.chdir(folder)
    assert main([*words.split(), "--quiet"]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.startswith(
        "giajax: --quiet suppresses all tables, and no output file is given: add --"
    )
