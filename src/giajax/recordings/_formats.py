"""Files of other programs, recognised by their content: tracked points and sensor data."""

import csv
import re
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
import numpy.typing as npt
import polars as pl

from ..runtime.files import read_bytes
from ..runtime.limits import FOREIGN_COLUMNS, RUN_BYTES, VALUE
from ..runtime.text import InputError, shown
from ..schema import si_factor
from ._bags import is_bag, read_bag
from ._channels import channel_of, parse_columns
from ._foreign import ForeignColumn, ForeignTable, ImportSettings, Numbers, placed, some
from ._table import csv_lines, csv_rows, numbers_of, ragged, split_cells

_TOP = 12  # number of lines in which a header is sought
_SEPARATORS = (",", ";", "\t")


class Sheet:
    """A text file as rows of cells.

    Attributes:
        path: path of the file.
        head: cells of the first lines.
        first: line number of the first row, after the rows were read.
    """

    def __init__(self, path: Path, data: bytes, separator: str) -> None:
        self.path, self.separator = path, separator
        self.lines = csv_lines(data, path, separator).split(b"\n")
        self.first = 1
        self.head = _head(data, separator)

    def rows(self, above: int, width: int) -> "Rows":
        """Return the cells below the first `above` lines; each row must have `width` cells."""
        self.first = above + 1
        lines = self.lines[above:]
        empty = self.separator.encode() + b" "
        while lines and not lines[-1].strip(empty):
            lines.pop()
        if not lines:
            raise InputError(
                f"{self.path} has a header but no rows: it must have at least one row, so add the "
                "rows"
            )
        first = csv_rows(lines[0], self.path, above + 1, self.separator)
        stride = len(first[0]) if first else 0  # an empty line has no cells
        if stride < width:
            ragged(self.path, above + 1, stride, width)
        cells = split_cells(b"\n".join(lines), stride, self.path, above + 1, self.separator)
        cells = cells.str.strip_chars().replace("", None)
        rows = Rows(self.path, cells, stride, above + 1)
        for place in range(width, stride):
            filled = rows.column(place).is_not_null()
            if filled.any():
                ragged(self.path, above + 1 + int(filled.arg_max() or 0), stride, width)
        return rows

    def numbers(self, above: int, width: int, wanted: Mapping[int, str]) -> dict[int, Numbers]:
        """Return columns of numbers by position; `wanted` gives the names for error messages."""
        return self.rows(above, width).numbers(wanted)


