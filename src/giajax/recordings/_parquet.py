"""Read a Parquet file as a header and columns, after a check of its size in memory.

The format of files and metadata: https://github.com/apache/parquet-format. The metadata are encoded
in Thrift's compact protocol. Sizes in a footer can be false. A reader allocates memory according to
the sizes in the page headers, so these are checked.
"""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import polars as pl

from ..runtime.limits import CELL_BYTES, DEPTH, PARQUET_BYTES, PARQUET_FOOTER_BYTES
from ..runtime.text import InputError

# Limits on the number of pages, the size of a page header, and the size of all page headers. Files
# within the other limits stay far below them.
_PAGES, _PAGE_HEAD, _PAGE_HEADS = 100_000, 1 << 16, 1 << 22

# Field numbers in a page header (data, dictionary, or data of version 2) and of its encoding. An
# encoding of strings by the prefix shared with the previous string is refused, because a page of a
# few bytes can then expand to any size.
_KINDS, _PREFIXED = {5: 2, 7: 2, 8: 4}, 7

# Bytes of a cell in memory: of a number, and of the overhead of a Python string.
_NUMBER_BYTES, _TEXT_BYTES = 8, 64


def split_parquet(data: bytes, path: Path) -> tuple[list[str], list[pl.Series], int]:
    """Return header, columns, and the number of the first sample.

    Raises:
        InputError: the data are not a Parquet file of numbers and strings within the limits.
    """
    footer = int.from_bytes(data[-8:-4], "little")
    if data[-4:] == b"PAR1" and PARQUET_FOOTER_BYTES < footer < len(data):
        raise InputError(
            f"{path} has {footer:,} bytes of metadata, but may have at most "
            f"{PARQUET_FOOTER_BYTES:,}: export it with fewer columns or row groups"
        )
    try:
        rows, unpacked = _rows(data)
        # Check the size before decompression, so that the file cannot fill the memory.
        _check_parquet(pl.read_parquet_schema(io.BytesIO(data)), rows, unpacked, path)
        frame = pl.read_parquet(io.BytesIO(data))
    except InputError:
        raise
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException, OSError, ValueError):
        raise InputError(f"{path} is not a valid Parquet file: export it again") from None
    for series in frame:
        if series.dtype in (pl.String, pl.Categorical):
            # A categorical column stores each string once, but is later converted to strings.
            texts = series.str if series.dtype == pl.String else series.cat
            longest = cast("int | None", texts.len_bytes().max()) or 0
            if longest <= CELL_BYTES and len(series) * (_TEXT_BYTES + longest) > PARQUET_BYTES:
                raise InputError(
                    f"{path}: the strings of column {series.name!r} may occupy at most "
                    f"{PARQUET_BYTES:,} bytes: shorten them"
                )
            if longest > CELL_BYTES:
                raise InputError(
                    f"{path}: a cell of column {series.name!r} has {longest:,} bytes, but may "
                    f"have at most {CELL_BYTES:,}: shorten it"
                )
    return frame.columns, frame.get_columns(), 1


def _check_parquet(schema: Mapping[str, pl.DataType], rows: int, unpacked: int, path: Path) -> None:
    for name, dtype in schema.items():
        if not (dtype.is_numeric() or dtype in (pl.String, pl.Null, pl.Categorical)):
            raise InputError(
                f"{path}: column {name!r} is of type {dtype}, but must hold numbers: convert it"
            )
    row = sum(_NUMBER_BYTES if dtype.is_numeric() else _TEXT_BYTES for dtype in schema.values())
    size = max(rows * row, unpacked)
    if size > PARQUET_BYTES:
        raise InputError(
            f"{path} has {size:,} bytes after decompression, but may have at most "
            f"{PARQUET_BYTES:,}: shorten it"
        )


