"""Channels: the measured and commanded quantities of a run, and the meaning of column names."""

import difflib
import re
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from ..runtime.limits import LINKS
from ..runtime.text import InputError, one_of, shown
from ..schema import (
    KINDS,
    QUANTITIES,
    QUANTITY_OF_SUFFIX,
    ChannelKind,
    RecordedChannel,
    cached_by_kinds,
    si_factor,
)


def to_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Convert `values` of any shape from the unit of `suffix` to SI, as float64."""
    with np.errstate(over="ignore"):  # infinite values are refused later
        return np.asarray(np.asarray(values, dtype=np.float64) * si_factor(quantity, suffix))


def from_si(quantity: str, suffix: str, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
    """Convert `values` of any shape from SI to the unit of `suffix`, as float64."""
    return np.asarray(np.asarray(values, dtype=np.float64) / si_factor(quantity, suffix))


@dataclass(frozen=True)
class Naming:
    """How error messages name rows and columns: `row 5` of a file, `sample 5` of arrays."""

    source: str
    row: str
    first_row: int
    columns: bool

    def at(self, index: Any) -> str:
        """Return the name of the row of the sample with this index."""
        return f"{self.row} {int(index) + self.first_row}"

    def of(self, channel: RecordedChannel) -> str:
        """Return the name of the channel in the user's file or arrays."""
        if not self.columns:
            return f"channel {channel.name!r}"
        column = f"{channel.name}_{channel.unit}" if channel.unit else channel.name
        return f"column {column!r}"


@cached_by_kinds
def column_table() -> dict[str, ChannelKind]:
    """Return the rows that the kinds of models declare, each once, after time.

    Columns are written in this order.
    """
    rows = {"time": ChannelKind("time", "time", "time", "input")}
    for row in (row for kind in KINDS.values() for row in kind.channels):
        rows.setdefault(row.name, row)
    return rows


@cached_by_kinds
def _patterns() -> dict[str, re.Pattern[str]]:
    return {
        kind: re.compile(rf"(?P<name>{row.pattern})(?:_(?P<suffix>.+))?", re.DOTALL)
        for kind, row in column_table().items()
    }


class NameMatch(NamedTuple):
    """A table row that matches a name, its match (group `name`: channel) and the unit, if any."""

    kind: str
    match: re.Match[str]
    suffix: str | None


def match_name(name: str) -> NameMatch | None:
    """Return the row with the longest channel at the start of a name; None if no row matches."""
    found = ((kind, pattern.fullmatch(name)) for kind, pattern in _patterns().items())
    matches = [
        NameMatch(kind, match, match["suffix"])
        for kind, match in found
        if match and ((number := match.groupdict().get("index")) is None or _is_number(number))
    ]
    return max(matches, key=lambda one: len(one.match["name"]), default=None)


def _is_number(digits: str) -> bool:
    """Return whether digits are a number of a joint or link as written: link6 is not link06."""
    # The length is checked first, because Python refuses to convert thousands of digits.
    short = len(digits) <= len(str(LINKS))
    return short and 0 < int(digits) <= LINKS and f"{int(digits):02d}" == digits


def units_of(kind: str) -> list[str]:
    """Return the units in which a channel of a row may be recorded."""
    quantity = column_table()[kind].quantity
    return list(QUANTITY_OF_SUFFIX if quantity is None else QUANTITIES[quantity].suffixes)


_ARTICLE = {"angle": "an", "angular_velocity": "an"}


def bad_suffix(name: str, kind: str, suffix: str | None, what: str) -> str:
    """Describe what is wrong with the unit of a column or channel (`what`), and the remedy."""
    row, units = column_table()[kind], units_of(kind)
    quantity = row.quantity
    if suffix in ("percent", "pct", "%"):
        return (
            f"{what} {shown(name)} is in percent, but {row.column} must be a ratio: divide the "
            f"values by 100 and rename the column to {row.column}"
        )
    if units == [""]:
        return (
            f"{what} {shown(name)} ends in {shown(suffix)}, but {row.column} has no unit: "
            f"rename it with --rename {name}={row.column}"
        )
    of = "it" if quantity is None else f"{_ARTICLE.get(quantity, 'a')} {quantity.replace('_', ' ')}"
    units = [unit for unit in units if unit]
    if suffix is None:
        complaint = f"{what} {shown(name)} does not give its unit"
        remedy = f"rename it, for example with --rename {name}={name}_{units[0]}"
    else:
        complaint = f"{what} {shown(name)} has the unknown unit {shown(suffix)}"
        remedy = "convert the values and rename the column"
    return f"{complaint}: {of} must be in {one_of(units)}, so {remedy}"


