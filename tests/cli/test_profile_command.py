"""`giajax profile` as users run it: its files, which it extends but does not overwrite."""

import json
import shutil

import pytest

from giajax.cli import main
from giajax.studies import load_profiles
from page_reader import Page, loaded_from_elsewhere


@pytest.fixture(scope="module")
def fit(muscle_fit, tmp_path_factory):
    """A copy of the fit of a muscle, without its page."""
    folder = tmp_path_factory.mktemp("profile") / "fit"
    return shutil.copytree(muscle_fit, folder, ignore=shutil.ignore_patterns("report.html"))


def test_profiles_are_written_added_to_and_shown(fit, capsys):
    free = [
        path
        for path, one in json.loads((fit / "result.json").read_text())["parameters"].items()
        if one["free"] and one["standard_error"]
    ]
    assert main(["profile", str(fit), "--parameter", free[0]]) == 0
    shown = capsys.readouterr()
    assert shown.out.split("\n")[1].startswith(free[0])
    assert "2 of 2 sides of profiles done" in shown.err
    assert (fit / "profiles.png").stat().st_size > 5000
    first = load_profiles(fit)
    assert list(first.profiles) == free[:1]

    # Another profile is added. The first one is not repeated.
    assert (
        main(["profile", str(fit), "--parameter", free[0], "--parameter", free[1], "--no-figures"])
        == 0
    )
    assert "2 of 2 sides" in capsys.readouterr().err
    both = load_profiles(fit)
    assert list(both.profiles) == free[:2]
    assert both[free[0]] == first[free[0]]

    page = fit.parent / "page.html"
    assert main(["report", str(fit), "--page", str(page), "--quiet"]) == 0
    parsed = Page(page.read_bytes())
    assert loaded_from_elsewhere(page.read_bytes()) == []
    assert "profiles" in parsed.headings
    low, high = both[free[0]].interval
    assert low < both[free[0]].value < high
    assert f"{low:.5g} .. {high:.5g}" in parsed.text

    # Profiles of another level or another fit are neither overwritten nor shown.
    assert main(["profile", str(fit), "--parameter", free[0], "--level", "0.9"]) == 2
    assert "was computed for the level 0.95: use --force to overwrite it" in capsys.readouterr().err
    record = json.loads((fit / "profiles.json").read_text())
    (fit / "profiles.json").write_text(json.dumps({**record, "fit": "0"}))
    assert main(["profile", str(fit), "--parameter", free[0]]) == 2
    assert "was computed for another fit: use --force" in capsys.readouterr().err
    assert main(["report", str(fit), "--page", str(page), "--quiet", "--force"]) == 0
    assert "profiles" not in Page(page.read_bytes()).headings


def test_what_cannot_be_profiled_is_one_sentence(fit, tmp_path, capsys):
    for words, sentence in [
        ([str(tmp_path)], "does not exist: give the folder of a finished fit"),
        (
            [str(fit), "--level", "95"],
            "the level is 95: give a level between 0 and 1, such as 0.95",
        ),
        ([str(fit), "--parameter", "muscle.hat"], "'muscle.hat' was neither free in this fit"),
    ]:
        assert main(["profile", *words, "--force"]) == 2
        assert sentence in capsys.readouterr().err
