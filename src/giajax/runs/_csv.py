"""The text of a CSV file as a header and columns of text."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path
from typing import NoReturn

import numpy as np
import polars as pl

from .._errors import InputError
from .._limits import CELL_BYTES, COLUMNS
from ._header import check_header

# Bytes in which the lines above a header are looked for.
_TOP = 1 << 16


def split_csv(data: bytes, path: Path) -> tuple[list[str], list[pl.Series], int]:
    """Header, columns of text (null = empty cell), and the line of the first sample.

    Raises:
        InputError: the data are not CSV in UTF-8 with as many cells in each row as in the first.
    """
    data = data.removeprefix(b"\xef\xbb\xbf")
    try:
        if b"\0" in data:
            raise UnicodeDecodeError("utf-8", data, 0, 1, "NUL")
        data.decode("utf-8")
    except UnicodeDecodeError:
        raise InputError(
            f"{path} is not text: it must be CSV in UTF-8, so export it again"
        ) from None
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    head, _, body = data.rstrip(b"\n").partition(b"\n")
    if head.count(b",") >= COLUMNS:
        raise InputError(
            f"{path} has {head.count(b',') + 1:,} columns, but may have {COLUMNS:,} at most: "
            "remove some"
        )
    _check_lengths(data, path)
    check_header(data[:_TOP].decode("utf-8", errors="ignore"), path)
    try:
        names = next(csv.reader([head.decode("utf-8")], strict=True), [])
    except csv.Error:
        _misquoted(path, 1)
    header = [name.strip() for name in names]
    if not any(header):
        raise InputError(
            f"{path}: the first line must name the columns, but is empty: add a header"
        )
    if len(header) == 1:
        for separator, called in ((";", "semicolons"), ("\t", "tabs")):
            if separator in header[0]:
                raise InputError(
                    f"{path} separates its cells with {called}, but must do so with commas "
                    "(and write numbers with a decimal point): export it again"
                )
    if not body:
        return header, [], 2
    if b'"' in body:
        return header, _quoted(body, header, path), 2
    _check_widths(body, len(header), path)
    # Below a line of its own: Polars drops a byte order mark and empty lines at the top.
    top = b",".join([b"0"] * len(header)) + b"\n"
    frame = pl.read_csv(
        io.BytesIO(top + body), has_header=False, infer_schema=False, quote_char=None, glob=False
    )
    return header, frame[1:].get_columns(), 2


def _check_lengths(data: bytes, path: Path) -> None:
    """Refuse what no name and no number is long enough for."""
    characters = np.frombuffer(data, dtype=np.uint8)
    ends = np.flatnonzero((characters == ord(",")) | (characters == ord("\n")))
    lengths = np.diff(ends, prepend=-1, append=len(data)) - 1
    bad = np.flatnonzero(lengths > CELL_BYTES)
    if bad.size:
        start = 0 if bad[0] == 0 else int(ends[bad[0] - 1]) + 1
        row = data.count(b"\n", 0, start) + 1
        raise InputError(
            f"{path}: a cell in row {row} has "
            f"{int(lengths[bad[0]]):,} characters, but may have {CELL_BYTES:,} at most: correct it"
        )


def _check_widths(body: bytes, width: int, path: Path) -> None:
    # Polars pads short rows in silence, so the commas of each line are counted here.
    characters = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(characters == ord("\n")), len(characters))
    commas = np.flatnonzero(characters == ord(","))
    cells = np.diff(np.searchsorted(commas, ends), prepend=0) + 1
    bad = np.flatnonzero(cells != width)
    if bad.size:
        _ragged(path, int(bad[0]) + 2, int(cells[bad[0]]), width)


def _quoted(body: bytes, header: Sequence[str], path: Path) -> list[pl.Series]:
    # Quotes may hide commas and line ends; such files are small enough for the slow way.
    # Strict: `"1"2` is no way of writing 12.
    reader = csv.reader(io.StringIO(body.decode("utf-8"), newline=""), strict=True)
    rows: list[list[str]] = []
    while True:
        row = len(rows) + 2
        try:
            cells = next(reader, None)
        except csv.Error:
            _misquoted(path, row)
        if cells is None:
            break
        if reader.line_num + 1 != row:
            raise InputError(
                f"{path}: a cell in row {row} has a line break, which no cell may have: remove it"
            )
        if len(cells) != len(header):
            _ragged(path, row, len(cells), len(header))
        rows.append(cells)
    return [pl.Series("", list(column), dtype=pl.String) for column in zip(*rows, strict=True)]


def _misquoted(path: Path, row: int) -> NoReturn:
    raise InputError(
        f"{path}: a cell in row {row} has a quotation mark that begins or ends no cell: "
        "quote whole cells, or none"
    )


def _ragged(path: Path, row: int, cells: int, width: int) -> NoReturn:
    raise InputError(
        f"{path}: row {row} has {cells} cell{'s' * (cells != 1)}, but the header names {width} "
        "columns: give every row one cell for each column, empty where not measured"
    )
