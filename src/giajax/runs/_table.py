"""A data file as columns of numbers in SI units, with bad cells named by column and row."""

import difflib
import hashlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from .._errors import InputError
from .._files import read_bytes
from .._limits import COLUMNS, RUN_BYTES
from .._text import shown
from ._channels import Channel, parse_column, parse_columns
from ._column_complaints import nearest
from ._csv import split_csv
from ._parquet import split_parquet

_MISSING = ("", "nan", "na")
_FINITE = r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)([eE][+-]?[0-9]+)?"
_NUMBER = re.compile(rf"{_FINITE}|[+-]?inf(inity)?", re.IGNORECASE | re.ASCII)
_SUFFIXES = (".csv", ".parquet")


@dataclass(frozen=True)
class Table:
    """The content of a data file, before anything is known about its model.

    Attributes:
        times: s, shape (sample,), or None.
        values: by channel name, SI, each of shape (sample,): NaN = not measured; text as an
            object array.
        channels: by the same names.
        sha256: checksum of the file.
        first_row: what errors call the first sample.
    """

    times: npt.NDArray[np.float64] | None
    values: dict[str, npt.NDArray[Any]]
    channels: dict[str, Channel]
    sha256: str
    first_row: int


def read_table(path: Path, rename: Mapping[str, str] | None = None) -> Table:
    """Read a `.csv` or `.parquet` file.

    Raises:
        InputError: the file is not such a table.
    """
    data, header, columns, first_row = _split(path)
    names = _renamed(header, rename or {}, path)
    try:
        named = parse_columns(names)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    times = None
    values: dict[str, npt.NDArray[Any]] = {}
    for (column, channel), series in zip(named.items(), columns, strict=True):
        where = f"{path}: column {column!r}"
        if channel.quantity == "text":
            values[channel.name] = _texts(series)
            continue
        numbers = channel.to_si(_numbers(series, where, first_row))
        if channel.kind == "time":
            times = numbers
        else:
            values[channel.name] = numbers
    channels = {c.name: c for c in named.values() if c.kind != "time"}
    return Table(times, values, channels, hashlib.sha256(data).hexdigest(), first_row)


def read_numbers(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """The columns of a `.csv` or `.parquet` file by the names that they have there.

    Arguments:
        path: of the file, of which every cell is a number or empty (NaN).

    Raises:
        InputError: the file is not such a table.
    """
    _, header, columns, first_row = _split(path)
    found: dict[str, npt.NDArray[np.float64]] = {}
    for name, series in zip(header, columns, strict=True):
        if name in found:
            raise InputError(f"{path} has the column {shown(name, 40)} twice: remove one")
        found[name] = _numbers(series, f"{path}: column {shown(name, 40)}", first_row)
    return found


def _split(path: Path) -> tuple[bytes, list[str], list[pl.Series], int]:
    """Content, header and columns of a file, and what errors call its first row."""
    data = _bytes(path)
    split = split_csv if path.suffix.lower() == ".csv" else split_parquet
    header, columns, first_row = split(data, path)
    if len(header) > COLUMNS:
        raise InputError(
            f"{path} has {len(header):,} columns, but may have {COLUMNS:,} at most: remove some"
        )
    if not columns or len(columns[0]) == 0:
        raise InputError(f"{path} has a header but no rows: it must have samples, so add them")
    return data, header, columns, first_row


def _bytes(path: Path) -> bytes:
    if path.suffix.lower() not in _SUFFIXES:
        raise InputError(
            f"{path} must be a run, a file whose name ends in .csv or .parquet: give or convert one"
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
    return data


def _renamed(header: Sequence[str], rename: Mapping[str, str], path: Path) -> list[str]:
    if all(_NUMBER.fullmatch(name) for name in header):
        raise InputError(
            f"{path}: the first line must name the columns, but holds numbers: add a header"
        )
    for old, new in rename.items():
        if old not in header:
            near = difflib.get_close_matches(old, header, n=1, cutoff=0.6)
            hint = f"did you mean {near[0]!r}?" if near else "give a name that is there"
            there = ", ".join(header[:8]) + (", ..." if len(header) > 8 else "")
            raise InputError(
                f"--rename {old}={new}: {path} has no column {old!r}, but {there}: {hint}"
            )
        try:
            parse_column(new)
        except InputError:
            closest = nearest(new)
            hint = f"did you mean {closest!r}?" if closest else "give one such as link06_z_m"
            raise InputError(
                f"--rename {old}={new}: {new!r} is not in the column table: {hint}"
            ) from None
    names = [rename.get(name, name) for name in header]
    for position, name in enumerate(names, start=1):
        if not name:
            raise InputError(
                f"{path}: column {position} has no name, but must have one of the column table: "
                "name or remove it"
            )
    return names


def _numbers(series: pl.Series, where: str, first_row: int) -> npt.NDArray[np.float64]:
    """Numbers of a column, NaN where nothing was measured."""
    if series.dtype == pl.Categorical:
        series = series.cast(pl.String)
    array = np.array(series.cast(pl.Float64, strict=False).to_numpy(), dtype=np.float64)
    if series.dtype != pl.String:
        return array
    # What else Polars takes for a number is its own affair, and may change.
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
            raise InputError(
                f"{where} has {shown(text, 40)} in row {int(index) + first_row}, but must have a "
                "number or an empty cell: correct it"
            )
    return array


def _texts(series: pl.Series) -> npt.NDArray[Any]:
    texts = [None if text is None else str(text).strip() or None for text in series]
    array = np.empty(len(texts), dtype=object)
    array[:] = texts
    return array
