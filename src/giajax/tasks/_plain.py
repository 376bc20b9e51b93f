"""A task as plain data."""

import json
from typing import TYPE_CHECKING, Any

from ._record import checksums_of

if TYPE_CHECKING:
    from ._fit_task import FitTask


def record_of(task: "FitTask") -> dict[str, Any]:
    """A task as plain data, with the checksums of its files.

    Raises:
        InputError: a file cannot be read.
    """
    inputs = checksums_of((*task.data, *task.validation), task.source)
    return {**plain_of(task), "inputs": inputs}


def plain_of(task: "FitTask") -> dict[str, Any]:
    """A task as plain data; nothing is read."""
    return {
        "data": [str(path) for path in task.data],
        "validation": [str(path) for path in task.validation],
        "rename": dict(task.rename),
        "source": None if task.source is None else str(task.source),
        "out": str(task.out),
        "definition": json.loads(json.dumps(task.definition.contents())),
        "begin": None if task.begin is None else dict(task.begin),
    }
