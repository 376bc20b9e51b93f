"""Damaged and hostile files are read correctly or refused in one sentence, within seconds.

An independent reader, which uses only the standard library, gives the content of CSV files.
"""

import copy
import csv
import datetime
import io
import json
import math
import tomllib
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from giajax.recordings import Definition, describe, read_run, read_table
from giajax.runtime.files import parse_json
from giajax.runtime.text import InputError

ROOT = Path(__file__).resolve().parents[1]

# The cases are the same in every session. A case that takes 5 s hangs; most take milliseconds.
usual = settings(
    max_examples=200,
    deadline=datetime.timedelta(seconds=5),
    derandomize=True,
    database=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)

# Written by hand, independently of the table under test.
UNITS = {
    "time_ms": 1e-3,
    "joint01_command_deg": math.pi / 180,
    "joint02_angle_rad": 1.0,
    "link06_z_m": 1.0,
    "link06_x_mm": 1e-3,
    "tip_x_cm": 1e-2,
    "input": 1.0,
    "pressure_bar": 1e5,
}


def words(text):
    return text.split(" ")


def latin(text):
    return text.encode("latin-1")


NASTY = [
    *words("1_0 \u0661\u0662 \xb2 \u0663.\u0665 \u221e \u0131nf \uff11 \xe9 \ufb01 \u2028 \ufeff"),
    *words('\ufeff1 1\xa0 \x0b \x1c \x85 "1" "1"2 1"2" "1""2" "1,5" "" " "2 "1 1,5 1;5 \' \'1 @'),
    *words("inf -inf +inf Infinity nan NaN -nan NA na N/A null None True #1 # \\ \\n =1+1"),
    *words("1e400 -1e400 1e-400 4.9e-324 1.7976931348623157e308 1.7976931348623159e308 1e0005"),
    *words("0x10 0b1 0o7 1L 1j 1f 1d5 1% (1) --1 +-1 - +1 . .5 5. e 1e 1e+ 1e+5 1E5 1e5e5 1.2.3"),
    *words("-0 -0.0 007 9007199254740993 123456789012345678901234567890"),
    "0.1000000000000000055511151231257827021181583404541",
]
SPACED = ["", " ", "\t", " 1", "1 ", "\t1", "\xa01", "1\u2003", '" 1 "', ' "1"']
numbers = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr), st.integers().map(str)
)
cells = st.integers(0, 9).flatmap(
    lambda die: st.sampled_from(NASTY + SPACED) if die else st.one_of(numbers, st.text(max_size=4))
)
good = st.one_of(st.floats(-1e9, 1e9).map(repr), st.sampled_from(["", "NA", "-.5e-3", " 1"]))
headers = st.lists(st.sampled_from(sorted(UNITS)), min_size=1, max_size=4, unique=True)


@st.composite
def tables(draw, cell=cells, others=(0,) * 12 + (1, -1), fewest=1):
    """The bytes of a CSV file; a row may have `others` more or fewer cells than columns."""
    header = draw(headers.filter(lambda names: len(names) >= fewest))
    end = draw(st.sampled_from(["\n", "\r\n", "\r"]))
    lines = [",".join(header)]
    for _ in range(draw(st.integers(1, 5))):
        width = len(header) + draw(st.sampled_from(others))
        # Most cells are valid, so that a single cell decides about a file.
        kinds = [cell if draw(st.integers(0, 4)) == 0 else good for _ in range(width)]
        lines.append(",".join(map(draw, kinds)))
    text = end.join(lines) + draw(st.sampled_from(["", end, end + end]))
    return draw(st.sampled_from([b"", b"\xef\xbb\xbf"])) + text.encode("utf-8", "surrogatepass")


@st.composite
def damaged(draw, originals, tokens):
    """A file of which some parts are removed, repeated or replaced."""
    data = draw(st.sampled_from(originals))
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(data)))
        length = draw(st.integers(0, 30))
        piece = draw(st.one_of(st.sampled_from(tokens).map(latin), st.binary(max_size=6)))
        repeats = draw(st.sampled_from([1, 1, 1, 2, 50, 3_000]))
        data = data[:start] + piece * repeats + data[start + length :]
    return data


def independently(data):
    """Return columns of a CSV file by name, in SI, or None if it is not a table of numbers."""
    reader = csv.reader(io.StringIO(data.decode("utf-8-sig"), newline=""), strict=True)
    header, *rows = list(reader)
    while rows and rows[-1] == []:
        rows.pop()
    columns = {name: [] for name in header}
    for row in rows:
        row = row or [""]
        assert len(row) == len(header)
        for name, cell in zip(header, row, strict=True):
            columns[name].append(number_of(cell.strip()) * UNITS[name])
    return columns


def number_of(text):
    if text.lower() in ("", "nan", "na"):
        return math.nan
    assert text.isascii()
    assert "_" not in text
    value = float(text)
    assert not math.isnan(value)
    return value


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


def outcome(read, *arguments):
    """Return the result of a function and "", or None and its error message."""
    try:
        return read(*arguments), ""
    except InputError as error:
        said = str(error)
    assert "\n" not in said
    assert 20 < len(said) < 2_500
    return None, said


def same(data, path):
    """Check that a file is refused, or read like the independent reader does."""
    path.write_bytes(data)
    table, said = outcome(read_table, path)
    if table is None:
        assert str(path) in said
        return False
    expected = independently(data)
    columns = {channel.column: name for name, channel in table.channels.items()}
    assert len(columns) + (table.times is not None) == len(expected)
    for name, values in expected.items():
        read = table.times if name == "time_ms" else table.values[columns[name]]
        np.testing.assert_allclose(read, values, rtol=4e-16, atol=0)
    return True


