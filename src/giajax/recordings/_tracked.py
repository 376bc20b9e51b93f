"""Points that another program tracked in a film, and the run that they make."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.text import InputError
from ..schema import CommandSection
from ._channels import Channel, column_table
from ._foreign import ForeignColumn, ForeignTable, ImportSettings, channels_of
from ._formats import DeepLabCut, Kinovea, read_foreign
from ._read import read_sidecar
from ._table import read_table


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
    how = ImportSettings(frame_rate=rate, likelihood=likelihood)
    return _points(read_foreign(path, how, [DeepLabCut()]))


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
    how = ImportSettings(origin=origin, time_unit=time_unit)
    return _points(read_foreign(path, how, [Kinovea()]))


def _points(table: ForeignTable) -> TrackedPoints:
    assert table.times is not None
    points = {
        name: np.stack([column.values for column in columns], axis=1)
        for name, columns in table.things.items()
    }
    return TrackedPoints(table.times, points)


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
    things = {
        name: [ForeignColumn("u", "pixel", both[:, 0]), ForeignColumn("v", "pixel", both[:, 1])]
        for name, both in tracked.points.items()
    }
    return channels_of(ForeignTable("", tracked.times, things), channels, camera)


class Beside(NamedTuple):
    """What was recorded beside a film: its times (s), what drove the arm, and what was measured.

    Commands are `held` until the next one, or linear between two rows.
    """

    times: npt.NDArray[np.float64]
    inputs: dict[str, npt.NDArray[np.float64]]
    measured: dict[str, npt.NDArray[np.float64]]
    held: bool = False


def read_beside(path: str | Path) -> Beside:
    """Read a table that was recorded beside a film, whose sidecar may say that commands are held.

    Raises:
        InputError: it is not a table with known column names, or has no times.
    """
    table = read_table(Path(path))
    if table.times is None:
        raise InputError(f"{path} has no times: give a file with time_s")
    inputs, measured = _parted(table.values)
    for name, column in inputs.items():
        if not np.all(np.isfinite(column)):
            raise InputError(f"{path}: {name} has empty cells: fill them in")
    command = read_sidecar(path).section(CommandSection)
    return Beside(table.times, inputs, measured, held=command.interpolation == "zoh")


def _parted(
    values: Mapping[str, npt.NDArray[np.float64]],
) -> tuple[dict[str, npt.NDArray[np.float64]], dict[str, npt.NDArray[np.float64]]]:
    """What drove the arm, and what was measured."""
    parts: tuple[dict[str, npt.NDArray[np.float64]], ...] = ({}, {})
    for name, column in values.items():
        measured = column_table()[Channel.named(name).kind].part == "output"
        parts[measured][name] = column
    return parts[0], parts[1]


def filmed_beside(
    times: npt.NDArray[np.float64],
    values: Mapping[str, npt.NDArray[np.float64]],
    beside: Beside,
    *,
    held: bool = False,
) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[np.float64]]]:
    """The points of a film and what was recorded beside it as one table, which loses neither.

    It has a row for each time (s) of either, on one clock. Between their rows inputs are linear, or
    commands `held` (those of `values`; `beside` says so of its own); before the first and after the
    last they are held; what was measured stands at its own times alone.

    Raises:
        InputError: a channel of the film is there already.
    """
    rows = np.unique(np.concatenate([times, beside.times]))
    table: dict[str, npt.NDArray[np.float64]] = {}
    for moments, inputs, measured, steps in (beside, Beside(times, *_parted(values), held)):
        for name in (name for name in (*inputs, *measured) if name in table):
            raise InputError(f"{name} is given twice: name the cameras, or remove one of the two")
        for name, column in inputs.items():
            last = np.maximum(np.searchsorted(moments, rows, side="right") - 1, 0)
            jumps = steps and Channel.named(name).quantity != "velocity"  # that of a wind
            table[name] = column[last] if jumps else np.interp(rows, moments, column)
        for name, column in measured.items():
            table[name] = np.full(len(rows), np.nan)
            table[name][np.searchsorted(rows, moments)] = column
    return rows, table
