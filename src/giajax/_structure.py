"""A text that two trees of data share exactly where one compiled program serves both.

It is the same in every process, unlike a hash or the `repr` of what has an address.
"""

import copyreg
import dataclasses
import enum
import functools
import hashlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import PurePath
from types import FunctionType
from typing import Any

import jax
import numpy as np

from ._identities import fields_of, identity

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
    return "".join(_Traced().parts(tree))


def content(tree: Any) -> str:
    """Describe a tree whole, with the numbers of its arrays (by SHA-256).

    Classes and functions of giajax count by their identities, wherever they lie, and a field that
    was added to one of its classes only where it is not what it is by default.

    Arguments:
        tree: as of `structure`, or whatever else can be copied.

    Returns:
        A text that two trees share which are the same, in every process and every version.

    Raises:
        NoStructureError: a part of it cannot be described.
    """
    return "".join(_Kept().parts(tree))


class _Traced:
    """The text in pieces: of what is no part of the program, without the numbers of the arrays."""

    def parts(self, value: Any, *, whole: bool = False) -> Iterator[str]:
        if isinstance(value, (jax.Array, np.ndarray, np.generic, jax.ShapeDtypeStruct)):
            weak = "~" if getattr(value, "weak_type", False) else ""
            yield f"{value.dtype}{weak}{list(value.shape)}"
            if whole:
                yield hashlib.sha256(np.asarray(value).tobytes()).hexdigest()
        elif isinstance(value, enum.Enum):
            yield f"{self.name(type(value))}.{value.name}"
        elif isinstance(value, _PLAIN):
            yield f"{type(value).__name__} {value!r}"
        elif isinstance(value, (type, FunctionType)):
            yield self.name(value)
        elif isinstance(value, functools.partial):
            parts = (value.func, value.args, value.keywords)
            yield from self.members("functools.partial", parts, whole=whole)
        elif dataclasses.is_dataclass(value):
            yield f"{self.name(type(value))}("
            yield from self.fields(value, whole=whole)
            yield ")"
        elif isinstance(value, Mapping):
            yield from self.members(self.name(type(value)), value.items(), whole=whole)
        elif isinstance(value, (tuple, list)):
            yield from self.members(self.name(type(value)), value, whole=whole)
        elif isinstance(value, (set, frozenset)):
            ordered = sorted(value, key=lambda item: "".join(self.parts(item)))
            yield from self.members(self.name(type(value)), ordered, whole=whole)
        else:
            yield from self.other(value)

    def members(self, name: str, values: Iterable[Any], *, whole: bool) -> Iterator[str]:
        yield f"{name}("
        for value in values:
            yield from self.parts(value, whole=whole)
            yield ","
        yield ")"

    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        for field in dataclasses.fields(value):
            static = whole or bool(field.metadata.get("static"))
            yield f"{field.name}="
            yield from self.parts(getattr(value, field.name), whole=static)
            yield ","

    def name(self, value: Any) -> str:
        return f"{value.__module__}.{_qualified(value)}"

    def other(self, value: Any) -> Iterator[str]:
        raise NoStructureError(f"there is no description of {type(value)}")


class _Kept(_Traced):
    """The text of what is kept: with all numbers, and by names that stay."""

    def parts(self, value: Any, *, whole: bool = True) -> Iterator[str]:
        return super().parts(value, whole=True)

    def fields(self, value: Any, *, whole: bool) -> Iterator[str]:
        for name, item, default in fields_of(value):
            text = "".join(self.parts(item))
            if default is dataclasses.MISSING or text != "".join(self.parts(default)):
                yield f"{name}={text},"

    def name(self, value: Any) -> str:
        return identity(f"{value.__module__}:{_qualified(value)}").replace(":", ".")

    def other(self, value: Any) -> Iterator[str]:
        if isinstance(value, PurePath):
            yield f"path {str(value)!r}"
            return
        name = self.name(type(value))
        # Of a model of pydantic what was said, in any order; the rest is by default.
        if isinstance(said := getattr(value, "model_fields_set", None), set):
            pairs = [(field, getattr(value, field)) for field in sorted(said)]
            yield from self.members(name, pairs, whole=True)
            return
        reduce: Callable[[Any], Any] | None = copyreg.dispatch_table.get(type(value))
        try:
            parts = value.__reduce_ex__(4) if reduce is None else reduce(value)
        except Exception as error:
            raise NoStructureError(f"{type(value)} cannot be copied: {error}") from None
        if isinstance(parts, str):
            yield f"{name} {getattr(value, '__module__', None)}.{parts}"
            return
        made, arguments, *rest = parts
        # Members come as iterators.
        plain = [list(each) if isinstance(each, Iterator) else each for each in rest]
        yield from self.members(name, [made, arguments, *plain], whole=True)


def _qualified(value: Any) -> str:
    name: str = value.__qualname__
    if "<" in name:
        raise NoStructureError(f"{name} is no name that a module has")
    return name
