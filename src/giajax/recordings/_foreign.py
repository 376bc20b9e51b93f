"""Files of other programs, each known by its content: what they tracked or measured, by name."""

import contextlib
import csv
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from ..runtime.files import read_bytes
from ..runtime.limits import RUN_BYTES, VALUE
from ..runtime.text import InputError, one_of, shown
from ..schema import QUANTITIES, si_factor
from ._channels import Channel, parse_column, parse_columns
from ._table import csv_lines, csv_rows, numbers_of, ragged, split_cells

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
        start, stop: the first and last time that is kept, s, after that.
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
    start: float = -np.inf
    stop: float = np.inf

    def __post_init__(self) -> None:
        rate, units = self.frame_rate, {"time": self.time_unit, "length": self.unit}
        if rate is not None and not (np.isfinite(rate) and rate > 0):
            raise InputError(f"the rate is {rate:g}: give the pictures a second, a positive number")
        for quantity, unit in units.items():
            if unit is not None and unit not in (known := QUANTITIES[quantity].suffixes):
                raise InputError(f"the unit of a {quantity} is {unit!r}: give {one_of(known)}")
        letters = sorted(axis.removeprefix("-") for axis in self.axes or ())
        if self.axes is not None and letters not in (["x", "z"], ["x", "y"], ["x", "y", "z"]):
            raise InputError(
                f"the axes are {','.join(self.axes)}: give each of x, y and z once, in the order "
                "of the file's coordinates, such as x,z of a film from the side or x,z,-y"
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
                        f"--{option} {pattern} is none of {_some(names)}: correct the name; "
                        "* stands for any letters"
                    )


def _matches(names: Sequence[str], patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(name, pattern) for name in names for pattern in patterns)


