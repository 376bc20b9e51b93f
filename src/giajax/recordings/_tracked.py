"""Points that another program tracked in a film, and the run that they make."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.files import read_text
from ..runtime.limits import RUN_BYTES, VALUE
from ..runtime.text import InputError, one_of, shown
from ._channels import Channel, column_table
from ._table import csv_lines, csv_rows, numbers_of, read_table, split_cells

TIME_UNITS = {"s": 1.0, "ms": 1e-3}

_SAID = ("scorer", "bodyparts", "coords")
_HEADERS = 4  # rows of DeepLabCut that are no pictures, at most


@dataclass(frozen=True)
class TrackedPoints:
    """What a program tracked in a film.

    Attributes:
        times: of the pictures, s, shape (picture,), increasing.
        points: u to the right and v down by the name of a point, px, each of shape (picture, 2);
            NaN where it was not found.
    """

    times: npt.NDArray[np.float64]
    points: Mapping[str, npt.NDArray[np.float64]]


def read_deeplabcut(path: str | Path, *, rate: float, likelihood: float = 0.6) -> TrackedPoints:
    """Read what DeepLabCut wrote of a film as CSV.

    Its three header rows are scorer, bodyparts and coords; of several animals there are four, with
    individuals before bodyparts. A row is a picture, which begins with its number.

    Arguments:
        path: of the file.
        rate: pictures a second.
        likelihood: a point that is less likely was not found.

    Returns:
        The points by body part; of several animals by `individual/bodypart`.

    Raises:
        InputError: the file is not of that form, or the rate is not positive.
    """
    path = Path(path)
    if not (np.isfinite(rate) and rate > 0):
        raise InputError(f"the rate is {rate:g}: give the pictures a second, a positive number")
    data = csv_lines(_content(path), path)
    lines = data.split(b"\n", _HEADERS)
    header: dict[str, list[str]] = {}
    cells: list[str] = []
    for number, line in enumerate(lines[:_HEADERS], 1):
        if line.partition(b",")[0].strip(b'"').decode() not in (*_SAID, "individuals"):
            break
        width = len(cells) + 1 if header else None
        ((kind, *cells),) = csv_rows(line, path, number, width=width)
        header[kind] = cells
    if not set(_SAID) <= set(header):
        raise InputError(
            f"{path} is not a file of DeepLabCut: it must begin with the rows scorer, bodyparts "
            "and coords, so give its CSV file of a film"
        )
    names, coordinates = header["bodyparts"], header["coords"]
    if "individuals" in header:
        names = [f"{of}/{name}" for of, name in zip(header["individuals"], names, strict=True)]
    body = b"\n".join(lines[len(header) :])
    labels = [f"{name} {kind}" for name, kind in zip(names, coordinates, strict=True)]
    table = _numbers(path, body, ["picture", *labels], len(header) + 1)
    columns: dict[str, dict[str, npt.NDArray[np.float64]]] = {}
    for name, kind, column in zip(names, coordinates, table.T[1:], strict=True):
        if kind in columns.setdefault(name, {}):
            raise _twice(path, name)
        columns[name][kind] = column
    points: dict[str, npt.NDArray[np.float64]] = {}
    for name, found in columns.items():
        if not {"x", "y"} <= set(found):
            raise InputError(
                f"{path}: {shown(name)} has no columns x and y: export the file again with both"
            )
        points[name] = np.stack([found["x"], found["y"]], axis=1)
        if "likelihood" in found:
            # Not found, where it does not say how likely.
            points[name][np.nan_to_num(found["likelihood"]) < likelihood] = np.nan
    return _checked(path, table[:, 0] / rate, points)


def read_kinovea(
    path: str | Path, *, origin: tuple[float, float], time_unit: str = "s"
) -> TrackedPoints:
    """Read the trajectories that Kinovea exported as CSV.

    Its header is `Time` and, for each trajectory, `name/point/X` and `name/point/Y`. Coordinates
    are counted from the origin of its coordinate system, Y upwards, in px where it is not
    calibrated; times as its preferences say. Where a comma stands in numbers, it may also separate
    cells, which are in quotes then, or a semicolon does.

    Arguments:
        path: of the file.
        origin: where that origin is in the picture, u and v, px.
        time_unit: of the times: `s`, as Kinovea writes them unless its time format is a number of
            something else, or `ms`.

    Returns:
        The points by the name of their trajectory, and by `name/point` where one has several.

    Raises:
        InputError: the file is not of that form, or there is no such unit.
    """
    path = Path(path)
    if time_unit not in TIME_UNITS:
        raise InputError(f"times in {time_unit!r}: give {one_of(list(TIME_UNITS))}")
    data = _content(path)
    separator = ";" if data.startswith((b'"Time";', b"Time;")) else ","
    head, _, body = csv_lines(data, path, separator).partition(b"\n")
    header = [cell for cells in csv_rows(head, path, 1, separator) for cell in cells]
    pairs = list(zip(header[1::2], header[2::2], strict=False))
    good = all(
        x[-2:] == "/X" and y[-2:] == "/Y" and x[:-2] == y[:-2] and "/" in x[:-2] for x, y in pairs
    )
    if not pairs or header[0] != "Time" or len(header) != 2 * len(pairs) + 1 or not good:
        raise InputError(
            f"{path} is not a file of Kinovea: its first row must be Time, name/point/X, "
            "name/point/Y, and so on, so export the measured data as CSV"
        )
    table = _numbers(path, body, header, 2, separator, decimal_comma=True)
    names = [x[:-2] for x, _ in pairs]
    tracks = Counter(name.rpartition("/")[0] for name in names)
    points: dict[str, npt.NDArray[np.float64]] = {}
    for place, name in enumerate(names):
        right, up = table[:, 2 * place + 1], table[:, 2 * place + 2]
        track = name.rpartition("/")[0]
        called = track if tracks[track] == 1 else name
        if called in points:
            raise _twice(path, called)
        points[called] = np.stack([origin[0] + right, origin[1] - up], axis=1)
    return _checked(path, table[:, 0] * TIME_UNITS[time_unit], points)


def _content(path: Path) -> bytes:
    return read_text(path, RUN_BYTES, "a CSV file", "the file of tracked points").encode()


def _twice(path: Path, name: str) -> InputError:
    return InputError(
        f"{path} has two points that are called {shown(name)}: rename one, and export it again"
    )


def _numbers(
    path: Path,
    body: bytes,
    names: Sequence[str],
    first: int,
    separator: str = ",",
    *,
    decimal_comma: bool = False,
) -> npt.NDArray[np.float64]:
    """Numbers of the rows, of which the first is line `first`, by the contract of runs."""
    if not body:
        raise InputError(f"{path} has a header but no rows: it must have pictures, so add them")
    cells = split_cells(body, len(names), path, first, separator)
    columns = [f"{path}: column {shown(name, 40)}" for name in names]
    if decimal_comma:
        cells = cells.str.replace(",", ".", literal=True)
    table = numbers_of(cells, columns, first)
    bad = np.flatnonzero(np.abs(table) > VALUE)
    if bad.size:
        row, column = divmod(int(bad[0]), len(names))
        raise InputError(
            f"{columns[column]} has {table[bad[0]]:g} in row {row + first}, but may have "
            f"{VALUE:g} at most: correct it, or leave the cell empty"
        )
    return table.reshape(-1, len(names))


def _checked(
    path: Path, times: npt.NDArray[np.float64], points: dict[str, npt.NDArray[np.float64]]
) -> TrackedPoints:
    if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
        raise InputError(
            f"{path}: pictures must follow each other in time, each once: sort the rows"
        )
    return TrackedPoints(times, points)


def filmed(
    tracked: TrackedPoints, channels: Mapping[str, str], camera: str | None = None
) -> dict[str, npt.NDArray[np.float64]]:
    """The channels of tracked points, such as `link06_u` and `link06_v`, px.

    They are NaN where a point was not found. Points without a channel are left out.

    Arguments:
        tracked: what a program tracked.
        channels: name of a tracked point -> what it is: `link06`, `tip` or `mark01`.
        camera: that filmed it; its name goes before those of the channels.

    Raises:
        InputError: no such point, a name that no camera shows, or one that is given twice.
    """
    values: dict[str, npt.NDArray[np.float64]] = {}
    for point, part in channels.items():
        if point not in tracked.points:
            known = ", ".join(tracked.points)
            raise InputError(
                f"there is no tracked point {shown(point)}: it must be one of {known}, so correct "
                "the name"
            )
        names = [f"{camera}.{part}_{axis}" if camera else f"{part}_{axis}" for axis in "uv"]
        for name, column in zip(names, tracked.points[point].T, strict=True):
            try:
                known_pixel = Channel.named(name).quantity == "pixel"
            except InputError:
                known_pixel = False
            if not known_pixel:
                raise InputError(
                    f"{shown(point)} is called {shown(part)}, which a camera does not show: call "
                    "it link06, tip or mark01, and the camera by letters, digits and _"
                )
            if name in values:
                raise InputError(f"two tracked points are called {shown(part)}: rename one")
            values[name] = column
    if not values:
        raise InputError(
            "no tracked point is a channel: say which is which, of "
            f"{', '.join(tracked.points)}, such as {next(iter(tracked.points))}=tip"
        )
    return values


class Beside(NamedTuple):
    """What was recorded beside a film: its times (s), what drove the arm, and what was measured."""

    times: npt.NDArray[np.float64]
    inputs: dict[str, npt.NDArray[np.float64]]
    measured: dict[str, npt.NDArray[np.float64]]


def read_beside(path: str | Path) -> Beside:
    """Read a table that was recorded beside a film.

    Raises:
        InputError: it is not a table of known columns, or has no times.
    """
    table = read_table(Path(path))
    if table.times is None:
        raise InputError(f"{path} has no times: give a file with time_s")
    parts: tuple[dict[str, npt.NDArray[np.float64]], ...] = ({}, {})
    for name, column in table.values.items():
        measured = column_table()[table.channels[name].kind].part == "output"
        if not measured and not np.all(np.isfinite(column)):
            raise InputError(f"{path}: {name} has empty cells: fill them in")
        parts[measured][name] = column
    return Beside(table.times, *parts)


def filmed_beside(
    times: npt.NDArray[np.float64], values: Mapping[str, npt.NDArray[np.float64]], beside: Beside
) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[np.float64]]]:
    """The points of a film and what was recorded beside it as one table, which loses neither.

    It has a row for each time (s) of either, on one clock. Between their rows inputs are linear,
    before the first and after the last they are held; what was measured stands at its own times
    alone.

    Raises:
        InputError: a channel of the film is there already.
    """
    rows = np.unique(np.concatenate([times, beside.times]))
    table = {name: np.interp(rows, beside.times, column) for name, column in beside.inputs.items()}
    for moments, measured in ((beside.times, beside.measured), (times, values)):
        for name, column in measured.items():
            if name in table:
                raise InputError(f"{name} is there twice: name the cameras, or leave one out")
            table[name] = np.full(len(rows), np.nan)
            table[name][np.searchsorted(rows, moments)] = column
    return rows, table
