"""`giajax suspects`: omitted effects of a stored fit, as tables and as JSON."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from giajax import load_result
from giajax.cli import main

ROOT = Path(__file__).resolve().parents[2]
# The true end correction is 1.7, but it is held at another value.
WRONG = ["--fix", "muscle.end_correction=1.5"]
HELD_OUT = ["--validation", str(ROOT / "data" / "synthetic" / "muscle.csv")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A fit with a wrong fixed value, next to a copy of its run."""
    folder = tmp_path_factory.mktemp("suspects")
    for name in ("muscle.csv", "muscle.toml"):
        shutil.copy(ROOT / "data" / "synthetic" / name, folder / name)
    run = ["fit", "--data", str(folder / "muscle.csv"), *WRONG, "--out", str(folder / "fit")]
    assert main([*run, "--no-figures", "--quiet", "--no-suspects"]) == 0
    return folder


def test_tables_of_suspects_systematic_errors_and_the_ladder(folder, capsys):
    options = ["--ladder", *HELD_OUT, "--systematic", "--uncertainty", "muscle.diameter=1e-5"]
    assert main(["suspects", str(folder / "fit"), *options]) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0].split()[:3] == ["suspect", "fixed", "value"]
    path, held, estimate = lines[1].split()[:3]
    assert (path, held) == ("muscle.end_correction", "1.5")
    assert float(estimate) == pytest.approx(1.7, abs=0.02)
    assert "not testable, " in printed.out
    assert "both " in printed.out
    (rung,) = [line for line in lines if line.startswith("muscle.end") and "+-" in line]
    assert len(rung.split("+-")) > 2
    assert "BIC" in printed.out
    assert "the fit: chi-square" in printed.err
    assert "muscle.end_correction: chi-square" in printed.err
    assert "no suspect that could be freed is significant" in lines or "BIC larger" in printed.out


def test_json_and_a_result_with_its_suspects(folder, capsys):
    out = folder / "asked"
    assert main(["suspects", str(folder / "fit"), "--json", "--out", str(out)]) == 0
    printed = capsys.readouterr()
    facts = json.loads(printed.out)
    first = facts["suspects"][0]
    assert first["path"] == "muscle.end_correction"
    assert first["p_value"] < 1e-3
    assert first["chi_square_drop"] > 10
    assert facts["asked"] == len([row for row in facts["suspects"] if row["testable"]])
    stored = load_result(out / "suspects.json")
    assert stored.suspects[0].path == "muscle.end_correction"
    assert stored.suspects[0].p_value == first["p_value"]
    assert stored.systematic[0].path in {item["path"] for item in facts["systematic"]}
    assert load_result(folder / "fit").suspects == ()
    # A value of --out that ends in .json is a file while old forms are supported.
    assert main(["suspects", str(folder / "fit"), "--json", "--out", str(folder / "old.json")]) == 0
    again = capsys.readouterr()
    assert again.out == printed.out
    assert again.err.startswith(
        "note: giajax suspects --out FILE.json is now giajax suspects --out"
    )
    assert (folder / "old.json").read_bytes() == (out / "suspects.json").read_bytes()
    # No file is overwritten.
    assert main(["suspects", str(folder / "fit"), "--json", "--out", str(out)]) == 2
    assert "--force" in capsys.readouterr().err


def test_a_run_that_has_moved_or_changed(folder, tmp_path, capsys):
    result = str(folder / "fit" / "result.json")
    elsewhere = tmp_path / "elsewhere.csv"
    shutil.copy(folder / "muscle.csv", elsewhere)
    shutil.copy(folder / "muscle.toml", tmp_path / "elsewhere.toml")
    assert main(["suspects", result, "--data", str(elsewhere), "--json"]) == 0
    here = json.loads(capsys.readouterr().out)
    assert here["suspects"][0]["path"] == "muscle.end_correction"
    other = str(ROOT / "data" / "synthetic" / "muscle_empirical.csv")
    assert main(["suspects", result, "--data", other]) == 2
    said = capsys.readouterr().err
    assert "do not have the content of" in said
    assert said.count("\n") == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["none"], "does not exist"),
        (["{fit}", "--validation", "x.csv"], "add --ladder"),
        (["{fit}", "--tries", "3"], "add --ladder"),
        (["{fit}", "--each", "muscle.diameter"], "has no elements that can be tested one by one"),
        (["{fit}", "--uncertainty", "muscle.diameter"], "must be PATH=VALUE"),
        (["{fit}", "--uncertainty", "muscle.diameter=0"], "is not positive: give"),
    ],
)
def test_one_sentence(folder, capsys, options, words):
    words_typed = [option.format(fit=folder / "fit") for option in options]
    assert main(["suspects", *words_typed]) == 2
    said = capsys.readouterr().err
    assert words in said


