"""`giajax explain`: a run is explained, stored, and continued from its files."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from test_fit_command import giajax

from docs.machinery import browse
from giajax import load_result, read_run, write_run
from giajax.apps.synthetic import synthesise
from giajax.mechanics.arm import takeichi_20m
from giajax.models import ArmModel
from giajax.schema.parameters import replace
from small_arm import LINKS, NOISE, START, TRUTH

ROOT = Path(__file__).resolve().parents[2]
STEPS = ["-", "muscle.end_correction"]


@pytest.fixture(scope="module")
def explained(tmp_path_factory):
    """An explanation of a muscle whose end correction of 1.7 is held fixed at 1.5."""
    folder = tmp_path_factory.mktemp("explained")
    for name in ("muscle.csv", "muscle.toml"):
        shutil.copy(ROOT / "data" / "synthetic" / name, folder / name)
    wrong = ("--fix", "muscle.end_correction=1.5", "--out", folder / "why", "--no-figures")
    status, out, error = giajax("explain", "--data", folder / "muscle.csv", *wrong)
    assert status == 0, error
    return folder / "why", out, error


def steps(folder):
    return [step["change"] for step in json.loads((folder / "explain.json").read_text())["steps"]]


def test_steps_parameters_files_and_a_page(explained):
    folder, out, error = explained
    assert steps(folder) == STEPS
    assert "the data support muscle.end_correction in addition to the first model" in out
    assert "verdict: adequate" in out
    assert "step 1: muscle.end_correction: chi-square" in error
    result = load_result(folder)
    assert result.parameters["muscle.end_correction"].value == pytest.approx(1.7, abs=0.02)
    page = (folder / "explain.html").read_text()
    assert "Model extensions supported by the data" in page
    assert "Content-Security-Policy" in page
    # The final result can be used by all other commands.
    status, _, _ = giajax("predict", folder, "--data", folder.parent / "muscle.csv")
    assert status == 0
    assert all(load_result(path) for path in (folder / "fits").glob("*.json"))


def test_the_page_in_a_browser(explained, browser):
    assert browse.opened(explained[0], browser) == []


def test_a_journal_that_was_cut_off_goes_on_to_the_same(explained, tmp_path):
    folder = tmp_path / "why"
    shutil.copytree(explained[0], folder)
    whole = (folder / "explain.json").read_bytes()
    lines = (folder / "explain.jsonl").read_text().splitlines()
    # The journal ends while the first step is being tried.
    (folder / "explain.jsonl").write_text("\n".join(lines[:4]) + "\n")
    for name in ("explain.json", "explain.html", "result.json"):
        (folder / name).unlink()
    asked = ("explain", "--resume", folder, "--no-figures", "--no-report", "--quiet")
    assert giajax(*asked) == (0, "", "")
    assert (folder / "explain.json").read_bytes() == whole
    # Fits in the journal are not repeated; only the lost fit is added.
    before = len(list((explained[0] / "fits").iterdir()))
    assert len(list((folder / "fits").iterdir())) == before + 1
    assert not (folder / "explain.html").exists()
    # A journal with an impossible entry is refused, and no file outside the fits is read.
    for line, why in (
        ("[" * 5_000, "nested more than"),
        ('{"name": "first"}', "it is not a valid line of this journal"),
        ("[]", "is [], but must be an object"),
        ('{"name": "first", "fit": "../../other.json"}', "it does not name the file of a fit"),
        ('{"name": "first", "fit": 3}', "fit is 3, but must be text"),
        ("\udcff", "not JSON"),
    ):
        text = "\n".join([lines[0], line, *lines[2:]])
        (folder / "explain.jsonl").write_text(text, errors="surrogateescape")
        status, out, error = giajax(*asked)
        assert (status, out, error.count("\n")) == (2, "", 1)
        assert "explain.jsonl" in error
        assert why in error
    (folder / "explain.jsonl").write_text(lines[0].rstrip("}") + ', "tries": 0}')
    assert "specifies fewer than 1 suspect to try" in giajax(*asked)[2]
    # When the budget is used up, the steps so far are reported, with the command that continues.
    (folder / "explain.jsonl").write_text("\n".join(lines[:4]) + "\n")
    status, out, error = giajax(*asked[:-1], "--budget", "0.001s")
    assert (status, steps(folder)) == (0, STEPS[:1])
    assert "was exhausted" in out
    assert f"giajax explain --resume {folder}" in error
    # Existing files are neither overwritten nor mixed with other settings.
    other = ("explain", "--data", folder.parent / "none.csv", "--out", folder)
    for options, sentence in (
        (("explain", "--resume", tmp_path), "contains no explanation to continue"),
        (("explain", "--resume", folder, "--loss", "huber"), "omit the other options"),
        (
            (*other[:2], explained[0].parent / "muscle.csv", *other[3:]),
            "already contains an explanation",
        ),
        (("explain",), "give at least one run"),
    ):
        status, _, error = giajax(*options)
        assert status == 2
        assert sentence in error
        assert error.count("\n") == 1


def test_it_goes_on_elsewhere_begins_anew_and_leaves_what_is_not_its_own(tmp_path, monkeypatch):
    for name in ("muscle.csv", "muscle.toml"):
        shutil.copy(ROOT / "data" / "synthetic" / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    Path("why/fits").mkdir(parents=True)
    Path("why/fits/sweep.json").write_text("of a sweep")
    asked = ("explain", "--data", "muscle.csv", "--out", "why", "--no-figures", "--no-report")
    asked = (*asked, "--fix", "muscle.end_correction=1.5", "--max-steps", "0", "--quiet")
    status, _, error = giajax(*asked)
    assert status == 2
    assert "why/fits contains files that do not belong to an explanation" in error
    with monkeypatch.context() as without:
        without.setattr("giajax.report._pages._NEEDED", ("markdown_of_nobody",))
        status, _, error = giajax(*asked[:5])
        assert status == 2
        assert re.search(r"pip install .*\[report\]'?, or omit the page with --no-report", error)
    # The first fit is stopped, so nothing can be continued.
    status, _, error = giajax(*asked, "--force", "--budget", "0.001s")
    assert status == 1
    assert error == "giajax: the time budget was exhausted: this is the result so far\n"
    assert giajax(*asked, "--force") == (0, "", "")
    whole = Path("why/explain.json").read_bytes()
    assert giajax(*asked, "--force") == (0, "", "")
    assert Path("why/explain.json").read_bytes() == whole
    assert Path("why/fits/sweep.json").read_text() == "of a sweep"
    Path("elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    again = ("explain", "--resume", "../why", "--no-figures", "--no-report", "--quiet")
    assert giajax(*again) == (0, "", "")
    assert Path("../why/explain.json").read_bytes() == whole
    status, _, error = giajax(*again, "--force")
    assert status == 2
    assert "omit the other options" in error


@pytest.mark.long
def test_a_turned_camera_and_a_wind_are_found_beside_what_is_always_uncertain(tmp_path):
    """The truth is known: the camera is free, and both effects are omitted at once."""
    times = np.linspace(0.0, 6.0, 61)
    stated = ArmModel(takeichi_20m(LINKS))
    missing = {"camera.rotation": [0.0, 0.0, 0.05], "air.wind": [0.0, 0.1, 0.05]}
    run = synthesise(
        replace(stated, {**TRUTH, **missing}),
        times,
        {
            "joint01_command": 0.6 * np.clip(times / 0.5, 0, 1),
            "joint02_command": -0.5 * np.clip(times / 0.5, 0, 1),
        },
        [f"link{link:02d}_{axis}" for link in (2, 4) for axis in "xyz"],
        noise={"position": NOISE},
        seed=3,
        definition={"uncertainty": {"defaults": True}, "noise": {"position_m": NOISE}},
        constants=stated,
    )
    path = write_run(tmp_path / "run.csv", run.times, run.values, definition=run.definition)
    start = [word for each in START.items() for word in ("--start", "{}={}".format(*each))]
    options = ("--out", tmp_path / "why", "--no-figures", "--no-report", "--tries", "2", "--quiet")
    status, _, error = giajax("explain", "--data", path, *start, *options)
    assert (status, error) == (0, "")
    record = json.loads((tmp_path / "why" / "explain.json").read_text())
    found = {step["change"].partition("[")[0] for step in record["steps"][1:]}
    # To first order, a rotation of the base is equivalent to a rotation of the camera.
    assert "air.wind" in found
    assert found & {"camera.rotation", "base_rotation"}
    assert record["verdict"] == "adequate"
    (drag,) = [one for one in record["parameters"] if one["path"] == "air.drag_coefficient"]
    assert abs(drag["value"] - TRUTH["air.drag_coefficient"]) < 3 * drag["total_error"]
    assert load_result(tmp_path / "why").nuisances
    assert read_run(path).name == "run"
