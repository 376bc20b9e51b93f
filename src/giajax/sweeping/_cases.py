"""The cases of a plan: what differs between its fits. Imports no JAX."""

from collections.abc import Mapping
from typing import Any

from .._errors import InputError
from .._text import shown
from ._columns import Case, check_count, columns_of
from ._values import grid_cases, sample_cases


def cases_of(data: Mapping[str, Any], source: str) -> list[Case]:
    """Every combination of what list, sample and grid say.

    Arguments:
        data: of a plan, as plain data.
        source: what errors call it.

    Raises:
        InputError: what they may not say, or too many fits.
    """
    for name, kind in (("grid", dict), ("sample", dict), ("list", list)):
        if not isinstance(data.get(name, kind()), kind):
            what = "a list of tables, [[list]]" if kind is list else f"a table, [{name}]"
            raise InputError(f"{source}: {name} must be {what}: correct it")
    listed: list[Case] = [{}]
    if "list" in data:
        rows = data["list"]
        if not rows or not all(isinstance(row, Mapping) for row in rows):
            raise InputError(f"{source}: list must be a list of tables, [[list]]: correct it")
        listed = [_row(row, f"{source}, [[list]]") for row in rows]
    drawn: list[Case] = [{}]
    if "sample" in data:
        drawn = sample_cases(data["sample"], f"{source}, [sample]")
    combined = grid_cases(data.get("grid", {}), f"{source}, [grid]")
    for one, other in ((listed, drawn), (listed, combined), (drawn, combined)):
        twice = {name for case in one for name in case} & {name for case in other for name in case}
        if twice:
            raise InputError(
                f"{source} has {min(twice)} in two of grid, list and sample: leave it in one"
            )
    check_count(len(listed) * len(drawn) * len(combined), source)
    return [{**row, **draw, **case} for row in listed for draw in drawn for case in combined]


def _row(section: Mapping[str, Any], where: str) -> Case:
    """The values of one fit."""
    row = columns_of(section, where)
    for name, value in row.items():
        if isinstance(value, Mapping) and "value" not in value:
            raise InputError(
                f"{where}: {name} = {shown(value)} must be one value: put a range into [grid], and "
                "a distribution into [sample]"
            )
    return row
