"""Plain data to TOML text: what `tomllib` reads back."""

import json
import math
import re
from typing import Any

from .._errors import InputError

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(data: dict[str, Any]) -> str:
    """TOML text of nested dicts of strings, numbers, booleans and lists; None is left out.

    Deterministic: the order of the dicts is kept, plain values come before tables.

    Raises:
        InputError: a value that TOML cannot hold.
    """
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def key_path(parts: tuple[str, ...]) -> str:
    """A dotted key; a part that is not a bare word is quoted."""
    return ".".join(part if _BARE.fullmatch(part) else _string(part) for part in parts)


def toml_value(value: Any) -> str:
    """A value on one line, as it stands after `key =`.

    Raises:
        InputError: a value that TOML cannot hold.
    """
    return _value(value, ())


def _table(data: dict[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [
        f"{key_path((key,))} = {_value(value, (*path, key))}"
        for key, value in data.items()
        if value is not None and not isinstance(value, dict)
    ]
    for key, value in data.items():
        if isinstance(value, dict):
            inner = _table(value, (*path, key))
            only_tables = value and all(isinstance(item, dict) for item in value.values())
            heading = [] if only_tables else ["", f"[{key_path((*path, key))}]"]
            lines += [*heading, *inner]
    return lines


def _value(value: Any, path: tuple[str, ...]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        # TOML could hold nan and inf; no key of the vocabulary may.
        if math.isfinite(value):
            return repr(value)
    elif isinstance(value, str):
        return _string(value)
    elif isinstance(value, list | tuple):
        return f"[{', '.join(_value(item, path) for item in value)}]"
    elif isinstance(value, dict):
        items = (f"{key_path((k,))} = {_value(v, (*path, k))}" for k, v in value.items())
        return f"{{{', '.join(items)}}}"
    elif hasattr(value, "isoformat"):  # the dates and times that tomllib reads
        return str(value.isoformat())
    raise InputError(
        f"{key_path(path)} is {value!r}, but must be a string, a finite number, a boolean, "
        "or a list or table of them: change it"
    )


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")
