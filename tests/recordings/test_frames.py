"""Runs from tables in memory, and back to tables."""

import numpy as np
import polars as pl
import pytest

from giajax import InputError
from giajax.recordings import Run, read_run, write_run

pytestmark = pytest.mark.quick

TIMES = np.array([0.0, 0.5, 1.0, 1.5])
COLUMNS = {
    "time_s": TIMES,
    "joint01_command_deg": np.array([0.0, 5.0, 10.0, 10.0]),
    "tip_z_mm": np.array([0.0, 40.0, np.nan, 90.0]),
}


def check(run):
    np.testing.assert_array_equal(run.times, TIMES)
    np.testing.assert_allclose(run.values["joint01_command"], np.deg2rad([0, 5, 10, 10]))
    np.testing.assert_allclose(run.values["tip_z"], [0.0, 0.04, np.nan, 0.09])
    assert run.channels["tip_z"].unit == "mm"
    assert run.noise("tip_z") == 0.005


def pandas_frame():
    pandas = pytest.importorskip("pandas")
    return pandas.DataFrame(COLUMNS)


def pandas_index():
    return pandas_frame().set_index("time_s")


def stamped():
    pandas = pytest.importorskip("pandas")
    stamps = pandas.Timestamp("2026-11-25 20:15") + pandas.to_timedelta(TIMES, unit="s")
    return pandas_frame().drop(columns="time_s").set_index(stamps.rename("time"))


def zoned():
    frame = stamped()
    return frame.set_index(frame.index.tz_localize("Europe/Berlin").rename(None))


def numbered():
    """An index that is not a column."""
    return pandas_frame().rename_axis("sample")


def dataset():
    xarray = pytest.importorskip("xarray")
    data = {
        "joint01_command_deg": ("time", COLUMNS["joint01_command_deg"]),
        "tip_z": ("time", COLUMNS["tip_z_mm"], {"units": "mm"}),
    }
    coordinates = {"time": ("time", TIMES, {"units": "s"}), "experiment": 7}
    return xarray.Dataset(data, coordinates)


FRAMES = [
    lambda: COLUMNS,
    lambda: pl.DataFrame(COLUMNS),
    pandas_frame,
    pandas_index,
    stamped,
    zoned,
    numbered,
    dataset,
]


@pytest.mark.parametrize("make", FRAMES)
def test_every_table_is_the_same_run(make):
    check(Run.from_frame(make(), noise={"position": 0.005}))


def test_units_may_stand_beside_names():
    columns = {"time": TIMES, "joint01_command_deg": [0, 5, 10, 10], "tip_z": [0, 40, None, 90]}
    units = {"time": "s", "tip_z": "mm"}
    check(Run.from_frame(columns, units=units, noise={"position": 0.005}))


def test_a_duration_keeps_its_beginning():
    spans = (TIMES * 1000 + 5000).astype("timedelta64[ms]")
    run = Run.from_frame({**COLUMNS, "time_s": spans})
    np.testing.assert_allclose(run.times, TIMES + 5)
    with pytest.raises(InputError, match="units contains 'time'"):
        Run.from_frame({"time": spans, "tip_z_m": TIMES}, units={"time": "ms"})


def test_a_column_of_times_goes_before_an_index():
    pandas = pytest.importorskip("pandas")
    index = pandas.date_range("2026-11-25", periods=4, freq="min")
    check(Run.from_frame(pandas_frame().set_index(index), noise={"position": 0.005}))


def test_a_column_that_is_there_twice_is_refused():
    frame = pandas_frame()
    frame.columns = ["time_s", "tip_z_mm", "tip_z_mm"]
    with pytest.raises(InputError, match="must have one dimension"):
        Run.from_frame(frame)


def test_a_frame_of_a_run_is_its_file(tmp_path):
    run = Run.from_frame(COLUMNS)
    frame = run.to_frame()
    assert frame.columns == list(COLUMNS)
    for name, column in COLUMNS.items():
        np.testing.assert_allclose(frame[name].to_numpy(), column, rtol=1e-15)
    path = write_run(tmp_path / "run.csv", run.times, run.values, units={"tip_z": "mm"})
    read = read_run(path).to_frame()
    assert read.columns == frame.columns
    for name in COLUMNS:
        np.testing.assert_allclose(read[name].to_numpy(), frame[name].to_numpy(), rtol=1e-9)
    again = Run.from_frame(frame)
    np.testing.assert_array_equal(again.values["tip_z"], run.values["tip_z"])


@pytest.mark.parametrize(
    ("frame", "units", "error"),
    [
        (3.0, None, "cannot be made from an object of type float"),
        (COLUMNS, {"tip_y": "m"}, "units contains 'tip_y', which is not a column"),
        (COLUMNS | {"tip_z_m": TIMES}, None, "both give tip_z"),
        (COLUMNS | {"tip_y": TIMES}, None, "tip_y"),
        (COLUMNS | {"tip_y": TIMES}, {"tip_y": "deg"}, "must be in"),
        (COLUMNS | {"tip_y_m": ["a"] * 4}, None, "tip_y_m must be numbers"),
        (COLUMNS | {"tip_y_m": TIMES[:2]}, None, "tip_y"),
    ],
)
def test_what_is_no_run_is_refused(frame, units, error):
    with pytest.raises(InputError, match=error):
        Run.from_frame(frame, units=units)
