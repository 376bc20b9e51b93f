"""A text that two trees of data share exactly where one compiled program serves both.

It is the same in every process, unlike a hash or the `repr` of what has an address.
"""

import dataclasses
import enum
import functools
import hashlib
from collections.abc import Iterable, Iterator, Mapping
from types import FunctionType
from typing import Any

import jax
import numpy as np

_PLAIN = (type(None), bool, int, float, complex, str, bytes)


class NoStructureError(Exception):
    """Something that no text describes in every process alike, such as a closure."""


def structure(tree: Any) -> str:
    """Describe what of a tree decides how it is traced.

    Arguments:
        tree: modules, other dataclasses, containers, arrays, and what is static.

    Returns:
        Of each array its shape and type, of everything else the value.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_parts(tree, whole=False))


def content(tree: Any) -> str:
    """Describe a tree whole, with the numbers of its arrays (by SHA-256).

    Arguments:
        tree: as of `structure`.

    Returns:
        A text that two trees share which are the same, in every process.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_parts(tree, whole=True))


def _parts(value: Any, *, whole: bool) -> Iterator[str]:
    """The text in pieces; of what is a part of the program, with the numbers of the arrays."""
    if isinstance(value, (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)):
        weak = "~" if getattr(value, "weak_type", False) else ""
        yield f"{value.dtype}{weak}{list(value.shape)}"
        if whole:
            yield hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
    elif isinstance(value, enum.Enum):
        yield f"{_named(type(value))}.{value.name}"
    elif isinstance(value, _PLAIN):
        yield f"{type(value).__name__} {value!r}"
    elif isinstance(value, (type, FunctionType)):
        yield _named(value)
    elif isinstance(value, functools.partial):
        parts = (value.func, value.args, value.keywords)
        yield from _members("functools.partial", parts, whole=whole)
    elif dataclasses.is_dataclass(value):
        yield f"{_named(type(value))}("
        for field in dataclasses.fields(value):
            static = whole or bool(field.metadata.get("static"))
            yield f"{field.name}="
            yield from _parts(getattr(value, field.name), whole=static)
            yield ","
        yield ")"
    elif isinstance(value, Mapping):
        yield from _members(_named(type(value)), value.items(), whole=whole)
    elif isinstance(value, (tuple, list)):
        yield from _members(_named(type(value)), value, whole=whole)
    elif isinstance(value, (set, frozenset)):
        yield from _members(_named(type(value)), sorted(value, key=structure), whole=whole)
    else:
        raise NoStructureError(f"there is no description of {type(value)}")


def _members(name: str, values: Iterable[Any], *, whole: bool) -> Iterator[str]:
    yield f"{name}("
    for value in values:
        yield from _parts(value, whole=whole)
        yield ","
    yield ")"


def _named(value: Any) -> str:
    name: str = value.__qualname__
    if "<" in name:
        raise NoStructureError(f"{name} is no name that a module has")
    return f"{value.__module__}.{name}"