def _some(names: Sequence[str]) -> str:
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
    """

    program: str
    times: Numbers | None
    things: Mapping[str, Sequence[ForeignColumn]]
    channels: Mapping[str, npt.NDArray[Any]] = field(default_factory=dict)

    def named(self, name: str) -> Sequence[ForeignColumn]:
        """The columns of a thing, or the one that is called `thing label`; none otherwise."""
        if name in self.things:
            return self.things[name]
        thing, _, label = name.rpartition(" ")
        return [one for one in self.things.get(thing, ()) if one.label == label]


_TOP = 12  # lines in which a header is looked for
_SEPARATORS = (",", ";", "\t")


class Sheet:
    """A text file as rows of cells.

    Attributes:
        path: of the file.
        head: cells of the first lines.
    """

    def __init__(self, path: Path, data: bytes, separator: str) -> None:
        self.path, self.separator = path, separator
        self.lines = csv_lines(data, path, separator).split(b"\n")
        self.head = _head(data, separator)

    def rows(self, above: int, width: int) -> "Rows":
        """The cells of the lines below `above` lines, of which each has `width`."""
        lines = self.lines[above:]
        empty = self.separator.encode() + b" "
        while lines and not lines[-1].strip(empty):
            lines.pop()
        if not lines:
            raise InputError(
                f"{self.path} has a header but no rows: it must have pictures, so add them"
            )
        (first,) = csv_rows(lines[0], self.path, above + 1, self.separator)
        stride = len(first)
        cells = split_cells(b"\n".join(lines), stride, self.path, above + 1, self.separator)
        cells = cells.str.strip_chars().replace("", None)
        rows = Rows(self.path, cells, stride, above + 1)
        for place in range(width, stride):
            filled = rows.column(place).is_not_null()
            if filled.any():
                ragged(self.path, above + 1 + int(filled.arg_max() or 0), stride, width)
        if stride < width:
            ragged(self.path, above + 1, stride, width)
        return rows

    def numbers(self, above: int, width: int, wanted: Mapping[int, str]) -> dict[int, Numbers]:
        """Columns of numbers by their places; `wanted` has what errors call each."""
        return self.rows(above, width).numbers(wanted)


class Rows(NamedTuple):
    """Cells of text, row by row of `stride` cells each; the first row is line `first`."""

    path: Path
    cells: pl.Series
    stride: int
    first: int

    def column(self, place: int) -> pl.Series:
        """The cells of one column."""
        return self.cells.gather_every(self.stride, place)

    def numbers(self, wanted: Mapping[int, str]) -> dict[int, Numbers]:
        """As `Sheet.numbers`; a comma in a number is a decimal comma."""
        rows = np.arange(len(self.cells) // self.stride)[:, None] * self.stride
        cells = self.cells.gather((rows + np.array([*wanted], dtype=int)).ravel())
        columns = [f"{self.path}: column {shown(name, 40)}" for name in wanted.values()]
        table = numbers_of(cells.str.replace(",", ".", literal=True), columns, self.first)
        bad = np.flatnonzero(np.abs(table) > VALUE)
        if bad.size:
            row, column = divmod(int(bad[0]), len(columns))
            raise InputError(
                f"{columns[column]} has {table[bad[0]]:g} in row {row + self.first}, but may have "
                f"{VALUE:g} at most: correct it, or leave the cell empty"
            )
        return dict(zip(wanted, table.reshape(-1, len(wanted)).T, strict=True))


def _head(data: bytes, separator: str) -> list[list[str]]:
    """The cells of the first lines."""
    return [_cells(line, separator) for line in data.split(b"\n", _TOP)[:_TOP]]


def _cells(line: bytes, separator: str) -> list[str]:
    """The cells of a line, without empty ones at its end: spreadsheets fill rows up."""
    text = line.decode(errors="replace")
    try:
        cells = [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]
    except csv.Error:  # said with its row, once it is known whose file it is
        cells = text.split(separator)
    while cells and not cells[-1]:
        cells.pop()
    return cells


class AbstractFormat(ABC):
    """The tables of one program: how they are known, and what their columns are.

    Attributes:
        program: that writes them.
        form: what one looks like, for whoever has another.
    """

    program: ClassVar[str]
    form: ClassVar[str]

    @abstractmethod
    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        """Whether a file begins as one of this program."""

    @abstractmethod
    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        """What is in it."""

    def counted(self, sheet: Sheet, how: ImportSettings, frames: Numbers) -> Numbers:
        """Times, s, of the numbers of pictures."""
        if how.frame_rate is None:
            raise InputError(
                f"{sheet.path}: {self.program} counts pictures: give --frame-rate, the pictures a "
                "second of the film"
            )
        return self.increasing(sheet, frames / how.frame_rate)

    def timed(self, sheet: Sheet, how: ImportSettings, times: Numbers) -> Numbers:
        """Times, s, or those of the same pictures at the rate that is given instead."""
        times = self.increasing(sheet, times)
        if how.frame_rate is None or len(times) < 2:
            return times
        steps = np.diff(times)
        steps /= np.mean(steps[steps < 1.5 * np.min(steps)])  # others leave pictures out
        if np.any(np.abs(steps - np.round(steps)) > 0.25):  # stamps are rounded to milliseconds
            raise InputError(
                f"{sheet.path}: its times are not those of pictures, which follow each other in "
                "even steps: leave out --frame-rate"
            )
        frames = np.concatenate([[0.0], np.cumsum(np.round(steps))])
        first = np.round(times[0] / ((times[-1] - times[0]) / frames[-1]))
        return (first + frames) / how.frame_rate

    def increasing(self, sheet: Sheet, times: Numbers) -> Numbers:
        """The times, s, if they are those of rows that follow each other."""
        if not np.all(np.isfinite(times)) or np.any(np.diff(times) <= 0):
            raise InputError(
                f"{sheet.path}: pictures must follow each other in time, each once: sort the rows"
            )
        return times

    def unit(self, sheet: Sheet, how: ImportSettings) -> str:
        """The unit of coordinates whose file does not say it, `px` with a given origin."""
        if how.origin is not None:
            return "px"
        if how.unit is None:
            raise InputError(
                f"{sheet.path}: {self.program} does not say the unit of its coordinates: give "
                "--unit m, cm or mm, or of px that are counted upwards --origin U,V, where their "
                "origin is in the picture"
            )
        return how.unit


class _Points:
    """Coordinates as they are found in a file: by the name of the point and of the coordinate."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.found: dict[str, dict[str, Numbers]] = {}

    def add(self, name: str, coordinate: str, values: Numbers) -> None:
        columns = self.found.setdefault(name, {})
        if coordinate in columns:
            raise InputError(
                f"{self.path} has two points that are called {shown(name)}: rename one, and "
                "export it again"
            )
        columns[coordinate] = values

    def things(
        self, how: ImportSettings, unit: str, axes: Sequence[str] = ("x", "z")
    ) -> dict[str, list[ForeignColumn]]:
        """The points as columns: pixels, or lengths along axes of the base."""
        return {
            name: list(self._columns(name, found, how, unit, how.axes or axes))
            for name, found in self.found.items()
        }

    def _columns(
        self,
        name: str,
        found: Mapping[str, Numbers],
        how: ImportSettings,
        unit: str,
        axes: Sequence[str],
    ) -> Iterator[ForeignColumn]:
        coordinates = [letter for letter in "xyz" if letter in found]
        if coordinates[:2] != ["x", "y"]:
            raise InputError(
                f"{self.path}: {shown(name)} has no columns x and y: export the file again with "
                "both"
            )
        # Not found, where it does not say how likely.
        likely = [np.nan_to_num(found[kind]) for kind in ("likelihood", "score") if kind in found]
        good = likely[0] >= how.likelihood if likely else True
        x, y, *_ = values = [np.where(good, found[letter], np.nan) for letter in coordinates]
        if unit == "px":
            if how.origin is not None:
                x, y = how.origin[0] + x, how.origin[1] - y
            yield ForeignColumn("u", "pixel", x)
            yield ForeignColumn("v", "pixel", y)
            return
        if len(axes) != len(values):
            raise InputError(
                f"{self.path}: {shown(name)} has {len(values)} coordinates, but the axes are "
                f"{','.join(axes)}: give so many with --axes"
            )
        for axis, coordinate in zip(axes, values, strict=True):
            sign = -1.0 if axis[0] == "-" else 1.0
            metres = sign * si_factor("length", unit) * coordinate
            yield ForeignColumn(axis[-1], "length", metres)


