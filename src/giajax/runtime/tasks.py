"""Tasks: calls of functions, identified by a key of their content, with files for the outcomes."""

import dataclasses
import functools
import hashlib
import importlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path, PurePath
from typing import Any, Literal

from .files import keep, read_bytes
from .identities import FORMAT, arguments_of, identity
from .limits import RESULT_BYTES
from .records import parse_record
from .text import InputError


@dataclasses.dataclass(frozen=True)
class Task:
    """One of many calls, which any worker can perform.

    Attributes:
        function: function at the top level of a module that workers can import, or its name as
            "module:function". Its return value is stored as JSON (`Outcome.value`).
        arguments: arguments by name: plain data, arrays, Equinox modules, or any object that can be
            pickled. An object with a text `task_key` is identified by this key.
        seed: seed of the whole study, for a function that draws random numbers; it is called with
            `seed=task.own_seed` in addition to its arguments. None for other functions.
        aside: further arguments that do not affect the key, such as the location of a file whose
            checksum is an argument.

    Example:
        >>> from giajax.runtime.tasks import Task
        >>> Task("math:hypot", {}).key == Task("math:hypot", {}).key
        True
    """

    function: str | Callable[..., Any]
    arguments: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    seed: int | None = None
    aside: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        name = self.function
        if not isinstance(name, str):
            name = f"{name.__module__}:{name.__qualname__}"
        if "<" in name or name.count(":") != 1:
            raise InputError(
                f"other processes cannot find the function {name} of a task: give a function "
                'at the top level of a module, or its name as "module:function"'
            )
        object.__setattr__(self, "function", name)

    @functools.cached_property
    def key(self) -> str:
        """SHA-256 of the function, the arguments and the seed, in hexadecimal digits.

        Arrays and modules are identified by their content. The key depends neither on the location
        of giajax code (`giajax.runtime.identities`) nor on the version of giajax.

        Raises:
            InputError: an argument has no description that is the same in every process.
        """
        place = str(self.function)
        content = {
            "function": identity(place),
            "arguments": arguments_of(place, self.arguments),
            "seed": self.seed,
            "giajax": FORMAT,
        }
        text = json.dumps(content, sort_keys=True, separators=(",", ":"), default=_described)
        return hashlib.sha256(text.encode()).hexdigest()

    @property
    def own_seed(self) -> int:
        """Seed of this task, below 2^63, from the seed of the study and the key, on any worker."""
        import numpy as np

        words = [int(self.key[at : at + 8], 16) for at in range(0, len(self.key), 8)]
        state = np.random.SeedSequence([self.seed or 0, *words]).generate_state(1, np.uint64)
        return int(state[0]) >> 1

    def call(self) -> Any:
        """Call the function and return its result."""
        module, _, name = str(self.function).partition(":")
        function: Any = importlib.import_module(module)
        for part in name.split("."):
            function = getattr(function, part)
        own = {} if self.seed is None else {"seed": self.own_seed}
        return function(**self.arguments, **self.aside, **own)


def _described(value: Any) -> Any:
    """Return a text that identifies an object without a JSON form."""
    if isinstance(value, PurePath):
        return str(value)
    if isinstance(value, Mapping):
        return dict(value)
    kind = type(value)
    name = identity(f"{kind.__module__}:{kind.__qualname__}").partition(":")[2]
    if isinstance(key := getattr(value, "task_key", None), str):
        return f"{name} {key}"
    from .programs import NoStructureError, content

    try:
        digits = hashlib.sha256(content(value).encode()).hexdigest()
    except (NoStructureError, RecursionError) as error:
        raise InputError(
            f"an argument of a task cannot be described as text ({error}): give plain data, "
            "arrays or dataclasses, or define `task_key` in its class"
        ) from None
    return f"{name} {digits}"


_HEAD = {"giajax_task": 1}


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Outcome of a task.

    Attributes:
        key: key of the task.
        status: "done"; "failed", with a sentence; or "stopped" if Ctrl-C was pressed before the
            task was completed, so it must be repeated.
        value: return value of the function as plain data: arrays are lists, values that are not
            finite are None. None unless the task is done.
        message: reason of a failure, otherwise empty.
        seconds: duration, s.
        worker: machine and process that performed the task; empty if it was not performed.
    """

    key: str
    status: Literal["done", "failed", "stopped"]
    value: Any = None
    message: str = ""
    seconds: float = 0.0
    worker: str = ""


def write_outcome(folder: Path, outcome: Outcome) -> None:
    """Write `KEY.json` atomically into a folder, which is created if it is missing.

    Raises:
        InputError: it cannot be written.
    """
    text = json.dumps({**_HEAD, **dataclasses.asdict(outcome)}, allow_nan=False)
    keep(outcome_path(folder, outcome.key), text.encode() + b"\n")


def read_outcome(folder: str | Path, key: str) -> Outcome | None:
    """Return the stored outcome of a completed task; None if its file is missing or damaged."""
    try:
        text = read_bytes(outcome_path(Path(folder), key), RESULT_BYTES)
        outcome = parse_record(
            Outcome, text, _HEAD, "this is not the outcome of a task", "run the task again"
        )
    except (OSError, InputError):
        return None
    return outcome if outcome.key == key and outcome.status == "done" else None


def outcome_path(folder: Path, key: str) -> Path:
    """Return the path of the file of a task."""
    return folder / f"{key}.json"
