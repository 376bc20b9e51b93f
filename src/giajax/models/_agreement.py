"""Whether the sidecars of runs that are fitted together state the same."""

from collections.abc import Mapping
from typing import Any

from .._errors import InputError
from ..runs import Run


def check_agreement(
    section: str, first: tuple[Run, Mapping[str, Any]], other: tuple[Run, Mapping[str, Any]]
) -> None:
    """Refuse two runs whose sidecars state a key of a section differently.

    Arguments:
        section: its name.
        first: a run, and what it states in the section, by key; None where it states nothing.
        other: another one.

    Raises:
        InputError: naming the runs, the key and both values.
    """
    (one, ours), (two, theirs) = first, other
    for key in {**ours, **theirs}:
        if ours.get(key) != theirs.get(key):
            both = " and ".join(
                "nothing" if values.get(key) is None else str(values[key])
                for values in (ours, theirs)
            )
            raise InputError(
                f"the sidecars of '{one.name}' and '{two.name}' disagree in [{section}] "
                f"{key} ({both}): correct one, or fit the runs separately"
            )
