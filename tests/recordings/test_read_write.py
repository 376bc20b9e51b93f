"""Files: written files are read back, and typical files of users can be read."""

import hashlib
import math

import numpy as np
import polars as pl
import pytest

from giajax.recordings import Definition, Run, read_run, write_run
from giajax.runtime.text import InputError

pytestmark = pytest.mark.quick

BASE = "time_s,joint01_command_deg,link06_z_m\n0,0,0.1\n0.1,30,\n0.2,30,-0.3\n"


def csv(tmp_path, text, name="run.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def random_values(seed, rows=200):
    """Every kind of arm channel, over many orders of magnitude, with gaps in measured ones."""
    rng = np.random.default_rng(seed)
    names = ["joint02_command", "joint01_command", "link12_z", "link02_x", "tip_y",
             "joint01_angle", "joint03_rate", "wind_z"]  # fmt: skip
    values = {n: rng.normal(size=rows) * 10.0 ** rng.integers(-12, 6, size=rows) for n in names}
    for name in ["link12_z", "link02_x", "tip_y", "joint01_angle", "joint03_rate"]:
        values[name][rng.random(rows) < 0.3] = np.nan
    return np.cumsum(rng.uniform(1e-3, 1.0, size=rows)), values


def test_a_file_is_read_in_si_units(tmp_path):
    path = csv(tmp_path, BASE)
    run = read_run(path)
    assert (run.name, run.model, run.path) == ("run", "arm", path)
    assert run.sha256 == hashlib.sha256(BASE.encode()).hexdigest()
    np.testing.assert_array_equal(run.times, [0.0, 0.1, 0.2])
    np.testing.assert_allclose(run.values["joint01_command"], np.array([0, 1, 1]) * math.pi / 6)
    np.testing.assert_array_equal(run.values["link06_z"], [0.1, np.nan, -0.3])
    assert run.channels["joint01_command"].unit == "deg"
    assert run.definition.contents() == {}


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("units", [{}, {"length": "mm", "angle": "rad", "tip_y": "cm"}])
def test_what_is_written_is_read_back(tmp_path, seed, units):
    times, values = random_values(seed)
    definition = Definition.parse({"origin": "a test", "noise": {"position_m": 0.1}})
    path = write_run(tmp_path / "a.csv", times, values, units=units, definition=definition)
    run = read_run(path)
    np.testing.assert_allclose(run.times, times, rtol=1e-11)
    assert set(run.values) == set(values)
    for name, array in values.items():
        np.testing.assert_allclose(run.values[name], array, rtol=1e-8)
    assert run.noise("tip_y") == 0.1
    assert (run.definition.model, run.definition.origin) == ("arm", "a test")
    assert run.definition.sha256 == run.sha256
    # Writing the run that was read gives the same bytes, so nothing is lost.
    again = write_run(tmp_path / "b.csv", run.times, run.values, units=units)
    assert again.read_bytes() == path.read_bytes()


def test_the_bytes_of_a_written_file(tmp_path):
    values = {
        "tip_x": [19.8, 19.8],
        "link12_z": [0.0, np.nan],
        "link02_z": [1 / 3, -0.0],
        "link02_x": [-1e-12, 123456.789123],
        "wind_x": [0.2, 0.2],
        "joint02_command": [0.0, -math.pi],
        "joint01_command": [-0.0, math.pi / 6],
        "joint01_rate": [0.0, math.pi],
    }
    path = write_run(tmp_path / "run.csv", [0.0, 0.1], values)
    assert path.read_bytes() == (
        b"time_s,joint01_command_deg,joint02_command_deg,joint01_rate_deg_per_s,"
        b"link02_x_m,link02_z_m,link12_z_m,tip_x_m,wind_x_m_per_s\n"
        b"0,0,0,0,-1e-12,0.333333333,0,19.8,0.2\n"
        b"0.1,30,-180,180,123456.789,0,,19.8,0.2\n"
    )
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run.csv"]


def test_nothing_is_written_over_without_force(tmp_path):
    values = {"joint01_command": [0.0, 1.0]}
    path = write_run(tmp_path / "run.csv", [0.0, 1.0], values, definition={})
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    assert set(before) == {"run.csv", "run.toml"}
    with pytest.raises(InputError, match=r"run\.csv exists"):
        write_run(path, [0.0, 2.0], values, definition={})
    path.unlink()
    with pytest.raises(InputError, match=r"run\.toml exists"):
        write_run(path, [0.0, 2.0], values, definition={})
    assert not path.exists()
    # The sidecar of another run would contradict the new run.
    with pytest.raises(InputError, match=r"run\.toml would become the sidecar"):
        write_run(path, [0.0, 2.0], values, force=True)
    write_run(path, [0.0, 2.0], values, definition={}, force=True)
    assert read_run(path).times[1] == 2.0


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("run.txt", {"joint01_command": [0, 1]}, r"must end in \.csv"),
        ("no/run.csv", {"joint01_command": [0, 1]}, "does not exist: create it"),
        ("run.csv", {"joint01_command": [0, 1, 2]}, "different numbers of samples"),
        ("run.csv", {"joint1_command": [0, 1]}, "did you mean 'joint01_command'"),
        ("run.csv", {"joint01_command_deg": [0, 1]}, "rename it to 'joint01_command'"),
    ],
)
def test_what_cannot_be_written(tmp_path, name, values, message):
    with pytest.raises(InputError, match=message):
        write_run(tmp_path / name, [0.0, 1.0], values)
    assert list(tmp_path.iterdir()) == []


