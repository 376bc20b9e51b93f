"""`giajax sensitivity`: the figure and the tables of a planned or recorded run."""

import csv

import numpy as np
import pytest

from giajax.cli import main

SHORT = ["--links", "3", "--duration", "3"]
DRAG = ["--parameter", "air.drag_coefficient"]


@pytest.mark.slow
def test_a_planned_run_has_a_picture_and_two_tables(tmp_path, capsys):
    out = tmp_path / "drag"
    assert main(["sensitivity", *DRAG, *SHORT, "--out", str(out)]) == 0
    assert "link03" in capsys.readouterr().out
    assert (out / "sensitivity.png").read_bytes().startswith(b"\x89PNG")
    heading, *rows = csv.reader((out / "sensitivity.csv").read_text().splitlines())
    assert heading[:4] == ["parameter", "unit", "time_s", "link01_x (m)"]
    assert len(rows) == 31
    table = np.asarray([row[2:] for row in rows], dtype=float)
    assert np.all(table[:5, 1:] == 0)
    assert np.abs(table[-1, -1]) > 0.01
    bodies = list(csv.DictReader((out / "information.csv").read_text().splitlines()))
    assert [row["body"] for row in bodies] == ["link01", "link02", "link03", "all"]
    assert sum(float(row["share_percent"]) for row in bodies[:3]) == pytest.approx(100, abs=1e-3)
    # No file is overwritten.
    assert main(["sensitivity", *DRAG, *SHORT, "--out", str(out)]) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--parameter", "air.drag"], "'air.drag_coefficient'"),
        ([*DRAG, "--noise", "position_m=0"], "positive"),
        ([*DRAG, "--step", "1=3", "--command", "x.csv"], "only one source"),
        ([*DRAG, "--data", "none.csv", "--wind", "0,0,1"], "omit the options"),
    ],
)
def test_one_sentence(tmp_path, capsys, options, words):
    assert main(["sensitivity", *SHORT[2:], *options, "--out", str(tmp_path / "o")]) == 2
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
