"""`giajax predict`: errors of a model on runs that it was not fitted to."""

import csv

import pytest
from test_fit_command import giajax

from small_arm import STARTS, make_run


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("predicting")
    data = make_run(folder)
    status, _, error = giajax("fit", "--data", data, *STARTS, "--out", folder / "out", "--quiet")
    assert (status, error) == (0, "")
    return folder, data


def test_errors_of_two_models_and_their_ratio(fitted):
    folder, data = fitted
    wrong = folder / "wrong.toml"
    wrong.write_text('[arm]\nlinks = 4\n[arm.parameters]\n"air.drag_coefficient" = 0.3\n')
    table = folder / "errors.csv"
    asked = ("predict", "--model", folder / "out", "--against", wrong, "--data", data)
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


def test_one_channel_of_one_model(fitted):
    folder, data = fitted
    status, out, _ = giajax(
        "predict", "--model", folder / "out", "--data", data, "--channels", "link04_z"
    )
    assert status == 0
    heading, row = out.splitlines()
    assert "ratio" not in heading
    assert row.split()[1] == "link04_z"
