"""Data that other programs recorded, by name, and their conversion to channels."""

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.text import InputError, one_of, shown
from ..schema import QUANTITIES
from ._channels import Channel, column_table

Numbers = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ImportSettings:
    """How the file of another program is read, and which parts of it become a run.

    Attributes:
        frame_rate: frames per second; replaces the times in a file that has some.
        likelihood: points with a lower likelihood are treated as not found.
        time_unit: unit of times if the file does not give it: `s` or `ms`.
        unit: unit of lengths if the file does not give it: `m`, `cm` or `mm`.
        origin: position (u, v) in the image of the origin of pixel coordinates that are counted
            upwards.
        axes: axes of the base along which the first, second (and third) coordinate of a file point,
            such as `x`, `z`, `-y`; the default depends on the format.
        rename: column of a table -> its name in the column table.
        only, ignore: patterns of names in the file or of channels to keep, and to leave out.
        flip: axes (`z`) or channels whose sign is changed.
        offset: time added to all times, s.
        from_time, until: first and last time that is kept, s, after the offset is added.
    """

    frame_rate: float | None = None
    likelihood: float = 0.6
    time_unit: str = "s"
    unit: str | None = None
    origin: tuple[float, float] | None = None
    axes: tuple[str, ...] | None = None
    rename: Mapping[str, str] = field(default_factory=dict)
    only: Sequence[str] = ()
    ignore: Sequence[str] = ()
    flip: Sequence[str] = ()
    offset: float = 0.0
    from_time: float = -np.inf
    until: float = np.inf

    def __post_init__(self) -> None:
        rate, units = self.frame_rate, {"time": self.time_unit, "length": self.unit}
        if rate is not None and not (np.isfinite(rate) and rate > 0):
            raise InputError(
                f"the frame rate is {rate:g}: give a positive number of frames per second"
            )
        for quantity, unit in units.items():
            if unit is not None and unit not in (known := QUANTITIES[quantity].suffixes):
                raise InputError(f"the unit of a {quantity} is {unit!r}: give {one_of(known)}")
        letters = sorted(axis.removeprefix("-") for axis in self.axes or ())
        if self.axes is not None and letters not in (["x", "z"], ["x", "y"], ["x", "y", "z"]):
            raise InputError(
                f"the axes are {','.join(self.axes)}: give each of x, y and z once, in the order "
                "of the file's coordinates, such as x,z for a film from the side or x,z,-y"
            )
        if not 0 <= self.likelihood <= 1:
            raise InputError(f"the likelihood is {self.likelihood:g}: give a number from 0 to 1")
        if not np.all(np.isfinite([self.offset, *(self.origin or ())])):
            raise InputError("--offset or --origin is not finite: give finite numbers")
        if np.isnan(self.from_time) or np.isnan(self.until):
            raise InputError("--from-time or --until is not a number: give a time in s")

    def check_used(self, path: Path, program: str, *used: str) -> None:
        """Refuse options that are set, but not used (`used`) to read this file."""
        for option, default in _AS_READ.items():
            if option not in used and getattr(self, option) != default:
                raise InputError(
                    f"{path}: --{option.replace('_', '-')} has no effect on this table of "
                    f"{program}: omit it"
                )

    def keeps(self, *names: str) -> bool:
        """Return whether data with these names become a part of the run."""
        wanted = not self.only or _matches(names, self.only)
        return wanted and not _matches(names, self.ignore)

    def check_patterns(self, names: Sequence[str]) -> None:
        """Refuse a pattern that matches none of the names."""
        for option in ("only", "ignore"):
            for pattern in getattr(self, option):
                if not _matches(names, [pattern]):
                    raise InputError(
                        f"--{option} {pattern} is not one of {some(names)}: correct the name (* "
                        "stands for any characters)"
                    )


_READING = ("frame_rate", "likelihood", "time_unit", "unit", "origin", "axes", "rename")
_AS_READ = {option: getattr(ImportSettings(), option) for option in _READING}


