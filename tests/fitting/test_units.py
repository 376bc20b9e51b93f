"""Hysteresis tables: the units are those of the columns, and the numbers have a handy size."""

from types import SimpleNamespace

import numpy as np
import pytest

from giajax import fit, model_for, read_run
from giajax.cli._fit import Progress
from giajax.fitting import (
    Estimate,
    Iteration,
    column_factors,
    in_column_units,
    units_in_si,
    units_note,
)
from giajax.report import parameter_table, summary


def converted(unit, columns, value=2.0):
    names = {f"{word}_column": column for word, column in columns.items()}
    model = SimpleNamespace(definition=lambda: names)
    one = Estimate(value, 0.1, unit, 0.0, None, True)
    return in_column_units({"weight": one}, model)["weight"]


@pytest.mark.parametrize(
    ("unit", "factor", "shown"),
    [
        ("output/input", 1e3 / 1e-3, "mm/kPa"),
        ("output", 1e3, "mm"),
        ("input", 1e-3, "kPa"),
        ("1/input", 1e3, "1/kPa"),
        ("N/m", 1.0, "N/m"),
        ("", 1.0, ""),
    ],
)
def test_units_are_those_of_the_columns(unit, factor, shown):
    one = converted(unit, {"input": "input_kPa", "output": "output_mm"})
    assert one.unit == shown
    assert one.value == pytest.approx(2.0 * factor)
    assert one.standard_error == pytest.approx(0.1 * factor)
    assert one.lower == 0
    assert one.upper is None


def test_units_that_cancel_are_none():
    one = converted("output/input", {"input": "command_deg", "output": "angle_deg"})
    assert (one.value, one.unit) == (pytest.approx(2.0), "")
    # A column without a unit gives a slope with the unit of the other column.
    one = converted("output/input", {"input": "input", "output": "output_mm"})
    assert (one.value, one.unit) == (pytest.approx(2e3), "mm")
    one = converted("input", {"input": "input_deg_per_s"}, [1.0, 2.0])
    assert one.value == pytest.approx(np.rad2deg([1.0, 2.0]).tolist())


def test_units_of_a_fraction_are_told_apart():
    columns = {"input": "input_deg_per_s", "output": "output_N_m"}
    assert converted("output/input", columns).unit == "(N m)/(deg/s)"
    assert converted("input", columns).unit == "deg/s"


def test_progress_is_in_the_units_of_the_table(capsys, tmp_path):
    """Nuisance parameters have no column."""
    path = tmp_path / "loop.csv"
    path.write_text("input_kPa,output_mm\n0,0\n9,9\n0,1\n9,9\n")
    (tmp_path / "loop.toml").write_text('model = "hysteresis"\n[hysteresis]\nthresholds = 1\n')
    model = model_for([read_run(path)])
    values = {"offset": 0.0005, "thresholds[0]": 2000.0, "idle": 1.0}
    progress = Progress(SimpleNamespace(model=model, nuisances=("idle",)))
    progress(Iteration(0, 1.0, 0.0, True, values))
    last = capsys.readouterr().err.splitlines()[-1]
    assert last.split() == ["0", "1", "0.5", "2"]


def test_what_is_not_known_stays():
    one = converted("output/input", {"input": "input_kPa"})
    assert (one.value, one.unit) == (2.0, "output/input")
    assert units_note({"weight": one}, SimpleNamespace(definition=dict)) == ""


def test_a_loop_is_described_in_its_own_units(tmp_path):
    up = np.concatenate([np.arange(21), np.arange(20, -21, -1), np.arange(-20, 21)]) * 10.0
    lag = np.concatenate([[0.0], np.sign(np.diff(up))])
    rows = [f"{u},{0.003 * u - 0.1 * s:.6f}" for u, s in zip(up, lag, strict=True)]
    path = tmp_path / "loop.csv"
    path.write_text("\n".join(["input_kPa,output_mm", *rows]) + "\n")
    (tmp_path / "loop.toml").write_text('model = "hysteresis"\n[hysteresis]\nthresholds = 1\n')
    run = read_run(path)
    result = fit(model_for([run]), run, check=False)
    row = next(line for line in parameter_table(result).splitlines() if line.startswith("elastic"))
    slope, unit = float(row.split()[1]), row.split()[3]
    assert unit == "mm/kPa"
    # In result.json, the value is in SI units, m/Pa.
    assert slope == pytest.approx(1e6 * result.parameters["elastic"].value, rel=1e-3)
    assert "units               those of input_kPa and output_mm" in summary(result)
    assert "output/input" not in parameter_table(result)
    assert column_factors(result.model)["elastic"] == pytest.approx(1e6)
    assert units_in_si(result.model)["elastic"] == "m/Pa"
