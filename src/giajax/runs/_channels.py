"""The closed table of columns: which channels exist, and what a column name means."""

import difflib
import re
import shlex
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._text import one_of, shown
from ..kinds import KINDS, ChannelKind
from ._units import QUANTITIES, QUANTITY_OF_SUFFIX, from_si, to_si


def _gathered() -> dict[str, ChannelKind]:
    """The rows that the kinds of models declare, each once, after time."""
    table = {"time": ChannelKind("time", "time", "time", "input")}
    for row in (row for kind in KINDS.values() for row in kind.channels):
        first = table.setdefault(row.name, row)
        if (first.column, first.quantity, first.texts) != (row.column, row.quantity, row.texts):
            raise TypeError(f"two kinds of models declare the row {row.name!r} in different ways")
    return table


_TABLE = _gathered()
_PATTERNS = {
    kind: re.compile(rf"(?P<name>{row.pattern})(?:_(?P<suffix>.+))?", re.DOTALL)
    for kind, row in _TABLE.items()
}
# Columns are written in this order: the order of the table.
ROWS: tuple[str, ...] = tuple(_TABLE)

_ARTICLE = {"angle": "an", "angular_velocity": "an"}

TEXTS: dict[str, tuple[str, ...]] = {row.name: row.texts for row in _TABLE.values() if row.texts}
NOISE_KEYS: dict[str, str] = {row.name: row.noise for row in _TABLE.values() if row.noise}
"""Key of `[noise]` that holds for a row, beside its own column."""


@dataclass(frozen=True)
class Channel:
    """One measured or commanded quantity of a run.

    - `name`: `link06_z`, `joint01_command`, `tip_x`, `time`, ...
    - `kind`: the row of the column table: `link_position`, `joint_command`, ...
    - `index`: 1-based number of the joint or link, or None.
    - `component`: 0, 1, 2 for x, y, z, or None.
    - `quantity`: `length`, `angle`, `angular_velocity`, `velocity`, `force`, `torque`,
      `pressure`, `time`, `ratio` or `text`.
    - `unit`: the suffix as recorded, `m`, `cm`, `deg`, ...; empty for a ratio or text.
    """

    name: str
    kind: str
    index: int | None
    component: int | None
    quantity: str
    unit: str

    @classmethod
    def named(cls, name: str, unit: str | None = None) -> "Channel":
        """The channel called `name` (no suffix), in `unit` or, by default, in its SI unit.

        A pressure, which the table has in no SI unit, is in kPa by default. Without a unit
        `input` and `output` are ratios. Raises `InputError` if there is no such channel, or
        no such unit for it.
        """
        found = _match(name)
        if found is None or found[2] is not None:
            if found is not None and found[2] in _units_of(found[0]):
                raise InputError(
                    f"channel {name!r} ends in a unit, but values are in SI units here: "
                    f"call it {found[1]['name']!r}"
                )
            raise InputError(_unknown(name, "channel"))
        kind, match, _ = found
        if unit is None:
            units = _units_of(kind)
            quantity = _TABLE[kind].quantity or "ratio"
            plain = [u for u in units if QUANTITIES[quantity].suffixes.get(u) == _si(quantity)]
            unit = plain[0] if plain else units[0]
        if unit not in _units_of(kind):
            raise InputError(_bad_suffix(name, kind, unit, "channel"))
        return _channel(kind, match, unit)

    @property
    def column(self) -> str:
        """The column's name in a file: `link06_z_m`."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def si_unit(self) -> str:
        """The SI unit that values are held in: `m`, `rad`, `rad/s`, `N m`, ...; `` for none."""
        return _si(self.quantity)

    def to_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """`values` as recorded (in `unit`, any shape), in SI."""
        return to_si(self.quantity, self.unit, values)

    def from_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """`values` in SI (any shape), as recorded (in `unit`)."""
        return from_si(self.quantity, self.unit, values)


def parse_column(name: str) -> Channel:
    """What a column name means.

    The longest channel of the table that the name begins with is the channel; the rest is the
    unit. Raises `InputError`, with the nearest known name or the units to choose from, if the
    name is not in the table.
    """
    found = _match(name)
    if found is None:
        raise InputError(_unknown(name, "column"))
    kind, match, suffix = found
    if (suffix or "") not in _units_of(kind):
        raise InputError(_bad_suffix(name, kind, suffix, "column"))
    return _channel(kind, match, suffix or "")


def parse_columns(names: Iterable[str]) -> dict[str, Channel]:
    """The channels of a file's header, by column name and in its order.

    Raises `InputError` for an unknown column and for a channel that is given twice.
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
                "which must be there once: remove one"
            )
        first[channel.name] = column
        channels[column] = channel
    return channels