class Rows(NamedTuple):
    """Cells of text, row by row with `stride` cells each; the first row is line `first`."""

    path: Path
    cells: pl.Series
    stride: int
    first: int

    def column(self, place: int) -> pl.Series:
        """Return the cells of one column."""
        return self.cells.gather_every(self.stride, place)

    def numbers(self, wanted: Mapping[int, str]) -> dict[int, Numbers]:
        """Return numbers as `Sheet.numbers`; a comma in a number is a decimal comma."""
        rows = np.arange(len(self.cells) // self.stride)[:, None] * self.stride
        cells = self.cells.gather((rows + np.array([*wanted], dtype=int)).ravel())
        commas = cells.str.contains(",", literal=True).fill_null(False)
        if commas.any() and cells.str.contains(".", literal=True).any():
            at = int(commas.arg_max() or 0)
            raise InputError(
                f"{self.path}: row {self.first + at // len(wanted)} has {shown(cells[at], 40)}, "
                "but other numbers have a decimal point: write all numbers without thousands "
                "separators"
            )
        columns = [f"{self.path}: column {shown(name, 40)}" for name in wanted.values()]
        table = numbers_of(cells.str.replace(",", ".", literal=True), columns, self.first)
        bad = np.flatnonzero(np.abs(table) > VALUE)
        if bad.size:
            row, column = divmod(int(bad[0]), len(columns))
            raise InputError(
                f"{columns[column]} has {table[bad[0]]:g} in row {row + self.first}, but values "
                f"must be at most {VALUE:g} in magnitude: correct the value, or leave the cell "
                "empty"
            )
        return dict(zip(wanted, table.reshape(-1, len(wanted)).T, strict=True))


def _head(data: bytes, separator: str) -> list[list[str]]:
    """Return the cells of the first lines."""
    return [_cells(line, separator) for line in data.split(b"\n", _TOP)[:_TOP]]


def _cells(line: bytes, separator: str) -> list[str]:
    """Return the cells of a line without the empty cells that spreadsheets append."""
    text = line.decode(errors="replace")
    try:
        cells = [cell.strip() for cell in next(csv.reader([text], delimiter=separator), [])]
    except csv.Error:  # reported with its row once the format of the file is known
        cells = text.split(separator)
    while cells and not cells[-1]:
        cells.pop()
    return cells


class AbstractFormat(ABC):
    """The tables of one program: how to recognise them, and what their columns mean.

    Attributes:
        program: name of the program that writes the tables.
        form: description of such a table, for error messages.
    """

    program: ClassVar[str]
    form: ClassVar[str]

    @abstractmethod
    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        """Return whether the first lines are those of a file of this program."""

    @abstractmethod
    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        """Read the contents of a file."""

    def counted(self, sheet: Sheet, how: ImportSettings, frames: Numbers) -> Numbers:
        """Convert frame numbers to times, s."""
        if how.frame_rate is None:
            raise InputError(
                f"{sheet.path}: {self.program} gives frame numbers instead of times: give "
                f"--frame-rate, the frame rate of "
                "the film"
            )
        return self.increasing(sheet, frames / how.frame_rate)

    def timed(self, sheet: Sheet, how: ImportSettings, times: Numbers) -> Numbers:
        """Return the times, s, or the times of the same frames at the given frame rate."""
        times = self.increasing(sheet, times)
        if how.frame_rate is None or len(times) < 2:
            return times
        steps = np.diff(times)
        steps /= np.mean(steps[steps < 1.5 * np.min(steps)])  # longer steps skip frames
        if np.any(np.abs(steps - np.round(steps)) > 0.25):  # stamps are rounded to milliseconds
            raise InputError(
                f"{sheet.path}: the times are not multiples of a constant frame interval: omit "
                "--frame-rate"
            )
        frames = np.concatenate([[0.0], np.cumsum(np.round(steps))])
        first = np.round(times[0] / ((times[-1] - times[0]) / frames[-1]))
        return (first + frames) / how.frame_rate

    def increasing(self, sheet: Sheet, times: Numbers) -> Numbers:
        """Return the times, s, after a check that they increase from row to row."""
        steps = np.diff(times)
        bad = np.flatnonzero(~np.isfinite(times) | np.append(False, steps <= 0))
        if bad.size:
            at = bad[0]
            what = (
                "has no time: add the time, or remove the row"
                if not np.isfinite(times[at])
                else "has the same time as the previous row: remove one of the two rows"
                if steps[at - 1] == 0
                else "goes back in time: sort the rows, or remove a second recording"
            )
            raise InputError(
                f"{sheet.path}: the time must increase from row to row, but row "
                f"{sheet.first + at} {what}"
            )
        return times

    def unit(self, sheet: Sheet, how: ImportSettings, *, pixels: bool = True) -> str:
        """Return the unit of coordinates whose file does not give it: `px` if an origin is set."""
        if pixels and how.origin is not None:
            return "px"
        if how.unit is None:
            upwards = (
                ", or, for pixel coordinates that increase upwards, --origin U,V, the position of "
                "their origin in the image"
            )
            raise InputError(
                f"{sheet.path}: {self.program} does not give the unit of its coordinates: give "
                f"--unit m, cm or mm{upwards if pixels else ''}"
            )
        return how.unit


def _plane(how: ImportSettings) -> tuple[str, ...]:
    """Return the options that apply to coordinates counted upwards, in px or as lengths."""
    return ("unit", "axes") if how.origin is None else ("origin",)


class _Points:
    """Coordinates found in a file, by the name of the point and of the coordinate."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.found: dict[str, dict[str, Numbers]] = {}

    def add(self, name: str, coordinate: str, values: Numbers) -> None:
        columns = self.found.setdefault(name, {})
        if coordinate in columns:
            raise InputError(
                f"{self.path} has two points that are called {shown(name)}: rename one, and "
                "export the file again"
            )
        columns[coordinate] = values

    def things(
        self, how: ImportSettings, unit: str, axes: Sequence[str] = ("x", "z")
    ) -> dict[str, list[ForeignColumn]]:
        """Return the points as columns: pixels, or lengths along axes of the base."""
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
        # A point without a likelihood counts as not found if the file gives likelihoods.
        likely = [np.nan_to_num(found[kind]) for kind in ("likelihood", "score") if kind in found]
        good = likely[0] >= how.likelihood if likely else True
        x, y, *_ = values = [np.where(good, found[letter], np.nan) for letter in coordinates]
        if unit == "px":
            if how.origin is not None:
                x, y = how.origin[0] + x, how.origin[1] - y
            yield ForeignColumn("u", "pixel", x)
            yield ForeignColumn("v", "pixel", y)
            return
        metres = [si_factor("length", unit) * each for each in values]
        yield from placed(metres, axes, f"{self.path}: {shown(name)}")


class DeepLabCut(AbstractFormat):
    """A CSV file of DeepLabCut, with points in an image or triangulated points in space."""

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
        # DeepLabCut counts pixels downwards, as image coordinates do.
        space = ("unit", "axes") if deep else ()
        how.check_used(sheet.path, self.program, "frame_rate", "likelihood", *space)
        unit = self.unit(sheet, how, pixels=False) if deep else "px"
        things = points.things(how, unit, "xyz"[: 2 + deep])
        return ForeignTable(self.program, self.counted(sheet, how, table[0]), things)


class Sleap(AbstractFormat):
    """An analysis file of SLEAP as CSV, with a row for each track and frame."""

    program = "SLEAP"
    form = "the columns track, frame_idx, name.x, name.y and name.score"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return {"track", "frame_idx"} <= set(head[0]) and any(c.endswith(".x") for c in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        how.check_used(sheet.path, self.program, "frame_rate", "likelihood")
        header = sheet.head[0]
        rows = sheet.rows(1, len(header))
        kinds = {place: cell.rpartition(".") for place, cell in enumerate(header)}
        wanted = ("x", "y", "score")
        kinds = {p: k for p, k in kinds.items() if k[2] in wanted and k[0] != "instance"}
        frame, track = header.index("frame_idx"), header.index("track")
        labels = {frame: "frame_idx", **{place: header[place] for place in kinds}}
        table = rows.numbers(labels)
        order = np.arange(len(table[frame]), dtype=float)  # frame numbers restart with each track
        self.increasing(sheet, np.where(np.isnan(table[frame]), np.nan, order))
        frames, at = np.unique(table[frame], return_inverse=True)
        tracks = np.array(rows.column(track).fill_null("").to_list())
        points = _Points(sheet.path)
        for name in dict.fromkeys(tracks.tolist()):
            of = np.flatnonzero(tracks == name)
            if len(np.unique(at[of])) < len(of):
                raise InputError(
                    f"{sheet.path}: the track {shown(name)} has two instances in one frame: track "
                    "the instances, or keep only one in each frame"
                )
            for place, (node, _, coordinate) in kinds.items():
                values = np.full(len(frames), np.nan)
                values[at[of]] = table[place][of]
                alone = len(of) == len(tracks)
                points.add(node if alone else f"{name}/{node}", coordinate, values)
        times = self.counted(sheet, how, frames)
        return ForeignTable(self.program, times, points.things(how, "px"))


class Anipose(AbstractFormat):
    """A CSV file of points in space that anipose triangulated."""

    program = "anipose"
    form = "the columns name_x, name_y, name_z, name_error and fnum"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return "fnum" in head[0] and any(cell.endswith("_error") for cell in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        how.check_used(sheet.path, self.program, "frame_rate", "likelihood", "unit", "axes")
        header = sheet.head[0]
        names = {cell.removesuffix("_error") for cell in header if cell.endswith("_error")}
        kinds = {place: cell.rpartition("_") for place, cell in enumerate(header)}
        wanted = [(name, kind) for name in names for kind in ("x", "y", "z", "score")]
        kinds = {place: kind for place, kind in kinds.items() if (kind[0], kind[2]) in wanted}
        frame = header.index("fnum")
        labels = {frame: "fnum", **{place: header[place] for place in kinds}}
        table = sheet.numbers(1, len(header), labels)
        points = _Points(sheet.path)
        for place, (name, _, coordinate) in kinds.items():
            points.add(name, coordinate, table[place])
        times = self.counted(sheet, how, table[frame])
        unit = self.unit(sheet, how, pixels=False)
        return ForeignTable(self.program, times, points.things(how, unit, "xyz"))


class Kinovea(AbstractFormat):
    """A CSV file of trajectories from Kinovea, with coordinates counted upwards from its origin."""

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
        how.check_used(sheet.path, self.program, "frame_rate", "time_unit", *_plane(how))
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
    """A gnuplot text file of trajectories from Kinovea, one below the other."""

    program = "Kinovea"
    form = "the line #Kinovea Trajectory data export"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return head[0][:1] == [self.form.removeprefix("the line ")]

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        how.check_used(sheet.path, self.program, "frame_rate", "time_unit", *_plane(how))
        tracks: list[tuple[str, dict[int, list[str]]]] = []
        name, begun = "", False
        for number, line in enumerate(sheet.lines[1:], 2):
            cells = line.decode().split()
            if cells[:1] == ["#"]:
                name, begun = " ".join(cells[1:]), False
            elif not cells:
                name, begun = "", False
            elif cells[0] != "#T":
                if len(cells) != 3:
                    ragged(sheet.path, number, len(cells), 3)
                if not begun:
                    tracks.append((name or f"track {len(tracks) + 1}", {}))
                begun = True
                tracks[-1][1][number] = cells
        if not tracks:
            raise InputError(
                f"{sheet.path} has no rows: it must have at least one row, so add the rows"
            )
        found = []
        for name, rows in tracks:
            series = pl.Series("", [cell for row in rows.values() for cell in row])
            sheet.first = min(rows)
            table = Rows(sheet.path, series, 3, sheet.first).numbers({0: "T", 1: "X", 2: "Y"})
            self.increasing(sheet, table[0])
            found.append((name, table))
        times = np.unique(np.concatenate([table[0] for _, table in found]))
        points = _Points(sheet.path)
        for name, table in found:
            for place, letter in ((1, "x"), (2, "y")):
                values = np.full(len(times), np.nan)
                values[np.searchsorted(times, table[0])] = table[place]
                points.add(name, letter, values)
        times = self.timed(sheet, how, times * si_factor("time", how.time_unit))
        return ForeignTable(self.program, times, points.things(how, self.unit(sheet, how)))


class Tracker(AbstractFormat):
    """A data file of Tracker: a row of track names, then t and the columns of each track."""

    program = "Tracker"
    form = "a row of tracks above the row t, x, y"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return self._header(head) is not None

    @staticmethod
    def _header(head: Sequence[Sequence[str]]) -> int | None:
        """Return the line of column names, which may be below a row of names and `#multi:`."""
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
        measured = points.found and (how.unit or how.origin or not pixels.found)
        how.check_used(sheet.path, self.program, "frame_rate", *(_plane(how) if measured else ()))
        things = points.things(how, self.unit(sheet, how)) if measured else {}
        # Pixel columns are counted from the upper left corner, regardless of the origin.
        things |= pixels.things(ImportSettings(), "px")
        return ForeignTable(self.program, self.timed(sheet, how, table[0]), things)


class Motive(AbstractFormat):
    """A CSV file of an OptiTrack Motive take: markers and rigid bodies in space, y upwards."""

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
        # The number of header rows depends on the version, so labelled rows take precedence.
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
        # The last column may be a marker error, which has no axis.
        width = max(map(len, (axes, parts, names)))
        table = sheet.numbers(line + 1, width, {0: "Frame", 1: "Time (Seconds)", **labels})
        points = _Points(sheet.path)
        for place in places:
            points.add(called[place], axes[place].lower(), table[place])
        meta = dict(zip(sheet.head[0][::2], sheet.head[0][1::2], strict=False))
        unit = self._units.get(meta.get("Length Units", "").lower())
        how.check_used(sheet.path, self.program, "frame_rate", "axes", *([] if unit else ["unit"]))
        unit = unit or self.unit(sheet, how, pixels=False)
        things = points.things(how, unit, ("x", "z", "-y"))
        if how.frame_rate is None:
            times = self.increasing(sheet, table[1])
        else:
            times = self.counted(sheet, how, table[0])
        return ForeignTable(self.program, times, things)


class Phyphox(AbstractFormat):
    """Smartphone sensor data recorded by phyphox, with the unit in each column name."""

    program = "phyphox"
    form = 'the columns Time (s), "Gyroscope x (rad/s)" or "Acceleration x (m/s^2)"'
    _cell: ClassVar = re.compile(r"(?P<name>.*?)(?: (?P<axis>[xyz]))? \((?P<unit>[^()]+)\)")
    _without_g: ClassVar = re.compile("linear|without g", re.IGNORECASE)
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
        how.check_used(sheet.path, self.program, "frame_rate")
        header = sheet.head[0]
        if header.count(header[0]) > 1:
            raise InputError(
                f"{sheet.path} has the column {header[0]!r} {header.count(header[0])} times: put "
                "the columns of each recording into a separate file"
            )
        cells = {p: m for p, cell in enumerate(header) if (m := self._cell.fullmatch(cell))}
        found = {p: m for p, m in cells.items() if m["unit"] in self._quantities}
        labels = {0: header[0], **{place: header[place] for place in found}}
        table = sheet.numbers(1, len(header), labels)
        timed = np.isfinite(table[0])  # the shorter of two series is padded with NaN
        lost = ~timed & np.any([np.isfinite(table[place]) for place in found], axis=0)
        self.increasing(sheet, np.where(lost, np.nan, np.arange(float(len(lost)))))
        things: dict[str, list[ForeignColumn]] = {}
        for place, match in found.items():
            quantity, factor = self._quantities[match["unit"]]
            if quantity == "acceleration" and self._without_g.search(match["name"]):
                quantity = "linear_acceleration"
            column = ForeignColumn(match["axis"] or "", quantity, factor * table[place][timed])
            things.setdefault(match["name"], []).append(column)
        return ForeignTable(self.program, self.timed(sheet, how, table[0][timed]), things)


class ColumnTable(AbstractFormat):
    """A table whose first row contains channel names, with any separator between cells."""

    program = "a spreadsheet"
    form = "a first row with column names such as time_s and link06_z_mm, or --rename"

    def recognises(self, head: Sequence[Sequence[str]], how: ImportSettings) -> bool:
        return len(head[0]) > 1 and any(cell in how.rename or channel_of(cell) for cell in head[0])

    def read(self, sheet: Sheet, how: ImportSettings) -> ForeignTable:
        how.check_used(sheet.path, self.program, "frame_rate", "rename")
        header = sheet.head[0]
        for old in how.rename:
            if old not in header:
                raise InputError(
                    f"--rename {old}={how.rename[old]}: {sheet.path} has no column {old!r}, but "
                    f"has {some(header)}: correct the name"
                )
        names = [how.rename.get(cell, cell) for cell in header]
        times = {place for place, name in enumerate(names) if name in ("time_s", "time_ms")}
        how.check_patterns([*header, *names, *map(channel_of, names)])
        places = [
            place
            for place, (cell, name) in enumerate(zip(header, names, strict=True))
            if place in times or how.keeps(cell, name, channel_of(name))
        ]
        try:
            channels = parse_columns([names[place] for place in places]).values()
        except InputError as error:
            raise InputError(f"{sheet.path}: {error}; or exclude it with --ignore") from None
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
"""The formats that `read_foreign` tries, in this order."""


def read_foreign(
    path: str | Path,
    how: ImportSettings | None = None,
    formats: Sequence[AbstractFormat] = FORMATS,
) -> ForeignTable:
    """Read a file of another program, recognised by its content, or a bag of ROS 2.

    Cells are separated by commas, semicolons or tabs; numbers have a decimal point or comma.

    Raises:
        InputError: the file has none of the formats, or is damaged.
    """
    path, how = Path(path), how or ImportSettings()
    if is_bag(path):
        return read_bag(path, how)
    try:
        data = read_bytes(path, RUN_BYTES)
    except OSError as error:
        raise InputError(
            f"{path} cannot be read ({error.strerror}): give the file of tracked points"
        ) from None
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for separator in _SEPARATORS:
        head = _head(data, separator)
        if (widest := max(map(len, head))) > FOREIGN_COLUMNS:
            raise InputError(
                f"{path} has {widest:,} cells in a row, but may have at most {FOREIGN_COLUMNS:,}: "
                "export fewer columns"
            )
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
    raise InputError(
        f"{path} is in none of the formats that can be read: {known}; ROS 2 (a folder, .mcap or "
        ".db3): export it as one of these"
    )
