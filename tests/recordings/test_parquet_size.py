"""Parquet files that would fill the memory are refused by their metadata, before decoding."""

import numpy as np
import polars as pl
import pytest

from giajax import InputError
from giajax.recordings import read_numbers

pytestmark = pytest.mark.quick

MANY = 17_000_000
SOME = 4_300_000


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (
            {"time_s": np.zeros(MANY, np.int8), "link06_z_m": np.zeros(MANY, np.int8)},
            "has 272,000,000 bytes after decompression, but may have at most 268,435,456: shorten",
        ),
        (
            {"time_s": np.zeros(SOME, np.int8), "side": pl.repeat("a", SOME, eager=True)},
            "has 309,600,000 bytes after decompression",
        ),
        (
            {"side": [f"{number}{'a' * 1_000_000}" for number in range(270)]},
            r"has 270,\d{3},\d{3} bytes after decompression",
        ),
        ({"link06_z_m": [[1.0] * 100] * 10}, r"is of type List\(Float64\), but must hold numbers"),
        ({"link06_z_m": [{"a": 1.0}] * 10}, "is of type Struct"),
    ],
    ids=["numbers", "texts", "long texts", "lists", "tables"],
)
def test_what_fills_the_memory_is_not_unpacked(tmp_path, monkeypatch, columns, said):
    path = tmp_path / "run.parquet"
    pl.DataFrame(columns).write_parquet(path, statistics=False)
    assert path.stat().st_size < 1 << 20
    monkeypatch.setattr(pl, "read_parquet", lambda _: pytest.fail("it was unpacked"))
    with pytest.raises(InputError, match=said):
        read_numbers(path)


@pytest.mark.parametrize("dtype", [pl.String, pl.Categorical])
def test_one_long_text_in_every_row_is_refused(tmp_path, dtype):
    """The file contains the text once."""
    path = tmp_path / "run.parquet"
    pl.DataFrame({"side": ["1" * 1_000_000] * 1000}, {"side": dtype}).write_parquet(path)
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputError, match="has 1,000,000 bytes, but may have at most 1,000"):
        read_numbers(path)


@pytest.mark.parametrize("compression", ["uncompressed", "snappy", "zstd", "gzip", "lz4"])
def test_what_is_within_the_limits_is_read(tmp_path, compression):
    path = tmp_path / "run.parquet"
    numbers = np.linspace(0.0, 1.0, 100_000)
    frame = pl.DataFrame({"a": numbers, "b": np.round(numbers, 1), "c": [None] * len(numbers)})
    frame.write_parquet(path, compression=compression, row_group_size=30_000)
    found = read_numbers(path)
    assert np.array_equal(found["a"], numbers)
    assert np.array_equal(found["b"], np.round(numbers, 1))
    assert np.isnan(found["c"]).all()


def test_a_footer_of_lists_within_lists_is_refused(tmp_path):
    path = tmp_path / "run.parquet"
    for footer in (b"\x19" * 100_000, b"\x19\xf7" + b"\xff" * 8 + b"\x01", b"\x1c" * 100_000):
        path.write_bytes(b"PAR1" + footer + len(footer).to_bytes(4, "little") + b"PAR1")
        with pytest.raises(InputError, match="is not a valid Parquet file"):
            read_numbers(path)
    path.write_bytes(bytes(5_000_000) + (4_900_000).to_bytes(4, "little") + b"PAR1")
    with pytest.raises(InputError, match="4,900,000 bytes of metadata, but may have at most 4,194"):
        read_numbers(path)


def test_a_page_with_a_negative_number_of_values_is_refused(tmp_path):
    """The reader would try to allocate 2e18 bytes, which ends the process."""
    path = tmp_path / "run.parquet"
    pl.DataFrame({"a": np.arange(50.0)}).write_parquet(path, statistics=False)
    data = path.read_bytes()
    # The fifth field is a struct; its first field is 50, then replaced by -50, in zigzag encoding.
    assert data.count(b"\x2c\x15\x64\x15") == 1
    path.write_bytes(data.replace(b"\x2c\x15\x64\x15", b"\x2c\x15\x63\x15"))
    with pytest.raises(InputError, match="is not a valid Parquet file"):
        read_numbers(path)