def _matches(names: Sequence[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def some(names: Sequence[str]) -> str:
    """Return the first of some names as text for a sentence."""
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")


class ForeignColumn(NamedTuple):
    """One column of a thing: its label next to the thing's name, quantity, and SI values (row,)."""

    label: str
    quantity: str
    values: Numbers


@dataclass(frozen=True)
class ForeignTable:
    """The data that another program recorded.

    Attributes:
        program: name of the program that wrote the file.
        times: times, s, shape (row,), increasing; None if the file has none.
        things: columns of each tracked point, sensor or joint, by its name.
        channels: columns that already have names of channels in the file; SI, shape (row,).
        merged: the rows come from several clocks, and a column has values only at its own times.
    """

    program: str
    times: Numbers | None
    things: Mapping[str, Sequence[ForeignColumn]]
    channels: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    merged: bool = False

    def named(self, name: str) -> Sequence[ForeignColumn]:
        """Return the columns of a thing, or the one column named `thing label`, if any."""
        if name in self.things:
            return self.things[name]
        thing, _, label = name.rpartition(" ")
        return [one for one in self.things.get(thing, ()) if one.label == label]


def placed(coordinates: Sequence[Numbers], axes: Sequence[str], what: str) -> list[ForeignColumn]:
    """Return coordinates (m) as columns along axes of the base, which may be reversed (`-y`).

    Raises:
        InputError: the number of axes differs from the number of coordinates of `what`.
    """
    if len(axes) != len(coordinates):
        raise InputError(
            f"{what} has {len(coordinates)} coordinates, but the axes are {','.join(axes)}: give "
            f"the same number of axes with --axes"
        )
    return [
        ForeignColumn(axis[-1], "length", -metres if axis[0] == "-" else metres)
        for axis, metres in zip(axes, coordinates, strict=True)
    ]


_ENDINGS = {
    "pixel": "_{label}",
    "length": "_{label}",
    "angular_velocity": "_gyro_{label}",
    "acceleration": "_accel_{label}",
    "linear_acceleration": "_accel_{label}",
    "angle": "_angle",
    "torque": "_torque",
}
_PARTS = {
    "pixel": (
        "which a camera cannot record: name it link06, tip or mark01, and use only letters, "
        "digits and _ in the name of the camera"
    ),
    "length": "for which no position can be recorded: name it link06 or tip",
    "angular_velocity": (
        "for which no rates can be recorded: name it imu06, or name one of its columns joint01_rate"
    ),
    "acceleration": "for which no acceleration can be recorded: name it imu06",
    "linear_acceleration": (
        "but its signal does not contain gravity, unlike the signal of an accelerometer: record "
        "the acceleration including gravity"
    ),
    "angle": "for which no angle can be recorded: name it joint01",
    "torque": "for which no torque can be recorded: name it joint01_torque",
}


def channels_of(
    table: ForeignTable,
    parts: Mapping[str, str],
    camera: str | None = None,
    how: ImportSettings | None = None,
) -> dict[str, npt.NDArray[Any]]:
    """Return the channels of recorded data, in SI and px; NaN where nothing was found.

    Arguments:
        table: the recorded data.
        parts: name of a thing, or of one of its columns (`Gyroscope z`) -> its meaning: `link06`,
            `tip`, `mark01`, `imu06`, `joint01`, or a channel. Others are left out.
        camera: name of the camera, which is put in front of the names of pixel channels.
        how: settings that select channels and change signs.

    Raises:
        InputError: a thing does not exist, cannot have the given meaning, or two have the same
            one; or no channel is left.
    """
    how = how or ImportSettings()
    values = dict(table.channels)
    sources: dict[str, str] = {}
    for thing, part in parts.items():
        columns = table.named(thing)
        if not columns:
            raise InputError(
                f"there is no tracked point {shown(thing)}: it must be one of "
                f"{some(list(table.things))}, so correct the name"
            )
        for column in columns:
            name = _channel_name(thing, part, column, camera, alone=len(columns) == 1)
            if name in values:
                raise InputError(f"two tracked points are called {shown(part)}: rename one")
            values[name], sources[name] = column.values, thing
    if not values and table.things:
        raise InputError(
            "no tracked point is assigned to a channel: assign some of "
            f"{some(list(table.things))}, for example with --point "
            f"{shown(next(iter(table.things), 'NAME') + '=tip')}"
        )
    if not table.channels:
        names = {name: (name, source, name.partition("_")[0]) for name, source in sources.items()}
        if table.things:
            how.check_patterns([*table.things, *(each for of in names.values() for each in of)])
        values = {name: column for name, column in values.items() if how.keeps(*names[name])}
        if not values:
            raise InputError("no channel is left: correct --only and --ignore")
    turned: set[str] = set()
    for flip in how.flip:
        numbers = [name for name, column in values.items() if column.dtype != object]
        flipped = [name for name in numbers if name == flip or name.endswith(f"_{flip}")]
        if not flipped:
            raise InputError(
                f"--flip {flip} is not one of {some(numbers)}: give an axis, such as z, or a "
                "channel"
            )
        turned.update(flipped)
    return {name: -column if name in turned else column for name, column in values.items()}


def _channel_name(
    thing: str, part: str, column: ForeignColumn, camera: str | None, *, alone: bool
) -> str:
    ending = _ENDINGS[column.quantity].format(label=column.label)
    if column.quantity == "angular_velocity" and column.label not in ("x", "y", "z"):
        ending = "_rate"
    prefix = f"{camera}." if camera and column.quantity == "pixel" else ""
    for name in (f"{prefix}{part}{ending}", *([f"{prefix}{part}"] if alone else [])):
        with contextlib.suppress(InputError):
            if Channel.named(name).quantity == column.quantity:
                return name
    raise InputError(f"{shown(thing)} is called {shown(part)}, {_PARTS[column.quantity]}")


def rows_kept(
    table: ForeignTable, values: Mapping[str, npt.NDArray[Any]], how: ImportSettings
) -> tuple[Numbers | None, dict[str, npt.NDArray[Any]]]:
    """Return times (s), with the offset added, and channels of the rows that are kept.

    With several clocks, a row is kept if any channel has a value there. Inputs hold their last
    value, and before the first one they have this first value.

    Raises:
        InputError: no row is kept, or rows are selected by time, but the file has no times.
    """
    if table.times is None:
        if how.offset or np.isfinite(how.from_time) or np.isfinite(how.until):
            raise InputError(
                "the file has no times: give --frame-rate, the number of rows per second, or omit "
                "--offset, --from-time and --until"
            )
        return None, dict(values)
    times = table.times + how.offset
    rows = (times >= how.from_time) & (times <= how.until)
    if not rows.any():
        raise InputError(
            f"no row is between {how.from_time:g} and {how.until:g} s: the file extends from "
            f"{times[0]:.6g} to {times[-1]:.6g} s, so correct --from-time and --until"
        )
    if table.merged:
        rows &= np.any([np.isfinite(column) for column in values.values()], axis=0)
        values = {name: _held(name, column, times) for name, column in values.items()}
    return times[rows], {name: column[rows] for name, column in values.items()}


def _held(name: str, column: Numbers, times: Numbers) -> Numbers:
    if column_table()[Channel.named(name).kind].part == "output":
        return column
    known = np.isfinite(column)
    if not known.any():
        return column
    last = np.searchsorted(times[known], times, side="right") - 1
    return column[known][np.maximum(last, 0)]
