"""A channel: one measured or commanded quantity of a run, and what a column name means."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ._column_complaints import bad_suffix, unknown_name
from ._column_table import ROWS, TABLE, NameMatch, match_name, units_of
from ._units import QUANTITIES, QUANTITY_OF_SUFFIX, from_si, to_si


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
        camera: that the name begins with, as `side` of `side.link06_u`, or None.
    """

    name: str
    kind: str
    index: int | None
    component: int | None
    quantity: str
    unit: str
    camera: str | None = None

    @classmethod
    def named(cls, name: str, unit: str | None = None) -> "Channel":
        """The channel of a name.

        Arguments:
            name: without a suffix.
            unit: a suffix of its quantity. By default that of the SI unit, kPa for a pressure,
                which the table has in no SI unit; `input` and `output` are then ratios.

        Raises:
            InputError: there is no such channel, or no such unit for it.
        """
        row = match_name(name)
        if row is None or row.suffix is not None:
            if row is not None and row.suffix in units_of(row.kind):
                raise InputError(
                    f"channel {name!r} ends in a unit, but values are in SI units here: "
                    f"call it {row.match['name']!r}"
                )
            raise InputError(unknown_name(name, "channel"))
        kind = row.kind
        if unit is None:
            units = units_of(kind)
            quantity = QUANTITIES[TABLE[kind].quantity or "ratio"]
            plain = [u for u in units if quantity.suffixes.get(u) == quantity.si_unit]
            unit = plain[0] if plain else units[0]
        if unit not in units_of(kind):
            raise InputError(bad_suffix(name, kind, unit, "channel"))
        return _channel(row, unit)

    @property
    def column(self) -> str:
        """The column's name in a file: `link06_z_m`."""
        return f"{self.name}_{self.unit}" if self.unit else self.name

    @property
    def si_unit(self) -> str:
        """The SI unit that values are held in: `m`, `rad`, `rad/s`, `N m`, ...; `` for none."""
        return QUANTITIES[self.quantity].si_unit

    def to_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """`values` as recorded (in `unit`, any shape), in SI."""
        return to_si(self.quantity, self.unit, values)

    def from_si(self, values: npt.ArrayLike) -> npt.NDArray[np.float64]:
        """`values` in SI (any shape), as recorded (in `unit`)."""
        return from_si(self.quantity, self.unit, values)


def parse_column(name: str) -> Channel:
    """What a column name means.

    The longest channel of the table that the name begins with is the channel; the rest is the
    unit.

    Raises:
        InputError: the name is not in the table; the nearest known name, or the units to choose
            from, are in the sentence.
    """
    row = match_name(name)
    if row is None:
        raise InputError(unknown_name(name, "column"))
    unit = row.suffix or ""
    if unit not in units_of(row.kind):
        raise InputError(bad_suffix(name, row.kind, row.suffix, "column"))
    return _channel(row, unit)


def parse_columns(names: Iterable[str]) -> dict[str, Channel]:
    """The channels of a file's header, by column name and in its order.

    Raises:
        InputError: an unknown column, or a channel that is there twice.
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


def order(channel: Channel) -> tuple[int, str, int, int]:
    """Sort key of the columns in a written file: kind, then camera, number and component."""
    row = ROWS.index(channel.kind)
    return (row, channel.camera or "", channel.index or 0, channel.component or 0)


def _channel(row: NameMatch, unit: str) -> Channel:
    groups = row.match.groupdict()
    number, component = groups.get("index"), groups.get("component")
    return Channel(
        name=row.match["name"],
        kind=row.kind,
        index=None if number is None else int(number),
        component=(None if component is None else TABLE[row.kind].components.index(component)),
        quantity=TABLE[row.kind].quantity or QUANTITY_OF_SUFFIX[unit],
        unit=unit,
        camera=groups.get("camera"),
    )