def order(channel: Channel) -> tuple[int, int, int]:
    """Sort key of the columns in a written file: kind, then number, then component."""
    return (ROWS.index(channel.kind), channel.index or 0, channel.component or 0)


def _si(quantity: str) -> str:
    return QUANTITIES[quantity].si_unit


def _match(name: str) -> tuple[str, re.Match[str], str | None] | None:
    matches = []
    for kind, pattern in _PATTERNS.items():
        match = pattern.fullmatch(name)
        if match is None:
            continue
        number = match.groupdict().get("index")
        # link6 and link006 would be two more names of link06.
        if number is not None and (int(number) == 0 or f"{int(number):02d}" != number):
            continue
        matches.append((kind, match, match["suffix"]))
    return max(matches, key=lambda found: len(found[1]["name"]), default=None)


def _channel(kind: str, match: re.Match[str], unit: str) -> Channel:
    groups = match.groupdict()
    number, component = groups.get("index"), groups.get("component")
    return Channel(
        name=match["name"],
        kind=kind,
        index=None if number is None else int(number),
        component=None if component is None else "xyz".index(component),
        quantity=_TABLE[kind].quantity or QUANTITY_OF_SUFFIX[unit],
        unit=unit,
    )


def _units_of(kind: str) -> list[str]:
    quantity = _TABLE[kind].quantity
    return list(QUANTITY_OF_SUFFIX if quantity is None else QUANTITIES[quantity].suffixes)


def _bad_suffix(name: str, kind: str, suffix: str | None, what: str) -> str:
    quantity = _TABLE[kind].quantity
    units = _units_of(kind)
    if units == [""]:
        return (
            f"{what} {shown(name)} ends in {suffix!r}, but {_TABLE[kind].column} has no unit: "
            f"rename it with --rename {name}={_TABLE[kind].column}"
        )
    of = "it" if quantity is None else f"{_ARTICLE.get(quantity, 'a')} {quantity.replace('_', ' ')}"
    units = [unit for unit in units if unit]
    if suffix is None:
        given = f"{what} {shown(name)} does not say its unit"
        remedy = f"rename it, for example with --rename {name}={name}_{units[0]}"
    else:
        given = f"{what} {shown(name)} has the unknown unit {suffix!r}"
        remedy = "convert the values and rename the column"
    return f"{given}: {of} must be in {one_of(units)}, so {remedy}"


def _unknown(name: str, what: str) -> str:
    near = nearest(name, suffixes=what == "column")
    old = "OLD" if not 0 < len(name) <= 40 or not name.isprintable() else name
    pair = shlex.quote(f"{old}={near or 'NEW'}")
    rename = f"--rename {pair}"
    if near is not None:
        given = f"{what} {shown(name)} is not in the column table: did you mean {near!r}"
        return f"{given} ({rename})?" if what == "column" else f"{given}?"
    known = ", ".join(row.column for row in _TABLE.values())
    remedy = f"rename it with {rename}, or remove it" if what == "column" else "correct the name"
    return f"{what} {shown(name)} is not in the column table ({known}): {remedy}"


def nearest(name: str, *, suffixes: bool = True) -> str | None:
    """The column (without `suffixes`: the channel) whose name is most like `name`, or None."""
    numbers = re.findall(r"[0-9]+", name)
    number = f"{int(numbers[0]) or 1:02d}" if numbers and len(numbers[0]) < 5 else "01"
    candidates = []
    for kind, row in _TABLE.items():
        plain = row.column.replace("NN", number)
        for channel in [plain[:-1] + c for c in "xyz"] if "_x" in plain else [plain]:
            candidates += [
                f"{channel}_{unit}" if unit and suffixes else channel for unit in _units_of(kind)
            ]
    near = difflib.get_close_matches(name.lower(), candidates, n=1, cutoff=0.7)
    return near[0] if near else None