def _listed(columns: Iterable[str]) -> Iterator[str]:
    """Yield names of columns, combined for each part of the arm: `jointNN_angle, _rate`."""
    before = ""
    for column in columns:
        part, _, rest = column.partition("_")
        yield f"_{rest}" if rest and part == before else column
        before = part


def unknown_name(name: str, what: str) -> str:
    """Describe the remedy for a column or channel (`what`) that is not in the table."""
    numbered = re.match("(joint|link)([0-9]{3,})", name)
    if numbered is not None and (len(numbered[2]) > len(str(LINKS)) or int(numbered[2]) > LINKS):
        return (
            f"{what} {shown(name)} refers to a {numbered[1]} with a number above {LINKS:,}, the "
            "highest number allowed: correct the number"
        )
    near = nearest(name, suffixes=what == "column")
    old = "OLD" if not 0 < len(name) <= 40 or not name.isprintable() else name
    pair = shlex.quote(f"{old}={near or 'NEW'}")
    rename = f"--rename {pair}"
    if near is not None:
        complaint = f"{what} {shown(name)} is not in the column table: did you mean {near!r}"
        return f"{complaint} ({rename})?" if what == "column" else f"{complaint}?"
    known = ", ".join(_listed(row.column for row in column_table().values()))
    remedy = f"rename it with {rename}, or remove it" if what == "column" else "correct the name"
    return f"{what} {shown(name)} is not in the column table ({known}): {remedy}"


def nearest(name: str, *, suffixes: bool = True) -> str | None:
    """Return the column (without `suffixes`: the channel) with the most similar name, or None."""
    numbers = re.findall(r"[0-9]+", name)
    number = f"{int(numbers[0]) or 1:02d}" if numbers and len(numbers[0]) < 5 else "01"
    candidates = []
    for kind, row in column_table().items():
        plain = row.column.replace("NN", number)
        for channel in [plain[:-1] + c for c in row.components] or [plain]:
            candidates += [
                f"{channel}_{unit}" if unit and suffixes else channel for unit in units_of(kind)
            ]
    near = difflib.get_close_matches(name.lower(), candidates, n=1, cutoff=0.7)
    return near[0] if near else None


@dataclass(frozen=True)
class Channel:
    """One measured or commanded quantity of a run.

    Attributes:
        name: `link06_z`, `joint01_command`, `tip_x`, `time`, ...
        kind: the row of the column table: `link_position`, `joint_command`, ...
        index: 1-based number of the joint, link or landmark, or None.
        component: 0, 1, 2 for x, y, z; 0, 1 for u, v; or None.
        quantity: `length`, `pixel`, `angle`, `angular_velocity`, `velocity`, `force`, `torque`,
            `pressure`, `time`, `ratio` or `text`.
        unit: the suffix as recorded, `m`, `cm`, `deg`, ...; empty for a ratio or text.
        camera: camera at the start of the name, such as `side` in `side.link06_u`, or None.
    """

    name: str
    kind: str
    index: int | None
    component: int | None
    quantity: str
    unit: str
    camera: str | None = None

    @classmethod
    @cached_by_kinds  # A model looks up its channels while it is traced: parse each name once.
    def named(cls, name: str, unit: str | None = None) -> "Channel":
        """Return the channel with a given name.

        Arguments:
            name: name without the suffix of the unit.
            unit: suffix of a unit of the quantity. The default is the SI unit or, for a pressure,
                which has no SI unit in the table, kPa; `input` and `output` are then ratios.

        Raises:
            InputError: there is no such channel, or it cannot have this unit.
        """
        row = match_name(name)
        if row is None or row.suffix is not None:
            if row is not None and row.suffix in units_of(row.kind):
                raise InputError(
                    f"channel {name!r} ends in a unit, but arrays are in SI units: rename it to"
                    f" {row.match['name']!r}"
                )
            raise InputError(unknown_name(name, "channel"))
        kind = row.kind
        if unit is None:
            units = units_of(kind)
            quantity = QUANTITIES[column_table()[kind].quantity or "ratio"]
            plain = [u for u in units if quantity.suffixes.get(u) == quantity.si_unit]
            unit = plain[0] if plain else units[0]
        if unit not in units_of(kind):
            raise InputError(bad_suffix(name, kind, unit, "channel"))
        return _channel(row, unit)

    @property
    def column(self) -> str:
        """Name of the column in a file: `link06_z_m`."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def si_unit(self) -> str:
        """SI unit of the values: `m`, `rad`, `rad/s`, `N m`, ...; empty if they have none."""
        return QUANTITIES[self.quantity].si_unit

    def to_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Convert `values` of any shape from the recorded `unit` to SI."""
        return to_si(self.quantity, self.unit, values)

    def from_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """Convert `values` of any shape from SI to the recorded `unit`."""
        return from_si(self.quantity, self.unit, values)