def number(value):
    """Encode an integer in zigzag form."""
    return whole((value << 1) ^ (value >> 63))


def whole(value):
    """Encode an integer with seven bits per byte."""
    found = b""
    while value > 127:
        found, value = found + bytes([value & 127 | 128]), value >> 7
    return found + bytes([value])


def thrift(table):
    """Encode numbers, texts, structs and lists in Thrift's compact protocol."""
    found = b""
    for field, value in table.items():
        kind, data = item(value)
        # The long form of a field header: the type, then the number.
        found += bytes([kind]) + number(field) + data
    return found + b"\0"


def item(value):
    if isinstance(value, dict):
        return 12, thrift(value)
    if isinstance(value, bytes):
        assert len(value) < 64
        return 8, bytes([len(value)]) + value
    if isinstance(value, list):
        parts = [item(part) for part in value]
        head = bytes([0xF0 | parts[0][0]]) + whole(len(parts))
        return 9, head + b"".join(data for _, data in parts)
    return 6, number(value)


def parquet(pages, column=None, schema=None):
    """Return a file with one text column and these pages."""
    about = {1: 6, 2: [0], 3: [b"a"], 4: 0, 5: 10, 6: len(pages), 7: len(pages), 9: 4}
    about |= {} if column is None else column
    footer = thrift(
        {
            1: 1,
            2: schema or [{4: b"root", 5: 1}, {1: 6, 3: 0, 4: b"a"}],
            3: 10,
            4: [{1: [{2: 4, 3: about}], 2: len(pages), 3: 10}],
        }
    )
    return b"PAR1" + pages + footer + len(footer).to_bytes(4, "little") + b"PAR1"


def page(encoding=0, size=0, extra=0):
    """Return a page header, which describes the content, and the content."""
    head = {1: 0, 2: size, 3: size, 5: {1: 10, 2: encoding, 3: 3, 4: 3}}
    if extra:
        head[99] = [0] * extra
    return thrift(head) + bytes(size)


@pytest.mark.parametrize(
    "data",
    [
        parquet(page(encoding=7)),
        parquet(page(), column={11: 0}),
        parquet(page(), column={9: 0}),
        parquet(page(size=100), column={7: len(page(size=100)) - 1}),
        parquet(page(extra=60_000) * 75),
        parquet(page(), schema=[{4: b"g", 5: 1}] * 1000 + [{1: 6, 3: 0, 4: b"a"}]),
    ],
    ids=["texts by prefix", "offset 0", "first offset 0", "beyond the end", "heads", "groups"],
)
def test_what_misleads_its_reader_is_refused_before(tmp_path, monkeypatch, data):
    """A page of any size, a page that is not where it is read, or endless groups."""
    path = tmp_path / "run.parquet"
    path.write_bytes(data)
    monkeypatch.setattr(pl, "read_parquet_schema", lambda _: pytest.fail("it was unpacked"))
    with pytest.raises(InputError, match="is not a valid Parquet file"):
        read_numbers(path)


def test_a_file_that_is_made_so_and_misleads_nobody_goes_to_the_reader(tmp_path, monkeypatch):
    """This shows that the files of the previous test are refused only for their defects."""
    path = tmp_path / "run.parquet"
    path.write_bytes(parquet(page(size=10)))
    monkeypatch.setattr(pl, "read_parquet_schema", lambda _: {})
    monkeypatch.setattr(pl, "read_parquet", lambda _: pl.DataFrame({"b": [1.0]}))
    assert list(read_numbers(path)) == ["b"]


def test_categories_count_as_the_texts_that_they_become(tmp_path):
    path = tmp_path / "run.parquet"
    rows = 300_000
    frame = pl.DataFrame({"side": pl.repeat("1" * 900, rows, eager=True)}, {"side": pl.Categorical})
    frame.write_parquet(path)
    assert path.stat().st_size < 1 << 20
    with pytest.raises(
        InputError,
        match=r"the strings of column 'side' may occupy at most "
        r"268,435,456 bytes",
    ):
        read_numbers(path)