class DeepLabCut(AbstractFormat):
    """A CSV file of DeepLabCut, of a film or of points in space that two films gave."""

    program = "DeepLabCut"
    form = "the rows scorer, bodyparts and coords"
    _said = ("scorer", "bodyparts", "coords")

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return set(self._said) <= {row[0] for row in head[:4] if row}

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        said = (*self._said, "individuals")
        header = {row[0]: row[1:] for row in sheet.head[:4] if row and row[0] in said}
        width = len(header["scorer"]) + 1
        for number, row in enumerate(header.values(), 1):
            if len(row) + 1 != width:
                ragged(sheet.path, number, len(row) + 1, width)
        names = header["bodyparts"]
        if "individuals" in header:
            names = [f"{of}/{name}" for of, name in zip(header["individuals"], names, strict=True)]
        places = list(enumerate(zip(names, header["coords"], strict=True), 1))
        labels = {0: "picture", **{place: " ".join(label) for place, label in places}}
        table = sheet.numbers(len(header), width, labels)
        points = _Points(sheet.path)
        for place, (name, coordinate) in places:
            points.add(name, coordinate, table[place])
        deep = header["coords"].count("z") == len(points.found)
        things = points.things(how, self.unit(sheet, how) if deep else "px", "xyz"[: 2 + deep])
        return ForeignTable(self.program, self.counted(sheet, how, table[0]), things)


