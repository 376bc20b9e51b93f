"""What other programs recorded, by name, and the channels that it becomes."""

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
    """How the file of another program is read, and what of it becomes a run.

    Attributes:
        frame_rate: pictures a second; in place of the times of a file that has some.
        likelihood: a point that is less likely was not found.
        time_unit: of times whose file does not say it: `s` or `ms`.
        unit: of lengths whose file does not say it: `m`, `cm` or `mm`.
        origin: of coordinates that are counted in px, upwards: where it is in the picture, u and v.
        axes: the axes of the base that the first, the second (and the third) coordinate of a file
            are, as in `x`, `z`, `-y`; by default as the format has them.
        rename: column of a table -> its name in the column table.
        only, ignore: patterns of names, in the file or of channels: these alone, and without these.
        flip: axes (`z`) or channels whose sign is changed.
        offset: added to the times, s.
        from_time, until: the first and last time that is kept, s, after that.
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
                f"the rate is {rate:g}: give the number of pictures per second, a positive number"
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
            raise InputError("--offset and --origin must be finite numbers: correct them")
        if np.isnan(self.from_time) or np.isnan(self.until):
            raise InputError("--from-time and --until must be numbers: correct them")

    def check_used(self, path: Path, program: str, *used: str) -> None:
        """Refuse the options of how a file is read that are not among those of this one."""
        for option, default in _AS_READ.items():
            if option not in used and getattr(self, option) != default:
                raise InputError(
                    f"{path}: --{option.replace('_', '-')} has no effect on this table of "
                    f"{program}: omit it"
                )

    def keeps(self, *names: str) -> bool:
        """Whether what has these names becomes a part of the run."""
        wanted = not self.only or _matches(names, self.only)
        return wanted and not _matches(names, self.ignore)

    def check_patterns(self, names: Sequence[str]) -> None:
        """Refuse a pattern that none of the names fits."""
        for option in ("only", "ignore"):
            for pattern in getattr(self, option):
                if not _matches(names, [pattern]):
                    raise InputError(
                        f"--{option} {pattern} is not one of {some(names)}: correct the name; "
                        "* stands for any letters"
                    )


_READING = ("frame_rate", "likelihood", "time_unit", "unit", "origin", "axes", "rename")
_AS_READ = {option: getattr(ImportSettings(), option) for option in _READING}


def _matches(names: Sequence[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def some(names: Sequence[str]) -> str:
    """The first of some names, for a sentence."""
    return ", ".join(names[:20]) + (", ..." if len(names) > 20 else "")


class ForeignColumn(NamedTuple):
    """One column of a thing: its label beside the thing's name, its quantity, SI values (row,)."""

    label: str
    quantity: str
    values: Numbers


@dataclass(frozen=True)
class ForeignTable:
    """What another program recorded.

    Attributes:
        program: that wrote the file.
        times: s, shape (row,), increasing; None where the file has none.
        things: the columns of each tracked point, sensor or joint, by its name.
        channels: what the file itself calls by the names of channels; SI, shape (row,).
        merged: its rows are those of several clocks, so that each column has values at its own.
    """

    program: str
    times: Numbers | None
    things: Mapping[str, Sequence[ForeignColumn]]
    channels: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)
    merged: bool = False

    def named(self, name: str) -> Sequence[ForeignColumn]:
        """The columns of a thing, or the one that is called `thing label`; none otherwise."""
        if name in self.things:
            return self.things[name]
        thing, _, label = name.rpartition(" ")
        return [one for one in self.things.get(thing, ()) if one.label == label]


def placed(coordinates: Sequence[Numbers], axes: Sequence[str], what: str) -> list[ForeignColumn]:
    """Coordinates (m) along axes of the base, of which one may be the other way round (`-y`).

    Raises:
        InputError: there are not as many axes as coordinates of `what`.
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
    "pixel": "which a camera does not show: name it link06, tip or mark01, and name the camera "
    "with letters, digits and _",
    "length": "for which no position is recorded: name it link06 or tip",
    "angular_velocity": "for which no rates are recorded: name it imu06, or name one of its "
    "columns joint01_rate",
    "acceleration": "for which no acceleration is recorded: name it imu06",
    "linear_acceleration": "but gravity has been removed from it, unlike in the signal of an "
    "accelerometer: record the acceleration including gravity",
    "angle": "for which no angle is recorded: name it joint01",
    "torque": "for which no torque is recorded: name it joint01_torque",
}


def channels_of(
    table: ForeignTable,
    parts: Mapping[str, str],
    camera: str | None = None,
    how: ImportSettings | None = None,
) -> dict[str, npt.NDArray[Any]]:
    """The channels of what another program recorded, SI and px; NaN where nothing was found.

    Arguments:
        table: what it recorded.
        parts: name of a thing, or of one of its columns (`Gyroscope z`) -> what it is: `link06`,
            `tip`, `mark01`, `imu06`, `joint01`, or a channel. Others are left out.
        camera: that filmed it; its name goes before those of pixels.
        how: which channels are kept, and whose signs are changed.

    Raises:
        InputError: no such thing, a name that it cannot have, or one that is given twice; or
            nothing is left.
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
    """Times (s) on the clock of the run, and channels, of the rows that are kept.

    Of several clocks these are the rows at which a channel has a value; what drives the arm holds
    its last one, and the first one before.

    Raises:
        InputError: no row is kept, or there are no times to choose by.
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
