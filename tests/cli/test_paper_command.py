"""`giajax paper`: figures and tables of the paper by name."""

import json

import pytest

import giajax.apps.paper
from docs.machinery import browse
from giajax.apps.paper import FIGURES, Reproduced, Sources
from giajax.cli import main
from giajax.report import new_figure

# The last figure takes hours, and is only made with an option.
NAMES = tuple(FIGURES)[:-1]


@pytest.mark.quick
def test_an_unknown_figure_is_refused(tmp_path, capsys):
    assert main(["paper", "fig7", "--out", str(tmp_path)]) == 2
    assert "the figure 'fig7' does not exist: use one of fig5" in capsys.readouterr().err


@pytest.mark.quick
def test_nothing_is_written_over(tmp_path, capsys):
    (tmp_path / "fig9.json").write_text("mine")
    assert main(["paper", "fig9", "--out", str(tmp_path)]) == 2
    assert "fig9.json exists and is not overwritten" in capsys.readouterr().err
    assert main(["paper", "all", "--out", str(tmp_path)]) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["fig9.json"]


@pytest.mark.quick
def test_only_table_3_has_an_inverse(tmp_path, capsys):
    assert main(["paper", "fig5", "--inverse", "--out", str(tmp_path)]) == 2
    assert "--inverse applies to table3 only, not to fig5" in capsys.readouterr().err


@pytest.fixture
def made(monkeypatch):
    """Replace the figures by simple ones and record their names; the third one is interrupted."""
    names = []

    def make(name):
        if len(names) == 2 and names[-1] != "again":
            names.append("again")
            raise KeyboardInterrupt
        names.append(name)
        figure = new_figure(4, 3, name, "A line.")
        figure.subplots().plot([0, 1])
        sources = Sources("a.", "b.", "c.")
        return Reproduced(f"This is {name}", sources, figure, ("n",), ((1,),), {"n": [1]})

    def reproduce(asked, recordings, *, progress):
        return ((name, make(name)) for name in asked)

    monkeypatch.setattr(giajax.apps.paper, "reproduce", reproduce)
    return names


@pytest.mark.quick
def test_all_goes_on_where_it_was_stopped(tmp_path, capsys, made):
    words = ["paper", "all", "--out", str(tmp_path)]
    assert main(words) == 130
    assert made == [*NAMES[:2], "again"]
    assert main(words) == 0
    assert made == [*NAMES[:2], "again", *NAMES[2:]]
    assert f"already complete: {NAMES[0]}, {NAMES[1]} (use --force" in capsys.readouterr().err
    page = (tmp_path / "index.html").read_text()
    assert "Content-Security-Policy" in page
    assert [f"This is {name}" in page for name in NAMES] == [True] * len(NAMES)
    # Complete figures are kept. Incomplete ones may belong to the user, and are not overwritten.
    (tmp_path / "fig12.png").write_bytes(b"half")
    assert main(words) == 2
    assert "fig12.png exists and is not overwritten" in capsys.readouterr().err
    (tmp_path / "fig12.png").unlink()
    (tmp_path / "fig12.csv").unlink()
    (tmp_path / "fig12.json").unlink()
    assert main([*words, "--quiet"]) == 0
    assert made[len(NAMES) + 1 :] == ["fig12"]
    # A page of the user is not overwritten, either.
    (tmp_path / "index.html").write_text("mine")
    assert main(words) == 2
    assert "index.html exists and is not overwritten" in capsys.readouterr().err
    assert (tmp_path / "index.html").read_text() == "mine"
    assert main([*words, "--force"]) == 0
    assert made[len(NAMES) + 2 :] == list(NAMES)


def test_the_page_in_a_browser(tmp_path, made, browser):
    words = ["paper", "all", "--out", str(tmp_path), "--quiet"]
    assert [main(words) for _ in range(2)] == [130, 0]
    assert browse.opened(tmp_path, browser) == []


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