class Sleap(AbstractFormat):
    """An analysis file of SLEAP as CSV: a row for each track and picture."""

    program = "SLEAP"
    form = "the columns track, frame_idx, name.x, name.y and name.score"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return {"track", "frame_idx"} <= set(head[0]) and any(c.endswith(".x") for c in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        header = sheet.head[0]
        rows = sheet.rows(1, len(header))
        kinds = {place: cell.rpartition(".") for place, cell in enumerate(header)}
        kinds = {place: kind for place, kind in kinds.items() if kind[2] in ("x", "y", "score")}
        kinds = {place: kind for place, kind in kinds.items() if kind[0] != "instance"}
        frame, track = header.index("frame_idx"), header.index("track")
        labels = {frame: "frame_idx", **{place: header[place] for place in kinds}}
        table = rows.numbers(labels)
        frames, at = np.unique(table[frame], return_inverse=True)
        tracks = np.array(rows.column(track).fill_null("").to_list())
        points = _Points(sheet.path)
        for name in dict.fromkeys(tracks.tolist()):
            of = np.flatnonzero(tracks == name)
            if len(np.unique(at[of])) < len(of):
                raise InputError(
                    f"{sheet.path}: the track {shown(name)} has a picture twice: track the "
                    "instances, or leave only one of them in each picture"
                )
            for place, (node, _, coordinate) in kinds.items():
                values = np.full(len(frames), np.nan)
                values[at[of]] = table[place][of]
                alone = len(of) == len(tracks)
                points.add(node if alone else f"{name}/{node}", coordinate, values)
        times = self.counted(sheet, how, frames)
        return ForeignTable(self.program, times, points.things(how, "px"))


class Anipose(AbstractFormat):
    """Points in space that anipose triangulated, as CSV."""

    program = "anipose"
    form = "the columns name_x, name_y, name_z, name_error and fnum"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return "fnum" in head[0] and any(cell.endswith("_error") for cell in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        header = sheet.head[0]
        names = {cell.removesuffix("_error") for cell in header if cell.endswith("_error")}
        kinds = {place: cell.rpartition("_") for place, cell in enumerate(header)}
        kinds = {place: kind for place, kind in kinds.items() if kind[0] in names}
        kinds = {
            place: kind for place, kind in kinds.items() if kind[2] in ("x", "y", "z", "score")
        }
        frame = header.index("fnum")
        labels = {frame: "fnum", **{place: header[place] for place in kinds}}
        table = sheet.numbers(1, len(header), labels)
        points = _Points(sheet.path)
        for place, (name, _, coordinate) in kinds.items():
            points.add(name, coordinate, table[place])
        times = self.counted(sheet, how, table[frame])
        return ForeignTable(self.program, times, points.things(how, self.unit(sheet, how), "xyz"))


class Kinovea(AbstractFormat):
    """Trajectories of Kinovea as CSV: coordinates from its own origin, upwards."""

    program = "Kinovea"
    form = "the columns Time, name/point/X and name/point/Y"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        cells = head[0][1:]
        pairs = list(zip(cells[::2], cells[1::2], strict=False))
        return (
            head[0][:1] == ["Time"]
            and bool(pairs)
            and len(cells) == 2 * len(pairs)
            and all((x[-2:], y[-2:]) == ("/X", "/Y") and x[:-2] == y[:-2] for x, y in pairs)
            and all("/" in x[:-2] for x, _ in pairs)
        )

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        header = sheet.head[0]
        table = sheet.numbers(1, len(header), dict(enumerate(header)))
        names = [cell[:-2] for cell in header[1::2]]
        tracks = [name.rpartition("/")[0] for name in names]
        several = {track for track, count in Counter(tracks).items() if count > 1}
        points = _Points(sheet.path)
        for place, (name, track) in enumerate(zip(names, tracks, strict=True)):
            called = name if track in several else track
            points.add(called, "x", table[2 * place + 1])
            points.add(called, "y", table[2 * place + 2])
        times = self.timed(sheet, how, table[0] * si_factor("time", how.time_unit))
        return ForeignTable(self.program, times, points.things(how, self.unit(sheet, how)))


class KinoveaText(AbstractFormat):
    """Trajectories of Kinovea as text for gnuplot: one below the other."""

    program = "Kinovea"
    form = "the line #Kinovea Trajectory data export"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return head[0][:1] == [self.form.removeprefix("the line ")]

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        tracks: dict[str, dict[int, list[str]]] = {}
        name = ""
        for number, line in enumerate(sheet.lines[1:], 2):
            cells = line.decode().split()
            if cells[:1] == ["#"]:
                name = " ".join(cells[1:])
            elif not cells:
                name = ""
            elif cells[0] != "#T":
                name = name or f"track {len(tracks) + 1}"
                if len(cells) != 3:
                    ragged(sheet.path, number, len(cells), 3)
                tracks.setdefault(name, {})[number] = cells
        if not tracks:
            raise InputError(f"{sheet.path} has no rows: it must have pictures, so add them")
        found = {}
        for name, rows in tracks.items():
            series = pl.Series("", [cell for row in rows.values() for cell in row])
            table = Rows(sheet.path, series, 3, min(rows)).numbers({0: "T", 1: "X", 2: "Y"})
            self.increasing(sheet, table[0])
            found[name] = table
        times = np.unique(np.concatenate([table[0] for table in found.values()]))
        points = _Points(sheet.path)
        for name, table in found.items():
            for place, letter in ((1, "x"), (2, "y")):
                values = np.full(len(times), np.nan)
                values[np.searchsorted(times, table[0])] = table[place]
                points.add(name, letter, values)
        times = self.timed(sheet, how, times * si_factor("time", how.time_unit))
        return ForeignTable(self.program, times, points.things(how, self.unit(sheet, how)))


class Tracker(AbstractFormat):
    """Data of Tracker: the names of the tracks, then t and the columns of each."""

    program = "Tracker"
    form = "a row of tracks above the row t, x, y"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return self._header(head) is not None

    @staticmethod
    def _header(head: Sequence[Sequence[str]]) -> int | None:
        """The line of the columns: the first, or below that of names, or `#multi:` above both."""
        for line, row in enumerate(head[:3]):
            if row[:1] == ["t"] and ({"x", "y"} <= {*row} or {"pixelx", "pixely"} <= {*row}):
                return line
        return None

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        line = self._header(sheet.head) or 0
        header = sheet.head[line]
        names = sheet.head[line - 1] if line else [sheet.path.stem]
        starts = [place for place, name in enumerate(names) if name]
        if starts == [0]:
            names, starts = ["", *names], [1]
        ends = [*starts[1:], len(header)]
        kinds = {
            place: (names[start], header[place])
            for start, end in zip(starts, ends, strict=True)
            for place in range(start, min(end, len(header)))
            if header[place] in ("x", "y", "pixelx", "pixely")
        }
        labels = {0: "t", **{place: " ".join(kind) for place, kind in kinds.items()}}
        table = sheet.numbers(line + 1, len(header), labels)
        points, pixels = _Points(sheet.path), _Points(sheet.path)
        for place, (name, kind) in kinds.items():
            if kind in ("x", "y"):
                points.add(name, kind, table[place])
            else:
                pixels.add(f"{name}/pixel", kind[-1], table[place])
        things: dict[str, list[ForeignColumn]] = {}
        if points.found and (how.unit or how.origin or not pixels.found):
            things |= points.things(how, self.unit(sheet, how))
        # Those are counted from the upper left corner, wherever the origin is.
        things |= pixels.things(ImportSettings(), "px")
        return ForeignTable(self.program, self.timed(sheet, how, table[0]), things)


class Motive(AbstractFormat):
    """A take of OptiTrack Motive as CSV: markers and rigid bodies in space, y upwards."""

    program = "OptiTrack Motive"
    form = "Format Version first, and the row Frame, Time (Seconds), X, Y, Z"
    _units: ClassVar = {"meters": "m", "centimeters": "cm", "millimeters": "mm"}

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return head[0][:1] == ["Format Version"]

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        line = next((i for i, row in enumerate(sheet.head) if row[:1] == ["Frame"]), None)
        if line is None or line < 4 or not sheet.head[line][1:2]:
            raise InputError(
                f"{sheet.path} is not a file of {self.program}: it must have {self.form}"
            )
        axes, parts = sheet.head[line], sheet.head[line - 1]
        # Between versions there are more rows or fewer; those that say what they are count.
        said = {label: row for row in sheet.head[1:line] for label in row[:2] if label}
        types = said.get("Type", sheet.head[line - 4])
        names = said.get("Name", sheet.head[line - 3])
        places = [
            place
            for place, part in enumerate(parts)
            if part == "Position" and place < min(len(axes), len(names), len(types))
        ]
        of: dict[str, set[str]] = {}
        for place in places:
            of.setdefault(names[place], set()).add(types[place])
        called = {
            place: f"{types[place]} {name}" if len(of[name := names[place]]) > 1 else name
            for place in places
        }
        labels = {place: f"{called[place]} {axes[place]}" for place in places}
        table = sheet.numbers(line + 1, len(axes), {0: "Frame", 1: "Time (Seconds)", **labels})
        points = _Points(sheet.path)
        for place in places:
            points.add(called[place], axes[place].lower(), table[place])
        meta = dict(zip(sheet.head[0][::2], sheet.head[0][1::2], strict=False))
        unit = self._units.get(meta.get("Length Units", "").lower()) or self.unit(sheet, how)
        things = points.things(how, unit, ("x", "z", "-y"))
        if how.frame_rate is None:
            times = self.increasing(sheet, table[1])
        else:
            times = self.counted(sheet, how, table[0])
        return ForeignTable(self.program, times, things)


class Phyphox(AbstractFormat):
    """What phyphox recorded with the sensors of a telephone: columns that say their unit."""

    program = "phyphox"
    form = 'the columns Time (s), "Gyroscope x (rad/s)" or "Acceleration x (m/s^2)"'
    _cell: ClassVar = re.compile(r"(?P<name>.*?)(?: (?P<axis>[xyz]))? \((?P<unit>[^()]+)\)")
    _quantities: ClassVar = {
        "rad/s": ("angular_velocity", 1.0),
        "°/s": ("angular_velocity", np.pi / 180),
        "m/s^2": ("acceleration", 1.0),
        "m/s²": ("acceleration", 1.0),
        "°": ("angle", np.pi / 180),
    }

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        found = [self._cell.fullmatch(cell) for cell in head[0]]
        units = [match["unit"] for match in found if match]
        return (
            None not in found and units[:1] == ["s"] and any(u in self._quantities for u in units)
        )

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        header = sheet.head[0]
        found = {p: m for p, cell in enumerate(header) if (m := self._cell.fullmatch(cell))}
        found = {p: m for p, m in found.items() if m["unit"] in self._quantities}
        labels = {0: header[0], **{place: header[place] for place in found}}
        table = sheet.numbers(1, len(header), labels)
        timed = np.isfinite(table[0])  # the shorter of two series is filled up with NaN
        things: dict[str, list[ForeignColumn]] = {}
        for place, match in found.items():
            quantity, factor = self._quantities[match["unit"]]
            column = ForeignColumn(match["axis"] or "", quantity, factor * table[place][timed])
            things.setdefault(match["name"], []).append(column)
        return ForeignTable(self.program, self.timed(sheet, how, table[0][timed]), things)


class ColumnTable(AbstractFormat):
    """A table whose first row names channels, whatever stands between its cells."""

    program = "a spreadsheet"
    form = "a first row of columns such as time_s and link06_z_mm, or --rename"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return len(head[0]) > 1 and any(cell in how.rename or _is_column(cell) for cell in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        header = sheet.head[0]
        for old in how.rename:
            if old not in header:
                raise InputError(
                    f"--rename {old}={how.rename[old]}: {sheet.path} has no column {old!r}, but "
                    f"{_some(header)}: correct the name"
                )
        names = [how.rename.get(cell, cell) for cell in header]
        times = {place for place, name in enumerate(names) if name in ("time_s", "time_ms")}
        how.check_patterns([*header, *names, *map(_channel_of, names)])
        places = [
            place
            for place, (cell, name) in enumerate(zip(header, names, strict=True))
            if place in times or how.keeps(cell, name, _channel_of(name))
        ]
        try:
            channels = parse_columns([names[place] for place in places]).values()
        except InputError as error:
            raise InputError(f"{sheet.path}: {error}; or leave it out with --ignore") from None
        rows = sheet.rows(1, len(header))
        kinds = dict(zip(places, channels, strict=True))
        table = rows.numbers(
            {place: header[place] for place in places if kinds[place].quantity != "text"}
        )
        values: dict[str, npt.NDArray[Any]] = {}
        for place, channel in kinds.items():
            if place in table:
                values[channel.name] = channel.to_si(table[place])
            else:
                values[channel.name] = np.array(rows.column(place).to_list(), dtype=object)
        stamps = values.pop("time", None)
        if stamps is None and how.frame_rate is not None:
            stamps = self.counted(sheet, how, np.arange(len(rows.column(0)), dtype=float))
        elif stamps is not None:
            stamps = self.timed(sheet, how, stamps)
        return ForeignTable(self.program, stamps, {}, values)


def _is_column(name: str) -> bool:
    return bool(_channel_of(name))


def _channel_of(name: str) -> str:
    with contextlib.suppress(InputError):
        return parse_column(name).name
    return ""


FORMATS: tuple[AbstractFormat, ...] = (
    DeepLabCut(),
    Sleap(),
    Anipose(),
    Kinovea(),
    KinoveaText(),
    Tracker(),
    Motive(),
    Phyphox(),
    ColumnTable(),
)
"""What `read_foreign` looks for, in this order."""


def read_foreign(
    path: str | Path,
    how: ImportSettings | None = None,
    formats: Sequence[AbstractFormat] = FORMATS,
) -> ForeignTable:
    """Read what another program recorded, by the content of its file.

    Cells are separated by commas, semicolons or tabs; numbers have a decimal point or comma.

    Raises:
        InputError: the file is of none of the formats, or is damaged.
    """
    path, how = Path(path), how or ImportSettings()
    try:
        data = read_bytes(path, RUN_BYTES)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}): give the file of tracked points"
        ) from None
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for separator in _SEPARATORS:
        head = _head(data, separator)
        for each in formats:
            if each.recognises(head, how):
                return each.read(Sheet(path, data, separator), how)
    if len(formats) == 1:
        (only,) = formats
        raise InputError(
            f"{path} is not a file of {only.program}: it must begin with {only.form}, so export "
            "it again"
        )
    known = "; ".join(f"{each.program} ({each.form})" for each in formats)
    raise InputError(f"{path} is no table that can be read: {known}: export it as one of these")


