"""A run from points that were tracked in a film, and what was recorded beside it."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._text import shown
from ._channels import Channel
from ._column_table import TABLE
from ._table import read_table
from ._tracked import TrackedPoints


def filmed(
    tracked: TrackedPoints, channels: Mapping[str, str], camera: str | None = None
) -> dict[str, npt.NDArray[np.float64]]:
    """The channels of tracked points.

    Arguments:
        tracked: what a program tracked.
        channels: name of a tracked point -> what it is: `link06`, `tip` or `mark01`.
        camera: that filmed it; its name goes before those of the channels.

    Returns:
        `link06_u`, `link06_v` and so on, px, each of shape (picture,), NaN where a point was not
        found. Points without a channel are left out.

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
        measured = TABLE[table.channels[name].kind].part == "output"
        if not measured and not np.all(np.isfinite(column)):
            raise InputError(f"{path}: {name} has empty cells: fill them in")
        parts[measured][name] = column
    return Beside(table.times, *parts)


def filmed_beside(
    times: npt.NDArray[np.float64], values: Mapping[str, npt.NDArray[np.float64]], beside: Beside
) -> tuple[npt.NDArray[np.float64], dict[str, npt.NDArray[np.float64]]]:
    """The points of a film and what was recorded beside it as one table, which loses neither.

    It has a row for each time of either. Between their rows inputs are linear, before the first
    and after the last they are held; what was measured stands at its own times alone.

    Arguments:
        times: of the pictures, s.
        values: channels of the film, px.
        beside: on the clock of the film.

    Returns:
        Times, and all channels at them.

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