def test_a_write_that_fails_leaves_nothing_behind(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.replace", fail)
    with pytest.raises(InputError, match="No space left on device"):
        write_run(tmp_path / "run.csv", [0, 1], {"tip_x": [0, 1]}, definition={})
    assert list(tmp_path.iterdir()) == []


def test_a_unit_of_another_quantity_is_refused(tmp_path):
    with pytest.raises(InputError, match="m, cm or mm"):
        write_run(tmp_path / "run.csv", [0, 1], {"tip_x": [0, 1]}, units={"tip_x": "deg"})


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbf" + BASE.encode(),
        BASE.replace("\n", "\r\n").encode(),
        BASE.rstrip("\n").encode(),
        (BASE + "\n\n").encode(),
        BASE.replace("0.1,30,\n", "0.1,30,NaN\n").encode(),
        BASE.replace("0.1,30,\n", "0.1,30,nan\n").encode(),
        BASE.replace("0.1,30,\n", "0.1,30, NA\n").encode(),
        BASE.replace(",", " , ").encode(),
        BASE.replace("0.1,30", "+1e-1,3.E1").encode(),
        BASE.replace("0.1,30,\n", '"0.1",30,""\n').encode(),
        BASE.replace("time_s", '"time_s"').encode(),
        BASE.replace("time_s", "time_ms").replace("0.1,3", "100,3").replace("0.2", "200").encode(),
    ],
    ids=["bom", "crlf", "no last newline", "blank last lines", "NaN", "nan", "NA", "spaces",
         "exponents", "quotes", "quoted header", "ms"],
)  # fmt: skip
def test_files_as_programs_write_them(tmp_path, text):
    run = read_run(csv(tmp_path, text))
    np.testing.assert_allclose(run.times, [0.0, 0.1, 0.2], rtol=1e-15)
    np.testing.assert_array_equal(run.values["link06_z"], [0.1, np.nan, -0.3])


