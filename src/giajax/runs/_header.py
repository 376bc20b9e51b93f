"""What people's files have above the line that names the columns, where nothing may be."""

import csv
import re
from collections.abc import Sequence
from pathlib import Path

from .._errors import InputError
from ._channels import parse_column
from ._units import QUANTITIES

# How far down a header is looked for: title, date, instrument, units.
_LINES = 30

_NUMERIC = re.compile(r"[+-]?([0-9]|\.[0-9]).*")
_UNITS = frozenset(
    spelling.lower()
    for quantity in QUANTITIES.values()
    for suffix, unit in quantity.suffixes.items()
    for spelling in (suffix, unit, quantity.si_unit, "1", "-", "sec", "degrees", "°")
)


def check_header(text: str, path: Path) -> None:
    """Refuse a CSV file whose first line does not name its columns because another line does.

    Arguments:
        text: of the file, with `\\n` at the ends of its lines.
        path: of the file, for the error.

    Raises:
        InputError: comments, units or a title stand above the header, or `#` before it.
    """
    lines = text.split("\n", _LINES)[:_LINES]
    comments = next((i for i, line in enumerate(lines) if not _comment(line)), len(lines))
    if comments:
        below = _cells(lines[comments]) if comments < len(lines) else []
        # As numpy writes it: the names are in the last comment, and numbers follow.
        if below and all(_NUMERIC.fullmatch(cell) or not cell for cell in below):
            above = "" if comments == 1 else " and what is above that line"
            raise InputError(
                f"{path}: line {comments} comes before the numbers and must name the columns, but "
                f"begins with '#': remove the '#'{above}"
            )
        which = "line 1 is a comment" if comments == 1 else f"lines 1 to {comments} are comments"
        raise InputError(
            f"{path}: {which}, but the first line must name the columns: "
            f"remove {'it' if comments == 1 else 'them'}"
        )
    first = _cells(lines[0])
    if not any(first) or _named(first):
        return
    named = next((i for i, line in enumerate(lines[1:], 1) if _named(_cells(line))), None)
    if named is not None:
        above = "the line" if named == 1 else f"the {named} lines"
        raise InputError(
            f"{path}: the columns are named in line {named + 1}, but must be named in the first "
            f"line: remove {above} above it"
        )
    if len(first) > 1 and all(cell.strip("[]() ").lower() in _UNITS for cell in first):
        raise InputError(
            f"{path}: the first line holds units, but must name the columns: remove it, and end "
            "the names in their units, such as link06_z_m"
        )


def _comment(line: str) -> bool:
    return line.lstrip(' "').startswith("#")


def _cells(line: str) -> list[str]:
    return [cell.strip() for cell in next(csv.reader([line]), [])]


def _named(cells: Sequence[str]) -> bool:
    """Whether all cells of a line are names of the column table."""
    try:
        return bool(cells) and all(parse_column(cell) for cell in cells)
    except InputError:
        return False
