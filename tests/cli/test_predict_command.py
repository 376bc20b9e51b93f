"""`giajax predict`: errors of a model on runs that it was not fitted to."""

import csv

from test_fit_command import giajax


def test_errors_of_two_models_and_their_ratio(arm_fit, tmp_path):
    data, fitted, _ = arm_fit
    wrong = tmp_path / "wrong.toml"
    wrong.write_text('[arm]\nlinks = 4\n[arm.parameters]\n"air.drag_coefficient" = 0.3\n')
    table = tmp_path / "errors.csv"
    asked = ("predict", "--model", fitted, "--against", wrong, "--data", data)
    status, out, error = giajax(*asked, "--out", table)
    assert (status, error) == (0, "")
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert len(rows) == len(out.splitlines()) - 1
    assert all(float(row["ratio"]) < 1 for row in rows)
    assert {row["unit"] for row in rows} == {"m"}
    # Nothing is written over without being told to.
    status, out, error = giajax(*asked, "--out", table)
    assert status == 2
    assert "--force" in error
    assert error.count("\n") == 1


def test_one_channel_of_one_model(arm_fit):
    data, fitted, _ = arm_fit
    status, out, _ = giajax("predict", "--model", fitted, "--data", data, "--channels", "link04_z")
    assert status == 0
    heading, row = out.splitlines()
    assert "ratio" not in heading
    assert row.split()[1] == "link04_z"