def _rows(data: bytes) -> tuple[int, int]:
    """Return the number of rows of a Parquet file and the size of its decompressed pages.

    Raises:
        ValueError: the data are not a valid Parquet file.
    """
    length = int.from_bytes(data[-8:-4], "little")
    if data[-4:] != b"PAR1" or data[:4] != b"PAR1" or not 0 < length <= len(data) - 12:
        raise ValueError("no footer")
    try:
        footer, _ = _table(data[-8 - length : -8], 0, DEPTH)
        # A reader allocates memory for the largest of these counts, and treats a negative number
        # as a huge one. Polars reads nested groups by recursion, so deep nesting would crash it.
        open_groups: list[int] = []
        for element in footer[2]:
            open_groups.append(element.get(5) or 0)
            while open_groups and open_groups[-1] == 0:
                open_groups.pop()
                if open_groups:
                    open_groups[-1] -= 1
            if len(open_groups) > DEPTH:
                raise ValueError("column groups that are nested too deeply")
        counts, sizes = [footer[3], sum(group[3] for group in footer[4])], [0]
        heads = 0
        for group in footer[4]:
            counts.append(group[3])
            for column in group[1]:
                about = column[3]
                counts.append(about[5])
                at = about[9] if about.get(11) is None else about[11]
                end = at + about[7]
                if at < 4:
                    raise ValueError("pages that start before the beginning of the file")
                while at < end:
                    page, head = _table(data[at : at + _PAGE_HEAD], 0, DEPTH)
                    for kind, encoding in _KINDS.items():
                        if kind in page:
                            counts.append(page[kind][1])
                            if page[kind][encoding] == _PREFIXED:
                                raise ValueError(
                                    "strings encoded as repetitions of the strings before them"
                                )
                    sizes.append(page[2])
                    at += head + page[3]
                    heads += head
                    if page[3] < 0 or len(sizes) > _PAGES or heads > _PAGE_HEADS:
                        raise ValueError("no pages")
                if at != end:
                    raise ValueError("pages beyond their end")
        if min(*counts, *sizes) < 0:
            raise ValueError("a negative size")
        return max(counts), sum(sizes)
    except (LookupError, TypeError, AttributeError) as error:
        raise ValueError(str(error)) from None


def _number(data: bytes, at: int) -> tuple[int, int]:
    """Decode a number stored as seven bits per byte; return it and the position after it."""
    found = 0
    for shift in range(0, 70, 7):
        byte = data[at]
        at += 1
        found |= (byte & 127) << shift
        if byte < 128:
            return found, at
    raise ValueError("an unterminated number")


def _signed(data: bytes, at: int) -> tuple[int, int]:
    found, at = _number(data, at)
    return (found >> 1) ^ -(found & 1), at


def _value(data: bytes, at: int, kind: int, depth: int) -> tuple[Any, int]:
    """Decode a value and return it with the position after it; strings and floats become None."""
    if at >= len(data) or depth < 0:
        raise ValueError("a value beyond the end of the metadata, or nested too deeply")
    if kind == 3:
        return data[at], at + 1
    if kind in (4, 5, 6):
        return _signed(data, at)
    if kind == 7:
        return None, at + 8
    if kind == 8:
        length, at = _number(data, at)
        return None, at + length
    if kind in (9, 10):
        count, of = data[at] >> 4, data[at] & 15
        at += 1
        if count == 15:
            count, at = _number(data, at)
        found = []
        for _ in range(count):
            each, at = (data[at], at + 1) if of in (1, 2) else _value(data, at, of, depth - 1)
            found.append(each)
        return found, at
    if kind == 12:
        return _table(data, at, depth - 1)
    raise ValueError(f"a value of the unknown type {kind}")


def _table(data: bytes, at: int, depth: int) -> tuple[dict[int, Any], int]:
    """Return values by field number, and the position after them."""
    found: dict[int, Any] = {}
    field = 0
    while (head := data[at]) != 0:
        at += 1
        field, at = (field + (head >> 4), at) if head >> 4 else _signed(data, at)
        kind = head & 15
        found[field], at = (None, at) if kind in (1, 2) else _value(data, at, kind, depth)
    return found, at + 1
