"""`giajax bootstrap` and `giajax influence`: a stored fit is repeated from its files."""

import dataclasses
import json
import shutil
from pathlib import Path

import pytest

from giajax import load_result, read_run
from giajax.cli import _studies as _bootstrap, main
from giajax.studies import Bootstrap, Influence

EARLIER = Path(__file__).resolve().parents[1] / "earlier" / "hysteresis"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A stored fit of one free loop, which compiles quickly."""
    folder = tmp_path_factory.mktemp("repeated") / "fit"
    shutil.copytree(EARLIER, folder)
    return folder


def bootstrap(folder, *options):
    return main(["bootstrap", str(folder), "--data", str(folder / "run.csv"), *options])


def test_a_fit_is_repeated_and_the_files_lie_beside_it(folder, capsys):
    kept = folder / "parts"
    assert bootstrap(folder, "--size", "3", "--folder", str(kept)) == 0
    printed = capsys.readouterr()
    assert "1 of 1 parts done" in printed.err
    assert "3 repetitions, seed 0" in printed.out
    found = Bootstrap.of_json((folder / "bootstrap.json").read_bytes())
    assert (found.size, found.asked) == (3, 3)
    for path in found.parameters:
        assert path in printed.out
    assert (folder / "bootstrap.png").read_bytes()[:4] == b"\x89PNG"
    # No file is overwritten, and finished repetitions can be written to another file.
    assert bootstrap(folder, "--size", "3") == 2
    assert "exists and is not overwritten" in capsys.readouterr().err
    options = ["--folder", str(kept), "--out", str(folder / "again"), "--no-figures", "--json"]
    assert bootstrap(folder, "--size", "3", *options) == 0
    again = folder / "again" / "bootstrap.json"
    assert json.loads(capsys.readouterr().out) == json.loads(again.read_text())
    assert Bootstrap.of_json(again.read_bytes()) == found


def test_what_spans_do_is_told_and_drawn(folder, capsys):
    words = ["influence", str(folder), "--data", str(folder / "run.csv"), "--spans", "3"]
    assert main([*words, "--rows", "2"]) == 0
    printed = capsys.readouterr().out
    assert "and 1 more with less influence" in printed
    found = Influence.of_json((folder / "influence.json").read_bytes())
    assert [part.kind for part in found.parts] == ["span"] * 3
    assert found.parts[0].name in printed
    assert (folder / "influence.png").read_bytes()[:4] == b"\x89PNG"
    assert main(words) == 2
    assert "exists and is not overwritten" in capsys.readouterr().err


def test_a_self_test_is_written_beside_the_result_or_says_why_not(
    folder, tmp_path, capsys, monkeypatch
):
    """`giajax fit --self-test` does this when the fit has ended."""
    monkeypatch.setattr(_bootstrap, "_SELF_TEST", 3)
    result, run = load_result(folder), read_run(folder / "run.csv")
    files = _bootstrap.self_test(result, [run], tmp_path, shown=True)
    assert files == [tmp_path / "bootstrap.json", tmp_path / "bootstrap.png"]
    assert Bootstrap.of_json(files[0].read_bytes()).size == 3
    assert "3 of 3 fits converged (100 %)" in capsys.readouterr().out
    stopped = dataclasses.replace(result, status="not_converged")
    assert _bootstrap.self_test(stopped, [run], tmp_path, shown=False) == []
    assert "the self-test is omitted: the fit did not converge" in capsys.readouterr().err


@pytest.mark.quick
def test_what_is_no_fit_or_no_size_is_told_in_a_sentence(tmp_path, capsys):
    assert main(["bootstrap", str(tmp_path)]) == 2
    assert "does not exist: give the folder of a finished fit" in capsys.readouterr().err
    assert main(["bootstrap", str(tmp_path), "--size", "1"]) == 2
    assert "--size" in capsys.readouterr().err
    assert main(["influence", str(tmp_path)]) == 2
    assert "does not exist: give the folder of a finished fit" in capsys.readouterr().err
