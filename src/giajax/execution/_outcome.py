"""What came of a task, and the file that keeps it: one for each that is done, by who did it."""

import dataclasses
import json
import math
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any, Literal

from .._files import keep, read_bytes
from .._limits import RESULT_BYTES

_FORMAT = 1


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What came of a task.

    Attributes:
        key: of the task.
        status: "done"; "failed", with a sentence; or "stopped" where Ctrl-C came before it was
            done, so that it is to be run again.
        value: what the function returned, as plain data: arrays are lists, what is not finite is
            None. None unless it is done.
        message: why it failed; empty where it did not.
        seconds: that it took, s.
        worker: machine and process that did it; empty where none did.
    """

    key: str
    status: Literal["done", "failed", "stopped"]
    value: Any = None
    message: str = ""
    seconds: float = 0.0
    worker: str = ""


def write_outcome(folder: Path, outcome: Outcome) -> None:
    """Write `KEY.json` into a folder, made where it is missing; it is whole or not there.

    Raises:
        InputError: it cannot be written.
    """
    record = {"giajax_task": _FORMAT, **dataclasses.asdict(outcome)}
    text = json.dumps(record, allow_nan=False)
    keep(outcome_path(folder, outcome.key), text.encode() + b"\n")


def read_outcome(folder: str | Path, key: str) -> Outcome | None:
    """What is kept of a task that is done.

    None where it has no file, or one that is not whole or another's.

    Arguments:
        folder: of the files.
        key: of the task.
    """
    try:
        record = json.loads(read_bytes(outcome_path(Path(folder), key), RESULT_BYTES))
        if record.pop("giajax_task") != _FORMAT:
            return None
        outcome = Outcome(**record)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return outcome if outcome.key == key and outcome.status == "done" else None


def outcome_path(folder: Path, key: str) -> Path:
    """The file of a task."""
    return folder / f"{key}.json"


def plain(value: Any) -> Any:
    """A value as JSON gives it back.

    Raises:
        TypeError: there is no form of it in JSON.
    """
    if isinstance(value, bool | int | str | None):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: plain(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy and JAX
        return plain(value.tolist())
    raise TypeError(f"a task returned {type(value).__qualname__}, which JSON has no form for")
