"""`giajax compare`: the differences of two results, and results that cannot be compared."""

import dataclasses
import json
import math
import shutil
from pathlib import Path

import pytest

from docs.machinery import browse
from giajax import Prior
from giajax.cli import main
from giajax.fitting import load_result, set_up
from giajax.models import model_for
from giajax.recordings import read_run
from page_reader import Page, loaded_from_elsewhere

DATA = Path(__file__).resolve().parents[2] / "data" / "synthetic"
MUSCLE, OTHER = DATA / "muscle.csv", DATA / "muscle_empirical.csv"
FITTED = {"free": [], "held": ["--fix", "muscle.end_correction=1.5"]}
ASKED = {
    "white": {"noise_model": "white"},
    "robust": {"loss": "huber"},
    "prior": {"priors": {"muscle.dead_band": Prior(25_000.0, deviation=500.0)}},
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two fits of one muscle, and copies of the first with other settings or another recording."""
    folder = tmp_path_factory.mktemp("compare")
    for name, words in FITTED.items():
        quiet = ["--no-figures", "--quiet", "--no-suspects", "--out", str(folder / name)]
        main(["fit", "--data", str(MUSCLE), *words, *quiet])
    result, run = load_result(folder / "free"), read_run(MUSCLE)
    others = {
        name: dataclasses.replace(result, config=set_up(model_for([run]), run, **asked).config)
        for name, asked in ASKED.items()
    }
    data = dataclasses.replace(result.runs[0], sha256=read_run(OTHER).sha256)
    others["other"] = dataclasses.replace(result, runs=(data,))
    for name, other in others.items():
        (folder / name).mkdir()
        (folder / name / "result.json").write_text(other.to_json())
    return folder


def compared(capsys, *paths):
    capsys.readouterr()
    assert main(["compare", *map(str, paths), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def stored(path):
    return json.loads((path / "result.json").read_text())


def test_differences_are_in_joint_standard_errors(folder, capsys):
    facts = compared(capsys, folder / "free", folder / "held")
    rows = {row["path"]: row for row in facts["parameters"]}
    path = "muscle.effectiveness"
    one, other = (stored(folder / name)["parameters"][path] for name in ("free", "held"))
    assert rows[path]["estimates"][1]["value"] == other["value"]
    joint = math.hypot(one["standard_error"], other["standard_error"])
    assert rows[path]["differences"][1] == pytest.approx((other["value"] - one["value"]) / joint)
    assert rows[path]["differences"][0] is None
    # A parameter that one of the fits held fixed has no difference.
    assert rows["muscle.end_correction"]["differences"] == [None, None]
    assert rows["muscle.end_correction"]["estimates"][1]["free"] is False


def test_bic_is_there_for_the_same_data_noise_and_loss(folder, capsys):
    facts = compared(capsys, folder / "free", folder / "held")
    better, worse = facts["results"]
    assert better["bic"] == 0
    costs = [stored(folder / name)["cost"] for name in ("free", "held")]
    # The noise is known, so the BIC uses chi-square, with one parameter less.
    assert worse["bic"] == pytest.approx(2 * (costs[1] - costs[0]) - math.log(285))
    assert (better["parameters"], worse["parameters"]) == (5, 4)
    assert "share its noise" in " ".join(facts["notes"])


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("other", "different data"),
        ("white", "differ in the assumed noise:"),
        ("robust", "differ in the assumed loss:"),
        ("prior", "differ in the assumed prior:"),
    ],
)
def test_what_cannot_be_compared_is_said(folder, capsys, name, why):
    facts = compared(capsys, folder / "free", folder / name)
    assert why in " ".join(facts["notes"])
    assert [column["bic"] for column in facts["results"]] == [None, None]


def test_a_table_and_a_page(folder, tmp_path, capsys):
    hostile = tmp_path / "<script>alert(1)<b>"
    shutil.copytree(folder / "held", hostile)
    out = tmp_path / "compare.html"
    command = ["compare", str(folder / "free"), str(hostile), "--page", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "1.5 (held)" in printed
    assert "BIC" in printed
    page = out.read_bytes()
    assert b"Content-Security-Policy" in page
    assert loaded_from_elsewhere(page) == []
    parsed = Page(page)
    assert len(parsed.programs()) == 1
    assert "b" not in [tag for tag, _ in parsed.tags]
    assert "The results differ by more than their errors" in parsed.text
    assert ["muscle.end_correction", "-"] in [row[:2] for row in parsed.rows]
    assert main(command) == 2
    assert out.read_bytes() == page
    assert main([*command, "--force"]) == 0


def test_what_agrees_is_good_and_nothing_in_common_is_not(folder, tmp_path, capsys):
    for name in ("run_v1.2", "run_v1.3"):
        shutil.copytree(folder / "free", tmp_path / name)
    page = tmp_path / "page.html"
    again = [str(tmp_path / "run_v1.2"), str(tmp_path / "run_v1.3")]
    assert main(["compare", *again, "--page", str(page)]) == 0
    assert "run_v1.3 - run_v1.2" in capsys.readouterr().out
    parsed = Page(page.read_bytes())
    assert ("section", "verdict good") in [(tag, of.get("class")) for tag, of in parsed.tags]
    assert "No parameter that both results determine differs" in parsed.text
    joint = Path(__file__).resolve().parents[1] / "earlier" / "joint"
    assert main(["compare", again[0], str(joint), "--page", str(page), "--force"]) == 0
    parsed = Page(page.read_bytes())
    assert ("section", "verdict doubtful") in [(tag, of.get("class")) for tag, of in parsed.tags]
    assert "so nothing is compared" in parsed.text


def test_pages_in_a_browser(folder, browser, tmp_path):
    """What differs, what agrees, and results with nothing in common."""
    joint = Path(__file__).resolve().parents[1] / "earlier" / "joint"
    for name, other in (("a", folder / "held"), ("b", folder / "free"), ("c", joint)):
        out = ["--page", str(tmp_path / f"{name}.html"), "--quiet"]
        assert main(["compare", str(folder / "free"), str(other), *out]) == 0
    assert browse.opened(tmp_path, browser) == []


def test_one_result_has_nothing_to_be_compared_with(folder, capsys):
    assert main(["compare", str(folder / "free")]) == 2
    assert "at least two" in capsys.readouterr().err
    assert main(["compare", str(folder / "free"), str(folder / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err
