"""The columns of a plan: keys of `[fit]`, those of its tables by their paths. Imports no JAX."""

from collections.abc import Mapping
from typing import Any

from .._errors import InputError
from .._text import shown
from ..kinds import flat
from ..runs import Fit

TABLES = ("start", "fix", "priors", "bounds", "ties", "groups")
"""Keys of `[fit]` that hold a value for each of some paths."""

# Where the result of one fit would go, and what is computed after a single one.
_NOT_HERE = ("out", "uncertainty")

RANGE = ("from", "to", "count", "log")
"""Keys of a range."""

DRAWS = {
    "uniform": "[low, high]",
    "log_uniform": "[low, high], both positive",
    "normal": "[mean, deviation]",
}
"""Distributions, and what each is of."""

# A table with one of these is a value, and no part of a path; the first is of a prior.
_OF_VALUES = {"value", *RANGE, *DRAWS}

Case = Mapping[str, Any]
"""Values by column: `loss`, `fix.links.mass`."""

MOST = 100_000
"""Fits of a plan."""


def columns_of(section: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Values by column: the keys of `[fit]`, those of its tables with their paths.

    Arguments:
        section: of a plan.
        where: what errors call it.

    Raises:
        InputError: a key that `[fit]` does not have, or that does nothing here.
    """
    known = [name for name in Fit.model_fields if name not in _NOT_HERE]
    columns = {}
    for name, value in section.items():
        if name not in known:
            if name == "uncertainty":
                raise InputError(f"{where}: {name} does nothing in a sweep: leave it out")
            raise InputError(
                f"{where}: unknown key {shown(name)}: give one of [fit], such as fix, start, loss "
                "or data"
            )
        if name not in TABLES:
            columns[name] = value
            continue
        if not isinstance(value, Mapping):
            raise InputError(f"{where}: {name} must be a table of parameter paths: write it as one")
        try:
            paths = flat(value, leaves=_OF_VALUES)
        except ValueError as error:
            raise InputError(f"{where}: {name} {error}") from None
        columns |= {f"{name}.{path}": item for path, item in paths.items()}
    return columns


def check_count(count: int, where: str) -> None:
    """Refuse more fits than a plan may have, before they are made."""
    if count > MOST:
        raise InputError(f"{where} has {count:,} fits, but may have {MOST:,} at most: plan fewer")
