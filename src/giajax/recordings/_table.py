"""Read a data file as columns in SI units; errors name the column and row of a bad cell."""

import csv
import difflib
import hashlib
import io
import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
import numpy.typing as npt
import polars as pl

from ..runtime.files import read_bytes
from ..runtime.limits import CELL_BYTES, COLUMNS, RUN_BYTES
from ..runtime.text import InputError, shown
from ..schema import QUANTITIES
from ._channels import Channel, nearest, parse_column, parse_columns
from ._parquet import split_parquet

_LINES = 30  # number of lines in which a header is sought, below title, date, instrument, units
_NUMERIC = re.compile(r"[+-]?([0-9]|\.[0-9]).*")
_UNITS = frozenset(
    spelling.lower()
    for quantity in QUANTITIES.values()
    for suffix, unit in quantity.suffixes.items()
    for spelling in (suffix, unit, quantity.si_unit, "1", "-", "sec", "degrees", "°")
)


def check_header(text: str, path: Path) -> None:
    """Refuse a CSV file whose column names are not in the first line.

    Raises:
        InputError: comments, units or a title are above the header, or it starts with `#`.
    """
    lines = text.split("\n", _LINES)[:_LINES]
    comments = len([*itertools.takewhile(lambda line: line.lstrip(' "').startswith("#"), lines)])
    if comments:
        below = _cells(lines[comments]) if comments < len(lines) else []
        # numpy writes the column names as the last comment, followed by numbers.
        if below and all(_NUMERIC.fullmatch(cell) or not cell for cell in below):
            above = "" if comments == 1 else " and everything above that line"
            raise InputError(
                f"{path}: line {comments} comes before the numbers and must name the columns, but "
                f"begins with '#': remove the '#'{above}"
            )
        which = "line 1 is a comment" if comments == 1 else f"lines 1 to {comments} are comments"
        raise InputError(
            f"{path}: {which}, but the first line must name the columns: "
            f"remove {'it' if comments == 1 else 'them'}"
        )
    first = _cells(lines[0])
    if not any(first) or _named(first):
        return
    named = next((i for i, line in enumerate(lines[1:], 1) if _named(_cells(line))), None)
    if named is not None:
        above = "the line" if named == 1 else f"the {named} lines"
        raise InputError(
            f"{path}: the column names are at line {named + 1}, but must be at line 1: remove "
            f"{above} above the names"
        )
    if len(first) > 1 and all(cell.strip("[]() ").lower() in _UNITS for cell in first):
        raise InputError(
            f"{path}: the first line holds units, but must name the columns: remove it, and "
            "append the units to the names, such as link06_z_m"
        )


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]), [])]


def _named(cells: Sequence[str]) -> bool:
    """Return whether all cells of a line are names in the column table."""
    try:
        return bool(cells) and all(parse_column(cell) for cell in cells)
    except InputError:
        return False


_TOP = 1 << 16  # number of bytes in which the lines above a header are sought


