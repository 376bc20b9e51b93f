"""The page about the air agrees with the results of its script."""

import importlib.util
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "docs"


def script():
    spec = importlib.util.spec_from_file_location("air_bias", FOLDER / "air_bias.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def written():
    """Return the cells of each table row, by the fitted model."""
    bias = script()
    text = (FOLDER / "air.md").read_text().partition(bias.BEGIN)[2].partition(bias.END)[0]
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines() if line]
    return {cells[1]: cells for cells in rows[2:]}


def test_the_page_has_a_row_for_every_fit_and_the_biases_that_they_show():
    bias, rows = script(), written()
    assert list(rows) == list(bias.ROWS)
    truth = bias.TRUTH["air.drag_coefficient"]
    for name, cells in rows.items():
        value, error = float(cells[2]), float(cells[3])
        stated = float(cells[4].removesuffix("%"))
        assert stated == pytest.approx(100 * (value / truth - 1), abs=0.1)
        # Only a model with all effects finds the true value.
        assert (abs(value - truth) < 3 * error) == name.startswith(("generating model",)) or (
            "without the wind" in name
        )


@pytest.mark.long
def test_the_table_comes_out_of_its_script():
    bias, rows = script(), written()
    runs = {"calm": bias.CALM}
    for name in "generating model", "the paper's model: eq. (1), 0.047 kg per link":
        line = bias.line(name, bias.fitted(name, runs))
        found = [cell.strip() for cell in line.split("|")[1:-1]]
        for index in 2, 3, 5, 6, 8:
            assert float(found[index]) == pytest.approx(float(rows[name][index]), rel=0.02), name
