"""Points that another program tracked in a film, and their conversion to a run."""

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
    """Points that a program tracked in a film.

    Attributes:
        times: times of the frames, s, shape (picture,), increasing.
        points: u (to the right) and v (down) by point name, px, each of shape (picture, 2); NaN
            where the point was not found.
    """

    times: npt.NDArray[np.float64]
    points: Mapping[str, npt.NDArray[np.float64]]


def read_deeplabcut(path: str | Path, *, rate: float, likelihood: float = 0.6) -> TrackedPoints:
    """Read a CSV file that DeepLabCut wrote for a film.

    Its three header rows are scorer, bodyparts and coords. With several animals there is a fourth
    row, individuals, above bodyparts. Each further row is a frame and starts with the frame number.

    Arguments:
        path: path of the file.
        rate: frames per second.
        likelihood: points with a lower likelihood are treated as not found.

    Returns:
        The points by body part; with several animals by `individual/bodypart`.

    Raises:
        InputError: the file does not have this form, or the rate is not positive.
    """
    how = ImportSettings(frame_rate=rate, likelihood=likelihood)
    return _points(read_foreign(path, how, [DeepLabCut()]))


def read_kinovea(
    path: str | Path, *, origin: tuple[float, float], time_unit: str = "s"
) -> TrackedPoints:
    """Read trajectories that Kinovea exported as CSV.

    The header contains `Time` and, for each trajectory, `name/point/X` and `name/point/Y`.
    Coordinates are counted from the origin of the Kinovea coordinate system, with Y upwards, in px
    if the film is not calibrated. Times have the unit chosen in Kinovea. If numbers have a decimal
    comma, cells are separated by semicolons, or by commas with quotes around each cell.

    Arguments:
        path: path of the file.
        origin: position (u, v) of the Kinovea origin in the image, px.
        time_unit: unit of the times: `s`, the default of Kinovea, or `ms`.

    Returns:
        The points by trajectory name, and by `name/point` if a trajectory has several points.

    Raises:
        InputError: the file does not have this form, or the unit is unknown.
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
    """Return the channels of tracked points, such as `link06_u` and `link06_v`, px.

    They are NaN where a point was not found. Points without a channel are left out.

    Arguments:
        tracked: the tracked points.
        channels: name of a tracked point -> its meaning: `link06`, `tip` or `mark01`.
        camera: name of the camera, which is put in front of the channel names.

    Raises:
        InputError: a point does not exist, a meaning does not exist for a camera, or two points
            have the same one.
    """
    things = {
        name: [ForeignColumn("u", "pixel", both[:, 0]), ForeignColumn("v", "pixel", both[:, 1])]
        for name, both in tracked.points.items()
    }
    return channels_of(ForeignTable("", tracked.times, things), channels, camera)


class Beside(NamedTuple):
    """Data recorded together with a film: times (s), inputs of the arm, and measurements.

    Commands are `held` until the next one, or linear between two rows.
    """

    times: npt.NDArray[np.float64]
    inputs: dict[str, npt.NDArray[np.float64]]
    measured: dict[str, npt.NDArray[np.float64]]
    held: bool = False


def read_beside(path: str | Path) -> Beside:
    """Read a table recorded together with a film; its sidecar may specify `zoh` commands.

    Raises:
        InputError: the file is not a table with known column names, or has no times.
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
    """Return inputs and measurements separately."""
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
    """Merge the points of a film with the data recorded together with it into one table.

    The table has a row for each time (s) of either source, on one clock. Between the rows of a
    source its inputs are linear, or commands are `held` (this option applies to those in `values`;
    `beside` has its own). Inputs are constant before the first row and after the last one.
    Measurements have values only at their own times.

    Raises:
        InputError: both sources contain the same channel.
    """
    rows = np.unique(np.concatenate([times, beside.times]))
    table: dict[str, npt.NDArray[np.float64]] = {}
    for moments, inputs, measured, steps in (beside, Beside(times, *_parted(values), held)):
        for name in (name for name in (*inputs, *measured) if name in table):
            raise InputError(f"{name} is given twice: name the cameras, or remove one of the two")
        for name, column in inputs.items():
            last = np.maximum(np.searchsorted(moments, rows, side="right") - 1, 0)
            jumps = steps and Channel.named(name).quantity != "velocity"  # wind is interpolated
            table[name] = column[last] if jumps else np.interp(rows, moments, column)
        for name, column in measured.items():
            table[name] = np.full(len(rows), np.nan)
            table[name][np.searchsorted(rows, moments)] = column
    return rows, table