def csv_lines(data: bytes, path: Path, separator: str = ",", first_row: int = 2) -> bytes:
    """Return the lines of a CSV file with line feeds as ends, without empty lines at the end.

    Raises:
        InputError: the data are not text in UTF-8, or a cell is too long.
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
    _check_lengths(data, path, separator, first_row)
    return data.rstrip(b"\n")


def split_csv(
    data: bytes, path: Path, first_row: int = 2
) -> tuple[list[str], list[pl.Series], int]:
    """Return header, columns of text (null = empty cell), and the line of the first sample.

    Raises:
        InputError: the data are not CSV in UTF-8 with as many cells in each row as in the first.
    """
    data = csv_lines(data, path, first_row=first_row)
    head, _, body = data.partition(b"\n")
    if head.count(b",") >= COLUMNS:
        raise InputError(
            f"{path} has {head.count(b',') + 1:,} columns, but may have at most {COLUMNS:,}: "
            "remove some"
        )
    check_header(data[:_TOP].decode("utf-8", errors="ignore"), path)
    header = [name.strip() for names in csv_rows(head, path, 1) for name in names]
    if not any(header):
        raise InputError(
            f"{path}: the first line must name the columns, but is empty: add a header"
        )
    if len(header) == 1:
        for separator, called in ((";", "semicolons"), ("\t", "tabs")):
            if separator in header[0]:
                raise InputError(
                    f"{path} separates its cells with {called}, but commas must separate the "
                    f"cells (and numbers must have a decimal point): export the file again, or "
                    f"convert it with 'giajax import'"
                )
    if not body:
        return header, [], first_row
    if b'"' in body:
        columns = zip(*csv_rows(body, path, first_row, width=len(header)), strict=True)
        found = [pl.Series("", list(each), dtype=pl.String) for each in columns]
        return header, found, first_row
    _check_widths(body, len(header), path, first_row)
    # Polars drops a byte order mark and empty lines at the top, so a line is put above the data.
    top = b",".join([b"0"] * len(header)) + b"\n"
    return header, _text(top + body)[1:].get_columns(), first_row


def _text(lines: bytes, separator: str = ",") -> pl.DataFrame:
    return pl.read_csv(
        io.BytesIO(lines),
        has_header=False,
        separator=separator,
        quote_char=None,
        infer_schema=False,
        glob=False,
    )


def split_cells(body: bytes, width: int, path: Path, first: int, separator: str = ",") -> pl.Series:
    """Return the cells of all rows as text, one row after another; the first row is line `first`.

    Raises:
        InputError: a row does not have `width` cells, or its quotes are not valid CSV.
    """
    if b'"' in body:
        rows = csv_rows(body, path, first, separator, width)
        return pl.Series("", [cell for row in rows for cell in row], dtype=pl.String)
    _check_widths(body, width, path, first, separator)
    lines = body.replace(separator.encode(), b"\n")
    return _text(b"0\n" + lines + b"\n", separator)[1:].to_series()


def _check_lengths(data: bytes, path: Path, separator: str, first_row: int) -> None:
    """Refuse data with a cell that is too long for any name or number."""
    characters = np.frombuffer(data, dtype=np.uint8)
    ends = np.flatnonzero((characters == ord(separator)) | (characters == ord("\n")))
    lengths = np.diff(ends, prepend=-1, append=len(data)) - 1
    bad = np.flatnonzero(lengths > CELL_BYTES)
    if bad.size:
        start = 0 if bad[0] == 0 else int(ends[bad[0] - 1]) + 1
        above = data.count(b"\n", 0, start)
        row = above - 1 + first_row if above else 1
        raise InputError(
            f"{path}: a cell in row {row} has "
            f"{int(lengths[bad[0]]):,} characters, but may have at most {CELL_BYTES:,}: shorten it"
        )


def _check_widths(body: bytes, width: int, path: Path, first: int, separator: str = ",") -> None:
    # Polars pads short rows without an error, so the separators of each line are counted here.
    characters = np.frombuffer(body, dtype=np.uint8)
    ends = np.append(np.flatnonzero(characters == ord("\n")), len(characters))
    commas = np.flatnonzero(characters == ord(separator))
    cells = np.diff(np.searchsorted(commas, ends), prepend=0) + 1
    bad = np.flatnonzero(cells != width)
    if bad.size:
        ragged(path, int(bad[0]) + first, int(cells[bad[0]]), width)


def csv_rows(
    body: bytes, path: Path, first: int, separator: str = ",", width: int | None = None
) -> list[list[str]]:
    """Return the cells of each line; the first line is line `first`; errors as `split_cells`."""
    # Quoted cells may contain commas and line ends. Such files are small enough for a slow parser.
    # It is strict, because `"1"2` must not be read as 12.
    text = io.StringIO(body.decode("utf-8"), newline="")
    reader = csv.reader(text, delimiter=separator, strict=True)
    rows: list[list[str]] = []
    while True:
        row = len(rows) + first
        try:
            cells = next(reader, None)
        except csv.Error:
            _misquoted(path, row)
        if cells is None:
            return rows
        if reader.line_num + first - 1 != row:
            raise InputError(
                f"{path}: a cell in row {row} has a line break, which is not allowed: remove it"
            )
        if width is not None and len(cells) != width:
            ragged(path, row, len(cells), width)
        rows.append(cells)


def _misquoted(path: Path, row: int) -> NoReturn:
    raise InputError(
        f"{path}: a cell in row {row} has a quotation mark that is not at the beginning or end of "
        "the cell: quote whole cells, or none"
    )


def ragged(path: Path, row: int, cells: int, width: int) -> NoReturn:
    """Raise `InputError` for a row whose number of cells differs from that of the header."""
    raise InputError(
        f"{path}: row {row} has {cells} cell{'s' * (cells != 1)}, but the header names {width} "
        "columns: give every row one cell for each column, and leave cells without a measurement "
        "empty"
    )


_MISSING = ("", "nan", "na")
_FINITE = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(rf"{_FINITE}|[+-]?inf(inity)?", re.IGNORECASE | re.ASCII)
_SUFFIXES = (".csv", ".parquet")


@dataclass(frozen=True)
class Table:
    """The contents of a data file whose model is not known yet.

    Attributes:
        times: times, s, shape (sample,), or None.
        values: values by channel name, SI, each of shape (sample,); NaN means not measured. Text is
            an object array.
        channels: channels by the same names.
        sha256: checksum of the file.
        first_row: row number of the first sample, for error messages.
    """

    times: npt.NDArray[np.float64] | None
    values: dict[str, npt.NDArray[Any]]
    channels: dict[str, Channel]
    sha256: str
    first_row: int


def read_table(path: Path, rename: Mapping[str, str] | None = None) -> Table:
    """Read a `.csv` or `.parquet` file (`InputError`: the file is not a valid table)."""
    return _table_of(*_split(path), path, rename)


def table_of_lines(
    data: bytes, path: Path, rename: Mapping[str, str] | None = None, first_row: int = 2
) -> Table:
    """Read lines of a CSV file like `read_table`; the first line contains the column names.

    The line after it has the row number `first_row` in error messages.
    """
    return _table_of(data, *split_csv(data, path, first_row), path, rename)


def _table_of(
    data: bytes,
    header: list[str],
    columns: list[pl.Series],
    first_row: int,
    path: Path,
    rename: Mapping[str, str] | None,
) -> Table:
    names = _renamed(header, rename or {}, path)
    try:
        named = parse_columns(names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    times = None
    values: dict[str, npt.NDArray[Any]] = {}
    columns = columns or [pl.Series("", [], dtype=pl.String)] * len(names)  # a header without rows
    for (column, channel), series in zip(named.items(), columns, strict=True):
        where = f"{path}: column {column!r}"
        if channel.quantity == "text":
            texts = [None if text is None else str(text).strip() or None for text in series]
            values[channel.name] = np.array(texts, dtype=object)
            continue
        numbers = channel.to_si(numbers_of(series, [where], first_row))
        if channel.kind == "time":
            times = numbers
        else:
            values[channel.name] = numbers
    channels = {c.name: c for c in named.values() if c.kind != "time"}
    return Table(times, values, channels, hashlib.sha256(data).hexdigest(), first_row)


def read_numbers(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Return the numeric columns of a `.csv` or `.parquet` file by name; empty cells are NaN.

    Raises:
        InputError: the file is not such a table.
    """
    _, header, columns, first_row = _split(path)
    found: dict[str, npt.NDArray[np.float64]] = {}
    for name, series in zip(header, columns, strict=True):
        if name in found:
            raise InputError(f"{path} has the column {shown(name, 40)} twice: remove one")
        found[name] = numbers_of(series, [f"{path}: column {shown(name, 40)}"], first_row)
    return found


