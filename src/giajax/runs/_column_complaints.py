"""What is wrong with the name of a column, and which name it may have."""

import difflib
import re
import shlex
from collections.abc import Iterable, Iterator

from .._limits import LINKS
from .._text import one_of, shown
from ._column_table import TABLE, units_of

_ARTICLE = {"angle": "an", "angular_velocity": "an"}


def bad_suffix(name: str, kind: str, suffix: str | None, what: str) -> str:
    """What is wrong with the unit of a column or channel (`what`) of a row, and what to do."""
    quantity = TABLE[kind].quantity
    units = units_of(kind)
    if units == [""]:
        return (
            f"{what} {shown(name)} ends in {shown(suffix)}, but {TABLE[kind].column} has no unit: "
            f"rename it with --rename {name}={TABLE[kind].column}"
        )
    of = "it" if quantity is None else f"{_ARTICLE.get(quantity, 'a')} {quantity.replace('_', ' ')}"
    units = [unit for unit in units if unit]
    if suffix is None:
        complaint = f"{what} {shown(name)} does not say its unit"
        remedy = f"rename it, for example with --rename {name}={name}_{units[0]}"
    else:
        complaint = f"{what} {shown(name)} has the unknown unit {shown(suffix)}"
        remedy = "convert the values and rename the column"
    return f"{complaint}: {of} must be in {one_of(units)}, so {remedy}"


def _listed(columns: Iterable[str]) -> Iterator[str]:
    """Columns, of which those of one part of the arm share its name: `jointNN_angle, _rate`."""
    before = ""
    for column in columns:
        part, _, rest = column.partition("_")
        yield f"_{rest}" if rest and part == before else column
        before = part


def unknown_name(name: str, what: str) -> str:
    """What to do with a column or channel (`what`) that the table does not have."""
    numbered = re.match("(joint|link)([0-9]{3,})", name)
    if numbered is not None and (len(numbered[2]) > len(str(LINKS)) or int(numbered[2]) > LINKS):
        return (
            f"{what} {shown(name)} has the number of a {numbered[1]} beyond {LINKS:,}, the most "
            "that an arm may have: correct the number"
        )
    near = nearest(name, suffixes=what == "column")
    old = "OLD" if not 0 < len(name) <= 40 or not name.isprintable() else name
    pair = shlex.quote(f"{old}={near or 'NEW'}")
    rename = f"--rename {pair}"
    if near is not None:
        complaint = f"{what} {shown(name)} is not in the column table: did you mean {near!r}"
        return f"{complaint} ({rename})?" if what == "column" else f"{complaint}?"
    known = ", ".join(_listed(row.column for row in TABLE.values()))
    remedy = f"rename it with {rename}, or remove it" if what == "column" else "correct the name"
    return f"{what} {shown(name)} is not in the column table ({known}): {remedy}"


def nearest(name: str, *, suffixes: bool = True) -> str | None:
    """The column (without `suffixes`: the channel) whose name is most like `name`, or None."""
    numbers = re.findall(r"[0-9]+", name)
    number = f"{int(numbers[0]) or 1:02d}" if numbers and len(numbers[0]) < 5 else "01"
    candidates = []
    for kind, row in TABLE.items():
        plain = row.column.replace("NN", number)
        for channel in [plain[:-1] + c for c in row.components] or [plain]:
            candidates += [
                f"{channel}_{unit}" if unit and suffixes else channel for unit in units_of(kind)
            ]
    near = difflib.get_close_matches(name.lower(), candidates, n=1, cutoff=0.7)
    return near[0] if near else None
