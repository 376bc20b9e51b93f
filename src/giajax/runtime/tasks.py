"""A task: a call of a function, known by a key of its content, with a file for its outcome."""

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
    """One of many calls, which any worker can make.

    Attributes:
        function: at the top of a module that workers can import: itself, or its name as
            "module:function". What it returns is written as JSON (`Outcome.value`).
        arguments: by name: plain data, arrays, modules of Equinox, or whatever can be pickled.
            What has a text `task_key` counts by that.
        seed: of the whole study, for a function that draws random numbers: it is called with
            `seed=task.own_seed` beside its arguments. None for one that draws none.
        aside: further arguments, which do not count for the key: where a file lies that an argument
            has the checksum of.

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
                'at the top of a module, or its name as "module:function"'
            )
        object.__setattr__(self, "function", name)

    @functools.cached_property
    def key(self) -> str:
        """SHA-256 of function, arguments and seed, in hexadecimal digits.

        Arrays and modules count by their content. Where code of giajax lies does not count
        (`giajax.runtime.identities`), nor does its version.

        Raises:
            InputError: an argument that nothing describes in every process alike.
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
        """Seed of this task, below 2^63: by the study's seed and the key, wherever it runs."""
        import numpy as np

        words = [int(self.key[at : at + 8], 16) for at in range(0, len(self.key), 8)]
        state = np.random.SeedSequence([self.seed or 0, *words]).generate_state(1, np.uint64)
        return int(state[0]) >> 1

    def call(self) -> Any:
        """What the function returns."""
        module, _, name = str(self.function).partition(":")
        function: Any = importlib.import_module(module)
        for part in name.split("."):
            function = getattr(function, part)
        own = {} if self.seed is None else {"seed": self.own_seed}
        return function(**self.arguments, **self.aside, **own)


def _described(value: Any) -> Any:
    """Of what JSON has no form for: a text that says what it is."""
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
    text = json.dumps({**_HEAD, **dataclasses.asdict(outcome)}, allow_nan=False)
    keep(outcome_path(folder, outcome.key), text.encode() + b"\n")


def read_outcome(folder: str | Path, key: str) -> Outcome | None:
    """What is kept of a task that is done; None if its file is missing, damaged or of another."""
    try:
        text = read_bytes(outcome_path(Path(folder), key), RESULT_BYTES)
        outcome = parse_record(
            Outcome, text, _HEAD, "this is not an outcome of a task", "run the task again"
        )
    except (OSError, InputError):
        return None
    return outcome if outcome.key == key and outcome.status == "done" else None


def outcome_path(folder: Path, key: str) -> Path:
    """The file of a task."""
    return folder / f"{key}.json"