def column_names(path: Path) -> list[str]:
    """Return the column names of a `.csv` or `.parquet` file, without conversion."""
    return _split(path)[1]


def _split(path: Path) -> tuple[bytes, list[str], list[pl.Series], int]:
    """Return data, header and columns of a file, and the number of its first row for messages."""
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"{path} must be a run, a file whose name ends in .csv or .parquet: give such a file, "
            "or convert this one"
        )
    try:
        data = read_bytes(path, RUN_BYTES)
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give the path of a recorded run") from None
    except IsADirectoryError:
        raise InputError(f"{path} is a directory: give the path of one run in it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give a readable run") from None
    if not data.strip():
        raise InputError(f"{path} is empty: it must have a header line and samples")
    split = split_csv if path.suffix.lower() == ".csv" else split_parquet
    header, columns, first_row = split(data, path)
    if len(header) > COLUMNS:
        raise InputError(
            f"{path} has {len(header):,} columns, but may have at most {COLUMNS:,}: remove some"
        )
    if not columns or len(columns[0]) == 0:
        raise InputError(f"{path} has a header but no rows: it must have samples, so add them")
    return data, header, columns, first_row


def _renamed(header: Sequence[str], rename: Mapping[str, str], path: Path) -> list[str]:
    if all(_NUMBER.fullmatch(name) for name in header):
        raise InputError(
            f"{path}: the first line must name the columns, but holds numbers: add a header"
        )
    for old, new in rename.items():
        if old not in header:
            near = difflib.get_close_matches(old, header, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]!r}?" if near else "give the name of an existing column"
            there = ", ".join(header[:8]) + (", ..." if len(header) > 8 else "")
            raise InputError(
                f"--rename {old}={new}: {path} has no column {old!r}, but has {there}: {hint}"
            )
        try:
            parse_column(new)
        except InputError:
            closest = nearest(new)
            hint = f"did you mean {closest!r}?" if closest else "give a name such as link06_z_m"
            raise InputError(
                f"--rename {old}={new}: {new!r} is not in the column table: {hint}"
            ) from None
    names = [rename.get(name, name) for name in header]
    for position, name in enumerate(names, start=1):
        if not name:
            raise InputError(
                f"{path}: column {position} has no name, but must have a name from the column "
                f"table: name or remove the column"
            )
    return names


def numbers_of(
    series: pl.Series, columns: Sequence[str], first_row: int
) -> npt.NDArray[np.float64]:
    """Return the numbers in the cells of columns, row by row, NaN where nothing was measured.

    An `InputError` names the column and row in the file of a cell that is not a number.
    """
    if series.dtype == pl.Categorical:
        series = series.cast(pl.String)
    array = np.array(series.cast(pl.Float64, strict=False).to_numpy(), dtype=np.float64)
    if series.dtype != pl.String:
        return array
    # Accept fewer forms of numbers than Polars, whose forms may change.
    plain = series.str.contains(f"^(?:{_FINITE})$")
    if (plain.sum() or 0) + series.null_count() == len(series):
        return array
    for index in (series.is_not_null() & ~plain).arg_true():
        text = str(series[int(index)]).strip()
        if text.lower() in _MISSING:
            array[index] = np.nan
        elif _NUMBER.fullmatch(text):
            array[index] = float(text)
        else:
            row, column = divmod(int(index), len(columns))
            raise InputError(
                f"{columns[column]} has {shown(text, 40)} in row {row + first_row}, but must have "
                "a number or an empty cell: correct the cell"
            )
    return array
