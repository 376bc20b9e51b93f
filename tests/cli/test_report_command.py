"""`giajax report` and `giajax fit --report` as users run them, for several kinds of models."""

import shutil
from pathlib import Path

import pytest

from giajax import load_result
from giajax.cli import main
from giajax.report import _pages
from giajax.runtime.text import install_command
from page_reader import Page, loaded_from_elsewhere

DATA = Path(__file__).resolve().parents[2] / "data" / "synthetic"


@pytest.fixture
def fit(muscle_fit):
    return muscle_fit


def test_a_fit_writes_its_page_and_the_next_one_removes_it(fit, tmp_path):
    page = (fit / "report.html").read_bytes()
    assert b"Content-Security-Policy" in page
    assert loaded_from_elsewhere(page) == []
    parsed = Page(page)
    assert "arm" not in parsed.headings  # a muscle has no view of an arm
    assert f"giajax fit --again {fit / 'result.json'}" in parsed.text
    assert load_result(fit).runs[0].sha256 in parsed.text
    shutil.copytree(fit, tmp_path / "fit")
    again = ["fit", "--data", str(fit.parent / "muscle.csv"), "--out", str(tmp_path / "fit")]
    assert main([*again, "--no-figures", "--quiet"]) == 0
    assert not (tmp_path / "fit" / "report.html").exists()


def test_a_page_of_a_result_is_not_written_over(fit, tmp_path, capsys):
    out = tmp_path / "page.html"
    command = ["report", str(fit), "--page", str(out)]
    assert main(command) == 0
    assert str(out) in capsys.readouterr().out
    first = out.read_bytes()
    assert main(command) == 2
    assert "--force" in capsys.readouterr().err
    assert out.read_bytes() == first
    assert main([*command, "--force", "--quiet"]) == 0
    assert main(["report", str(fit)]) == 2  # the page of the fit exists
    assert capsys.readouterr().out == ""


def test_a_page_of_someones_own_stays(fit, tmp_path, capsys):
    (tmp_path / "report.html").write_text("my own report")
    run = ["fit", "--data", str(DATA / "muscle.csv"), "--out", str(tmp_path), "--report"]
    assert main(run) == 2
    assert "was not made by giajax" in capsys.readouterr().err
    assert not (tmp_path / "result.json").exists()
    assert (tmp_path / "report.html").read_text() == "my own report"


def test_a_place_that_takes_no_page_is_told_before_the_fit(tmp_path, capsys):
    run = ["fit", "--data", str(DATA / "muscle.csv"), "--report", "--force", "--out"]
    assert main([*run, str(tmp_path / "page.html")]) == 2
    assert "is a file" in capsys.readouterr().err
    (tmp_path / "fit" / "report.html").mkdir(parents=True)
    assert main([*run, str(tmp_path / "fit")]) == 2
    assert "is a folder" in capsys.readouterr().err
    assert not (tmp_path / "fit" / "result.json").exists()


def test_what_is_missing_is_said_before_the_fit(fit, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(_pages, "_NEEDED", ("no_such_library",))
    run = ["fit", "--data", str(DATA / "muscle.csv"), "--out", str(tmp_path / "x"), "--report"]
    for command in (run, ["report", str(fit), "--page", str(tmp_path / "page.html")]):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert install_command("report") in said
        assert said.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(("name", "seen"), [("joint_loops", False), ("joint", True)])
def test_models_of_other_kinds(name, seen, tmp_path):
    run = ["fit", "--data", str(DATA / f"{name}.csv"), "--out", str(tmp_path), "--report"]
    main([*run, "--no-figures", "--quiet", "--no-suspects", "--max-iterations", "3"])
    parsed = Page((tmp_path / "report.html").read_bytes())
    assert ("arm" in parsed.headings) == seen
    assert [a["data-plot"] for _, a in parsed.tags if "data-plot" in a]
