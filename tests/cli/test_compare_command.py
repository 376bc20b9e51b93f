"""`giajax compare`: the differences of two results, and when they cannot be compared."""

import json
import math
import shutil
from pathlib import Path

import pytest

from giajax.cli import main
from page_reader import Page, loaded_from_elsewhere

DATA = Path(__file__).resolve().parents[2] / "data" / "synthetic"
MUSCLE = DATA / "muscle.csv"
CHANGED = {
    "free": [],
    "held": ["--fix", "muscle.end_correction=1.5"],
    "white": ["--noise-model", "white"],
    "robust": ["--loss", "huber"],
    "prior": ["--prior", "muscle.dead_band=25000+-500"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Fits of one muscle, and one of another recording."""
    folder = tmp_path_factory.mktemp("compare")
    fits = {name: ["--data", str(MUSCLE), *options] for name, options in CHANGED.items()}
    fits["other"] = ["--data", str(DATA / "muscle_empirical.csv")]
    for name, words in fits.items():
        quiet = ["--no-figures", "--quiet", "--no-suspects"]
        main(["fit", *words, *quiet, "--out", str(folder / name)])
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
    # What one of them held has no difference.
    assert rows["muscle.end_correction"]["differences"] == [None, None]
    assert rows["muscle.end_correction"]["estimates"][1]["free"] is False


def test_bic_is_there_for_the_same_data_noise_and_loss(folder, capsys):
    facts = compared(capsys, folder / "free", folder / "held")
    better, worse = facts["results"]
    assert better["bic"] == 0
    costs = [stored(folder / name)["cost"] for name in ("free", "held")]
    # The noise is stated: chi-square, and a parameter less.
    assert worse["bic"] == pytest.approx(2 * (costs[1] - costs[0]) - math.log(285))
    assert (better["parameters"], worse["parameters"]) == (5, 4)
    assert "share its noise" in " ".join(facts["notes"])


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("other", "different data"),
        ("white", "another noise:"),
        ("robust", "another loss:"),
        ("prior", "another prior:"),
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
    command = ["compare", str(folder / "free"), str(hostile), "--out", str(out)]
    assert main(command) == 0
    printed = capsys.readouterr().out
    assert "1.5 (held)" in printed
    assert "BIC" in printed
    page = out.read_bytes()
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
    assert main(["compare", *again, "--out", str(page)]) == 0
    assert "run_v1.3 - run_v1.2" in capsys.readouterr().out
    parsed = Page(page.read_bytes())
    assert ("section", "verdict good") in [(tag, of.get("class")) for tag, of in parsed.tags]
    assert "No parameter that both determine differs" in parsed.text
    joint = Path(__file__).resolve().parents[1] / "earlier" / "joint"
    assert main(["compare", again[0], str(joint), "--out", str(page), "--force"]) == 0
    parsed = Page(page.read_bytes())
    assert ("section", "verdict doubtful") in [(tag, of.get("class")) for tag, of in parsed.tags]
    assert "so nothing is compared" in parsed.text


def test_one_result_has_nothing_to_be_compared_with(folder, capsys):
    assert main(["compare", str(folder / "free")]) == 2
    assert "two or more" in capsys.readouterr().err
    assert main(["compare", str(folder / "free"), str(folder / "none")]) == 2
    assert "does not exist" in capsys.readouterr().err
