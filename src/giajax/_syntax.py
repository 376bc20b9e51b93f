"""TOML and JSON text as plain data, where it is not deeper or larger than any file has to be.

Brackets are counted before the text is parsed: the parsers call themselves for each, and Python
ends at some depth that differs from version to version.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ._errors import InputError
from ._limits import DEPTH, WHOLE
from ._text import shown

# Strings and comments, in which a bracket is a character; one without an end goes on to the end.
_TOML_WORDS = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"""|\Z)'
    r"|'''.*?(?:'''|\Z)"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*",
    re.DOTALL,
)
_JSON_WORDS = re.compile(r'"(?:\\.|[^"\\])*"', re.DOTALL)
_BRACKETS = re.compile(r"[\[\]{}]")
_BETWEEN_KEYS = re.compile(r"[\[\]{},=\n]")


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """The content of a TOML file.

    Raises:
        InputError: it is not TOML, or is beyond the limits.
    """
    skeleton = _TOML_WORDS.sub("_", text)
    # Not only deep: the parser looks at each part of a dotted key once for each part before it.
    dotted = (part.count(".") for part in _BETWEEN_KEYS.split(skeleton))
    if _is_deep(skeleton) or any(dots >= DEPTH for dots in dotted):
        raise _too_deep(str(path))
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not valid TOML ({reason}): correct that line") from None
    except ValueError:  # of more digits than Python converts
        raise InputError(f"{path} has {_too_large()}") from None
    check_size(data, str(path))
    return data


def parse_json(text: str, path: Path) -> Any:
    """The content of a JSON file, whose objects have each key once.

    Raises:
        InputError: it is beyond the limits.
        ValueError: it is not JSON, which knows neither NaN nor infinity.
    """
    if _is_deep(_JSON_WORDS.sub("_", text)):
        raise _too_deep(str(path))
    data = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    check_size(data, str(path))
    return data


def check_size(data: Any, source: str) -> None:
    """Refuse plain data that are nested too deeply, or hold a whole number beyond 64 bits.

    Arguments:
        data: nested mappings and sequences.
        source: what an error calls them.

    Raises:
        InputError: they are beyond the limits.
    """
    waiting: list[tuple[Any, int]] = [(data, 0)]
    while waiting:
        item, depth = waiting.pop()
        inner: Iterable[Any] = ()
        if isinstance(item, Mapping):
            inner = item.values()
        elif isinstance(item, list | tuple):
            inner = item
        elif isinstance(item, int) and not -WHOLE <= item < WHOLE:
            raise InputError(f"{source} has {_too_large()}")
        if depth > DEPTH:
            raise _too_deep(source)
        waiting += [(one, depth + 1) for one in inner]


def _is_deep(skeleton: str) -> bool:
    depth = 0
    for bracket in _BRACKETS.finditer(skeleton):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > DEPTH:
            return True
    return False


def _too_deep(source: str) -> InputError:
    return InputError(
        f"{source} has tables or lists nested more than {DEPTH} deep: write it with fewer"
    )


def _too_large() -> str:
    return "a whole number beyond 64 bits, which none may be: correct it, or write it as 1e20"


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in data if names.count(name) > 1)
        raise ValueError(f"the key {shown(twice)} is there twice")
    return data


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is no number of JSON")
