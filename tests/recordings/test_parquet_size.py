"""Parquet that would fill the memory: refused by its metadata, before it is unpacked."""

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
            "has 272,000,000 bytes when it is unpacked, but may have 268,435,456 at most: shorten",
        ),
        (
            {"time_s": np.zeros(SOME, np.int8), "side": pl.repeat("a", SOME, eager=True)},
            "has 309,600,000 bytes when it is unpacked",
        ),
        (
            {"side": [f"{number}{'a' * 1_000_000}" for number in range(270)]},
            r"has 270,\d{3},\d{3} bytes when it is unpacked",
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
    """In the file it stands once."""
    path = tmp_path / "run.parquet"
    pl.DataFrame({"side": ["1" * 1_000_000] * 1000}, {"side": dtype}).write_parquet(path)
    assert path.stat().st_size < 1 << 20
    with pytest.raises(InputError, match="has 1,000,000 bytes, but may have 1,000 at most"):
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
        with pytest.raises(InputError, match="is not a Parquet file"):
            read_numbers(path)
    path.write_bytes(bytes(5_000_000) + (4_900_000).to_bytes(4, "little") + b"PAR1")
    with pytest.raises(InputError, match="has 4,900,000 bytes of metadata, but may have 4,194,304"):
        read_numbers(path)


def test_a_page_with_a_negative_number_of_values_is_refused(tmp_path):
    """What reads it would end the process: it asks for 2e18 bytes."""
    path = tmp_path / "run.parquet"
    pl.DataFrame({"a": np.arange(50.0)}).write_parquet(path, statistics=False)
    data = path.read_bytes()
    # Fifth field, a table, whose first field is the number 50, and then -50, in zigzag.
    assert data.count(b"\x2c\x15\x64\x15") == 1
    path.write_bytes(data.replace(b"\x2c\x15\x64\x15", b"\x2c\x15\x63\x15"))
    with pytest.raises(InputError, match="is not a Parquet file"):
        read_numbers(path)