def test_a_changed_file_is_refused(folder, tmp_path, capsys):
    moved = tmp_path / "moved"
    shutil.copytree(folder, moved)
    record = json.loads((moved / "fit" / "result.json").read_text())
    record["runs"][0]["path"] = str(moved / "muscle.csv")
    (moved / "fit" / "result.json").write_text(json.dumps(record))
    lines = (moved / "muscle.csv").read_text().splitlines()
    (moved / "muscle.csv").write_text("\n".join(lines[:-1]) + "\n")
    sidecar = (moved / "muscle.toml").read_text().splitlines()
    (moved / "muscle.toml").write_text(
        "\n".join(line for line in sidecar if not line.startswith("sha256")) + "\n"
    )
    assert main(["suspects", str(moved / "fit")]) == 2
    assert "has changed since the fit: " in capsys.readouterr().err
    (moved / "muscle.csv").unlink()
    assert main(["suspects", str(moved / "fit")]) == 2
    assert "give its new path with --data" in capsys.readouterr().err


def test_a_fit_states_an_uncertainty(folder, tmp_path, capsys):
    run = ["fit", "--data", str(folder / "muscle.csv"), *WRONG, "--out", str(tmp_path / "fit")]
    stated = ["--uncertainty", "muscle.diameter=1e-5", "--no-figures", "--json"]
    assert main([*run, *stated]) == 0
    record = json.loads(capsys.readouterr().out)
    # The model is inadequate, so the fit tests for omitted effects automatically.
    assert record["verdict"]["status"] == "inadequate"
    assert record["suspects"][0]["path"] == "muscle.end_correction"
    assert record["systematic"][0]["path"] == "muscle.diameter"
    assert record["systematic"][0]["stated"]
    assert record["systematic"][0]["uncertainty"] == 1e-5
    assert record["config"]["uncertainty"] == {"muscle.diameter": 1e-5}


def test_a_fit_whose_residuals_show_nothing_is_doubtful_by_what_it_held(folder, tmp_path, capsys):
    wrong = ["--fix", "muscle.end_correction=1.68", "--out", str(tmp_path / "fit")]
    run = ["fit", "--data", str(folder / "muscle.csv"), *wrong, "--no-figures", "--force"]
    assert main([*run, "--strict"]) == 3
    printed = capsys.readouterr()
    assert "testing fixed and omitted parameters" in printed.err
    (line,) = [line for line in printed.out.splitlines() if line.startswith("verdict ")]
    assert "doubtful: " in line
    assert "muscle.end_correction" in line
    assert load_result(tmp_path / "fit").verdict.status == "doubtful"
    # The effects are not tested, and the output does not mention them.
    assert main([*run, "--strict", "--no-suspects", "--quiet"]) == 0
    assert load_result(tmp_path / "fit").verdict.status == "adequate"


def test_a_test_that_fails_loses_no_fit(folder, tmp_path, capsys, monkeypatch):
    def failing(*_, **__):
        raise np.linalg.LinAlgError("SVD did not converge")

    monkeypatch.setattr("giajax.tasks._preparation.with_suspects", failing)
    run = ["fit", "--data", str(folder / "muscle.csv"), "--out", str(tmp_path / "fit"), "--quiet"]
    assert main([*run, "--no-figures"]) == 0
    assert "could not be tested (SVD did not converge): giajax suspects" in capsys.readouterr().err
    assert load_result(tmp_path / "fit").status == "converged"