@settings(usual, max_examples=300)
@given(tables())
def test_no_cell_is_read_as_another_number(folder, data):
    same(data, folder / "cells.csv")


# A last row with one empty cell does not count as a row.
@usual
@given(tables(good, others=(0,), fewest=2))
def test_numbers_are_read(folder, data):
    """This shows that the reader in the test above does not refuse everything."""
    assert same(data, folder / "numbers.csv")


RUNS = [
    path.read_bytes()[:3_000].rpartition(b"\n")[0]
    for path in sorted((ROOT / "data" / "synthetic").glob("*.csv"))
]
RUN_TOKENS = words('" , \n \r \0 nan 1e300 - \xff 9 _ e')


@usual
@given(damaged(RUNS, RUN_TOKENS))
def test_a_damaged_run_is_described_or_refused(folder, data):
    path = folder / "run.csv"
    path.write_bytes(data)
    run, said = outcome(read_run, path)
    if run is None:
        assert str(path) in said
    else:
        assert describe(run)["rows"] >= 1


@pytest.fixture(scope="module")
def parquet():
    frame = pl.DataFrame({"time_s": [0.0, 0.1, 0.2], "joint01_command_deg": [0.0, None, 1.0]})
    buffer = io.BytesIO()
    frame.write_parquet(buffer)
    return buffer.getvalue()


@usual
@given(places=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4))
def test_a_damaged_parquet_file_is_read_or_refused(folder, parquet, places):
    path, data = folder / "run.parquet", bytearray(parquet)
    for place, byte in places:
        data[int(place * (len(data) - 1))] = byte
    path.write_bytes(data)
    table, said = outcome(read_table, path)
    assert table is not None or str(path) in said


SIDECARS = [
    path.read_bytes()
    for path in [*sorted((ROOT / "data" / "synthetic").glob("*.toml")), *(ROOT / "fits").iterdir()]
    if path.suffix == ".toml"
]
TOML_TOKENS = [
    *words("[ ] [[ ]] { } = . , # \\ \n 1 -1 9 0x nan inf true _ e \xff \\u0000 links= 1e999"),
    *words('" \' """ \'\'\' {a=1} "a". 1979-05-27 99:99:99 [arm]\n [a.b.c.d]\n'),
]


@usual
@given(damaged(SIDECARS, TOML_TOKENS))
def test_a_damaged_definition_is_loaded_or_refused(folder, data):
    path = folder / "definition.toml"
    path.write_bytes(data)
    definition, said = outcome(Definition.load, path)
    if definition is None:
        assert str(path) in said
        return
    assert Definition.parse(tomllib.loads(definition.to_toml())) == definition


@st.composite
def changed(draw, original, values):
    """Plain data of which one value is removed or replaced."""
    data = copy.deepcopy(original)
    inner = data
    while True:
        keys = sorted(inner) if isinstance(inner, dict) else list(range(len(inner)))
        key = draw(st.sampled_from(keys))
        deeper = isinstance(inner[key], dict | list) and len(inner[key]) > 0
        if not deeper or draw(st.integers(0, 3)) == 0:
            break
        inner = inner[key]
    if draw(st.integers(0, 4)) == 0:
        del inner[key]
    else:
        inner[key] = draw(values)
    return data


plain = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=5),
        st.sampled_from([10**30, -1, 0, 1e300, "q" * 10_000, "links.mass", "a\0b"]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)  # fmt: skip
STATED = {
    "model": "arm", "free_motion": False, "sha256": "0" * 64,
    "arm": {"links": 6, "link_mass_kg": [0.1] * 6, "parameters": {"links.damping": 1.0},
            "point_masses": [{"link": 2, "mass_kg": 0.1, "position_m": 0.5}], "drag": "strip"},
    "sensors": {"camera_origin_m": [0.0, 0.0, 1.0]}, "initial": {"angle_deg": [1.0] * 6},
    "wind": {"velocity_m_per_s": [0.0, 0.0, 0.1]}, "noise": {"position_m": 0.1, "link06_z_m": 1.0},
    "hysteresis": {"operator": "preisach", "rows": 9, "input_range": [-1.0, 1.0]},
    "muscle": {"friction_pressures_kPa": [0.0, 100.0]}, "joint": {"anchor_m": [0.9, 0.2]},
    "fit": {"data": ["a.csv"], "start": {"air.density": 1.0}, "starts": 3},
    "figures": {"air.density": {"value": 1.0, "within": 0.1}}, "truth": {"a": [1, {"b": 2}]},
}  # fmt: skip


@usual
@given(changed(STATED, plain))
def test_a_changed_definition_is_parsed_or_refused(data):
    definition, said = outcome(Definition.parse, data)
    if definition is None:
        assert said.startswith("definition")
        return
    assert Definition.parse(definition.contents()) == definition


def test_the_definition_that_is_changed_is_legal():
    assert Definition.parse(STATED).contents() == STATED


RESULTS = [path.read_bytes() for path in sorted((ROOT / "tests" / "earlier").glob("*/result.json"))]
JSON_TOKENS = words('[ ] { } " : , 1 -1 1e999 9 NaN null \\ {"a":1} {"a":1,"a":2} \xff')


@usual
@given(damaged(RESULTS, JSON_TOKENS))
def test_a_damaged_result_is_parsed_as_json_is_or_refused(data):
    path = Path("result.json")
    try:
        record, _ = outcome(parse_json, data.decode(), path)
    except ValueError:  # invalid JSON is reported by the reader of the file
        return
    assert record is None or record == json.loads(data)