_ENDINGS = {
    "pixel": "_{label}",
    "length": "_{label}",
    "angular_velocity": "_gyro_{label}",
    "acceleration": "_accel_{label}",
    "angle": "_angle",
    "torque": "_torque",
}
_PARTS = {
    "pixel": "which a camera does not show: call it link06, tip or mark01, and the camera by "
    "letters, digits and _",
    "length": "of which no position is recorded: call it link06 or tip",
    "angular_velocity": "of which no rates are recorded: call it imu06, or one of its columns "
    "joint01_rate",
    "acceleration": "of which no acceleration is recorded: call it imu06",
    "angle": "of which no angle is recorded: call it joint01",
    "torque": "of which no torque is recorded: call it joint01_torque",
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
                f"{_some(list(table.things))}, so correct the name"
            )
        for column in columns:
            name = _channel_name(thing, part, column, camera, alone=len(columns) == 1)
            if name in values:
                raise InputError(f"two tracked points are called {shown(part)}: rename one")
            values[name], sources[name] = column.values, thing
    if not values:
        raise InputError(
            "no tracked point is a channel: say which is which, of "
            f"{_some(list(table.things))}, such as --point "
            f"{shown(next(iter(table.things), 'NAME') + '=tip')}"
        )
    if not table.channels:
        how.check_patterns([*table.things, *values])
        values = {n: v for n, v in values.items() if how.keeps(n, sources[n], n.partition("_")[0])}
        if not values:
            raise InputError("no channel is left: correct --only and --ignore")
    for flip in how.flip:
        flipped = [name for name in values if name == flip or name.endswith(f"_{flip}")]
        if not flipped:
            raise InputError(
                f"--flip {flip} is none of {_some(list(values))}: give an axis, such as z, or a "
                "channel"
            )
        values |= {name: -values[name] for name in flipped}
    return values


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


def kept_rows(
    table: ForeignTable, how: ImportSettings
) -> tuple[Numbers | None, npt.NDArray[np.int_] | slice]:
    """The times (s) of the rows that are kept, on the clock of the run, and which rows they are.

    Raises:
        InputError: no row is, or there are no times to choose by.
    """
    if table.times is None:
        if how.offset or np.isfinite(how.start) or np.isfinite(how.stop):
            raise InputError(
                "the file has no times: give --frame-rate, the rows a second, or leave out "
                "--offset, --from-time and --until"
            )
        return None, slice(None)
    times = table.times + how.offset
    rows = np.flatnonzero((times >= how.start) & (times <= how.stop))
    if not rows.size:
        raise InputError(
            f"no row is between {how.start:g} and {how.stop:g} s: the file goes from "
            f"{times[0]:.6g} to {times[-1]:.6g} s, so correct --from-time and --until"
        )
    return times[rows], rows
