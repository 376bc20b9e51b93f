"""`giajax paper`: figures and tables of the paper by name."""

import json

import pytest

from giajax.cli import main


@pytest.mark.quick
def test_an_unknown_figure_is_refused(tmp_path, capsys):
    assert main(["paper", "fig7", "--out", str(tmp_path)]) == 2
    assert "there is no figure 'fig7': use one of fig5" in capsys.readouterr().err


@pytest.mark.quick
def test_nothing_is_written_over(tmp_path, capsys):
    (tmp_path / "fig9.json").write_text("mine")
    assert main(["paper", "fig9", "--out", str(tmp_path)]) == 2
    assert "fig9.json exists and is not written over" in capsys.readouterr().err
    assert main(["paper", "all", "--out", str(tmp_path)]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["fig9.json"]


@pytest.mark.slow
def test_it_prints_and_writes(tmp_path, capsys):
    folder = tmp_path / "new"
    assert main(["paper", "fig9", "--out", str(folder)]) == 0
    said = capsys.readouterr().out
    row = next(line.split() for line in said.splitlines() if line.startswith("-60 "))
    assert row[1] == "outer"
    # 0.3 N m at -60 deg without corrections.
    assert float(row[3]) == pytest.approx(2.93, abs=0.005)
    assert sorted(path.name for path in folder.iterdir()) == ["fig9.csv", "fig9.json", "fig9.png"]
    record = json.loads((folder / "fig9.json").read_text())
    assert "no coordinates" in record["sources"]["assumed"]
    assert main(["paper", "fig9", "--out", str(folder)]) == 2
    assert main(["paper", "fig9", "--out", str(folder), "--force", "--quiet"]) == 0