@cached_by_kinds
def parse_column(name: str) -> Channel:
    """Return the channel of a column: the longest channel that its name starts with, and the unit.

    Raises:
        InputError: the name is not in the table; the message gives the nearest known name, or the
            possible units.
    """
    row = match_name(name)
    if row is None:
        raise InputError(unknown_name(name, "column"))
    unit = row.suffix or ""
    if unit not in units_of(row.kind):
        raise InputError(bad_suffix(name, row.kind, row.suffix, "column"))
    return _channel(row, unit)


def channel_of(name: str) -> str:
    """Return the name of the channel of a column, or "" for a name that is not in the table."""
    row = match_name(name)
    known = row is not None and (row.suffix or "") in units_of(row.kind)
    return row.match["name"] if row is not None and known else ""


def parse_columns(names: Iterable[str]) -> dict[str, Channel]:
    """Return the channels of the header of a file, by column name and in the order of the file.

    Raises:
        InputError: a column is unknown, or a channel occurs twice.
    """
    channels: dict[str, Channel] = {}
    first: dict[str, str] = {}
    for column in names:
        channel = parse_column(column)
        if column in channels:
            raise InputError(
                f"column {column!r} is given twice, but must be given once: remove one"
            )
        if channel.name in first:
            raise InputError(
                f"columns {first[channel.name]!r} and {column!r} both give {channel.name}, "
                "which must be given only once: remove one"
            )
        first[channel.name] = column
        channels[column] = channel
    return channels


def order(channel: Channel) -> tuple[int, str, int, int]:
    """Return the sort key of a column in a written file: kind, camera, number and component."""
    row = list(column_table()).index(channel.kind)
    return (row, channel.camera or "", channel.index or 0, channel.component or 0)


def _channel(row: NameMatch, unit: str) -> Channel:
    groups = row.match.groupdict()
    number, component = groups.get("index"), groups.get("component")
    of = column_table()[row.kind]
    return Channel(
        row.match["name"],
        row.kind,
        index=None if number is None else int(number),
        component=None if component is None else of.components.index(component),
        quantity=of.quantity or QUANTITY_OF_SUFFIX[unit],
        unit=unit,
        camera=groups.get("camera"),
    )


def infer_model(channels: Iterable[Channel]) -> str | None:
    """Return the kind of model that the channels alone determine, or None."""
    rows = frozenset(channel.kind for channel in channels)
    return next((kind.name for kind in KINDS.values() if kind.recognises(rows)), None)


def decide_model(channels: Iterable[Channel], sidecar: str | None, source: str) -> str:
    """Return the kind of model of a run: from its sidecar or, without one, from its channels.

    Raises:
        InputError: neither gives the kind, or a channel belongs to another kind.
    """
    channels = list(channels)
    inferred = infer_model(channels)
    model = sidecar or inferred
    if model is None:
        names = ", ".join(channel.name for channel in channels)
        raise InputError(
            f"{source}: the channels {names} do not determine the model of the run: set it in the "
            f'sidecar as model = "..." ({one_of(KINDS)})'
        )
    rows = {"time", *(row.name for row in KINDS[model].channels)}
    for channel in channels:
        if channel.kind in rows:
            continue
        if sidecar is not None and inferred not in (None, sidecar):
            raise InputError(
                f"{source}: the sidecar sets model = {sidecar!r}, but column {channel.column!r} "
                f"belongs to the model {inferred!r}: correct the sidecar or remove the column"
            )
        raise InputError(
            f"{source}: column {channel.column!r} does not belong to the model {model!r} of this "
            "run: remove or rename it, or set another model in the sidecar"
        )
    return model
