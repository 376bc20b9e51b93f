"""The closed table of columns: which channels exist, in which units."""

import re
from typing import NamedTuple

from .._limits import LINKS
from ..kinds import KINDS, ChannelKind
from ._units import QUANTITIES, QUANTITY_OF_SUFFIX


def _gathered() -> dict[str, ChannelKind]:
    """The rows that the kinds of models declare, each once, after time."""
    table = {"time": ChannelKind("time", "time", "time", "input")}
    for row in (row for kind in KINDS.values() for row in kind.channels):
        first = table.setdefault(row.name, row)
        if (first.column, first.quantity, first.texts) != (row.column, row.quantity, row.texts):
            raise TypeError(f"two kinds of models declare the row {row.name!r} in different ways")
    return table


TABLE = _gathered()
_PATTERNS = {
    kind: re.compile(rf"(?P<name>{row.pattern})(?:_(?P<suffix>.+))?", re.DOTALL)
    for kind, row in TABLE.items()
}
# Columns are written in this order: the order of the table.
ROWS: tuple[str, ...] = tuple(TABLE)

TEXTS: dict[str, tuple[str, ...]] = {row.name: row.texts for row in TABLE.values() if row.texts}
NOISE_KEYS: dict[str, str] = {row.name: row.noise for row in TABLE.values() if row.noise}
"""Key of `[noise]` that holds for a row, beside its own column."""


class NameMatch(NamedTuple):
    """A row that a name begins with.

    Attributes:
        kind: the row.
        match: of its pattern; the group `name` is the channel.
        suffix: what follows the channel: its unit, or None.
    """

    kind: str
    match: re.Match[str]
    suffix: str | None


def match_name(name: str) -> NameMatch | None:
    """The row whose channel is the longest that a name begins with; None where none is."""
    matches = []
    for kind, pattern in _PATTERNS.items():
        match = pattern.fullmatch(name)
        if match is None:
            continue
        number = match.groupdict().get("index")
        if number is not None and not _is_number(number):
            continue
        matches.append(NameMatch(kind, match, match["suffix"]))
    return max(matches, key=lambda one: len(one.match["name"]), default=None)


def _is_number(digits: str) -> bool:
    """Whether these are how the number of a joint or link is written: link6 is not link06."""
    # So many digits first: Python refuses to convert thousands of them.
    short = len(digits) <= len(str(LINKS))
    return short and 0 < int(digits) <= LINKS and f"{int(digits):02d}" == digits


def units_of(kind: str) -> list[str]:
    """The units that a channel of a row may be recorded in."""
    quantity = TABLE[kind].quantity
    return list(QUANTITY_OF_SUFFIX if quantity is None else QUANTITIES[quantity].suffixes)
