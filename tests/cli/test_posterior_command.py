"""`giajax posterior` as users run it, and its results on a page."""

import dataclasses
import json
import shutil

import pytest

from giajax import load_result
from giajax.cli import main
from giajax.cli._studies import _is_unfinished
from giajax.report import sections
from giajax.studies import PosteriorSummary
from page_reader import Page

FEW = ["--draws", "60", "--warmup", "60"]


@pytest.fixture(scope="module")
def fit(muscle_fit, tmp_path_factory):
    """A copy of the fit of a muscle, without its page, with two short chains."""
    out = tmp_path_factory.mktemp("posterior") / "fit"
    shutil.copytree(muscle_fit, out, ignore=shutil.ignore_patterns("report.html"))
    assert main(["posterior", str(out), "--chains", "2", *FEW, "--quiet"]) == 0
    return out


def test_it_writes_what_it_found_beside_the_result(fit, capsys):
    known = json.loads((fit / "posterior.json").read_text())
    result = json.loads((fit / "result.json").read_text())
    free = {path for path, one in result["parameters"].items() if one["free"]}
    # Data of a muscle at rest give no information about the onset of its friction.
    assert known["held"] == ["friction.presliding"]
    assert known["parameters"].keys() == free - {"friction.presliding"}
    assert (known["chains"], known["draws"], known["cost"]) == (2, 60, result["cost"])
    for path in known["parameters"]:
        one, linear = known["parameters"][path], result["parameters"][path]["interval"]
        assert one["linear"] == pytest.approx(linear)
        assert linear[0] < one["mean"] < linear[1]
    assert any("use more draws" in sentence for sentence in known["warnings"])
    for name in (".png", "_trace.png", "_bands.png", "_bands.csv"):
        assert (fit / f"posterior{name}").stat().st_size > 1000
    assert main(["posterior", str(fit), "--chains", "2", *FEW]) == 2
    assert "posterior.json exists" in capsys.readouterr().err


def test_more_chains_keep_those_that_are_there_and_a_page_shows_them(fit, tmp_path, capsys):
    shutil.copytree(fit, tmp_path / "fit")
    folder = tmp_path / "fit"
    (folder / "posterior.npz").write_bytes(b"of an earlier call, without ArviZ")
    (folder / "posterior.nc").write_bytes(b"of an earlier call, with ArviZ")
    before = {path.name: path.read_bytes() for path in (folder / "posterior_chains").iterdir()}
    assert main(["posterior", str(folder), "--chains", "3", "--force", *FEW]) == 0
    out = capsys.readouterr().out
    assert "3 chains of 60 draws" in out
    (held,) = (line for line in out.splitlines() if line.startswith("friction.presliding "))
    assert " not determined " in held
    assert out.endswith(f"\nnext: giajax report {folder}\n")
    after = {path.name: path.read_bytes() for path in (folder / "posterior_chains").iterdir()}
    assert len(after) == 3
    assert before.items() <= after.items()
    (draws,) = (path for path in folder.glob("posterior.n*"))
    assert not draws.read_bytes().startswith(b"of an earlier call")

    assert main(["report", str(folder), "--quiet"]) == 0
    page = Page((folder / "report.html").read_bytes())
    assert "posterior" in page.headings
    assert "3 chains of 60 draws" in page.text
    # The posterior of another fit is not shown.
    result = load_result(folder)
    other = dataclasses.replace(result, cost=1.01 * result.cost)
    assert [section.id for section in sections(result, folder / "result.json")] == ["posterior"]
    assert sections(other, folder / "result.json") == []


def test_only_what_is_unfinished_of_this_fit_is_written_over(fit, tmp_path):
    result = load_result(fit)
    known = PosteriorSummary.of_json((fit / "posterior.json").read_text())
    path = tmp_path / "posterior.json"
    for asked, cost, unfinished in (
        (2, result.cost, False),
        (3, result.cost, True),
        (3, 1.01 * result.cost, False),
    ):
        path.write_text(dataclasses.replace(known, asked=asked, cost=cost).to_json())
        assert _is_unfinished(path, result) is unfinished