def test_parquet_is_read_like_csv(tmp_path):
    frame = pl.DataFrame(
        {
            "time_ms": pl.Series([0, 100, 200], dtype=pl.Int32),
            "joint01_command_deg": [0.0, 30.0, 30.0],
            "link06_z_m": pl.Series([0.1, None, -0.3], dtype=pl.Float64),
        }
    )
    path = tmp_path / "run.parquet"
    frame.write_parquet(path)
    run = read_run(path)
    np.testing.assert_array_equal(run.times, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(run.values["link06_z"], [0.1, np.nan, -0.3])
    frame.with_columns(link06_z_m=pl.Series(["1", "x", ""])).write_parquet(path)
    with pytest.raises(InputError, match="'link06_z_m' has 'x' in row 2"):
        read_run(path)
    frame.with_columns(link06_z_m=pl.Series([True, False, True])).write_parquet(path)
    with pytest.raises(InputError, match="'link06_z_m' is of type Boolean"):
        read_run(path)
    path.write_bytes(b"PAR1 but not really")
    with pytest.raises(InputError, match="not a valid Parquet file"):
        read_run(path)


def test_text_channels(tmp_path):
    path = csv(tmp_path, 'angle_deg,side,force_N\n60,inner,2.97\n-60,"outer",\n')
    run = read_run(path)
    assert (run.model, run.times) == ("joint", None)
    assert list(run.values["side"]) == ["inner", "outer"]
    copy = write_run(tmp_path / "copy.csv", None, run.values)
    assert copy.read_text() == "angle_deg,side,force_N\n60,inner,2.97\n-60,outer,\n"


def test_foreign_names_are_renamed(tmp_path):
    path = csv(tmp_path, BASE.replace("link06_z_m", "Marker 6 [m]").replace("time_s", "t"))
    run = read_run(path, rename={"Marker 6 [m]": "link06_z_cm", "t": "time_s"})
    np.testing.assert_allclose(run.values["link06_z"], [0.001, np.nan, -0.003], rtol=1e-15)
    with pytest.raises(InputError, match="has no column 'T', but has t, joint01_command_deg"):
        read_run(path, rename={"T": "time_s"})
    with pytest.raises(InputError, match=r"'link6_z_m' is not.*did you mean 'link06_z_m'"):
        read_run(path, rename={"Marker 6 [m]": "link6_z_m"})


def test_the_sidecar_is_read_and_the_definition_wins(tmp_path):
    path = csv(tmp_path, BASE)
    (tmp_path / "run.toml").write_text(
        "[arm]\nlinks = 8\nlink_mass_kg = 0.1\n[noise]\nposition_m = 0.02\n[truth]\nx = 1\n"
    )
    run = read_run(path)
    assert (run.definition.arm.links, run.noise("link06_z")) == (8, 0.02)
    definition = Definition.parse(
        {
            "sha256": "0" * 64,  # of another file: a definition is not the sidecar of this file
            "arm": {"link_mass_kg": 0.2},
            "noise": {"link06_z_m": 0.5},
            "fit": {"free": ["a"]},
        }
    )
    run = read_run(path, definition=definition)
    assert (run.definition.arm.links, run.definition.arm.link_mass_kg) == (8, 0.2)
    assert run.noise("link06_z") == 0.5
    assert "fit" not in run.definition.contents()
    with pytest.raises(InputError, match="link 6, but the arm has only 3 links"):
        read_run(path, definition=Definition.parse({"arm": {"links": 3}}))


def test_a_changed_file_contradicts_its_checksum(tmp_path):
    path = write_run(tmp_path / "run.csv", [0, 1], {"joint01_command": [0, 1]}, definition={})
    read_run(path)
    path.write_bytes(path.read_bytes().replace(b"\n1,", b"\n2,"))
    with pytest.raises(InputError, match=r"has the SHA-256 .* but .*run\.toml gives"):
        read_run(path)
    sidecar = tmp_path / "run.toml"
    sidecar.write_text(f'sha256 = "{hashlib.sha256(path.read_bytes()).hexdigest().upper()}"')
    read_run(path)


def test_a_run_from_arrays_survives_the_file(tmp_path):
    times, values = random_values(7)
    run = Run.from_arrays(times, values, noise={"position": 0.01, "joint01_angle": 0.1})
    path = write_run(tmp_path / "run.csv", run.times, run.values, definition=run.definition)
    back = read_run(path)
    for name in run.values:
        assert back.noise(name) == run.noise(name)
