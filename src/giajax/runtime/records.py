"""Records as JSON and back: one codec of all frozen dataclasses that files hold.

A record becomes an object with a key for each field, in their order; tuples and arrays become
lists. JSON knows neither NaN nor infinity: what is not finite is null, and None when it is read
again. A field with a default may be missing, because earlier versions lack what was added since; an
unknown key is an error. Numbers stay as they were written: 1 does not become 1.0.
"""

import dataclasses
import functools
import json
import math
from collections.abc import Hashable, Mapping, Sequence
from pathlib import PurePath
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, cast

from pydantic import AfterValidator, TypeAdapter, ValidationError
from pydantic_core import SchemaValidator, core_schema

from .files import parse_json
from .text import InputError, abridged, shown

Kind = TypeVar("Kind")

InfiniteWhereNull = Annotated[
    float, AfterValidator(lambda value: math.inf if value is None else value)
]
"""Type of a number for which null in a file means infinity."""

if TYPE_CHECKING:
    Numbers = Any
else:
    Numbers = float | list[float] | list[list[float]] | None
    """A number, or an array as lists."""


def plain_data(value: Any) -> Any:
    """A value as JSON gives it back (`TypeError`: there is no form of it in JSON)."""
    if isinstance(value, bool | int | str | None):
        return value
    if isinstance(value, float):
        return finite_or_none(value)
    if isinstance(value, Mapping):
        return {str(key): plain_data(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_data(item) for item in value]
    if isinstance(value, PurePath):
        return str(value)
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        names = [field.name for field in dataclasses.fields(value)]
        return {name: plain_data(getattr(value, name)) for name in names}
    if hasattr(value, "tolist"):  # arrays and scalars of NumPy and JAX
        return plain_data(value.tolist())
    raise TypeError(f"{type(value).__qualname__} is a type that cannot be stored as JSON")


def finite_or_none(value: float | None) -> float | None:
    """A finite number, or None."""
    return float(value) if value is not None and math.isfinite(value) else None


def json_text(record: Any, head: Mapping[str, Any] | None = None, indent: int = 2) -> str:
    """The text of a file that holds a dataclass or plain data, with the keys of `head` first."""
    return json.dumps({**(head or {}), **plain_data(record)}, indent=indent, allow_nan=False) + "\n"


def parse_record(
    kind: type[Kind], text: str | bytes, head: Mapping[str, Any], what: str, remedy: str
) -> Kind:
    """The record that a text of `json_text` with this `head` holds; else as `from_plain`."""
    try:
        data = parse_json(text if isinstance(text, str) else text.decode(), what)
    except InputError:
        raise
    except ValueError:
        raise InputError(f"{what} (it is not JSON): {remedy}") from None
    if isinstance(data, dict):
        for key, value in head.items():
            if data.pop(key, None) != value:
                raise InputError(f"{what} ({key} is not {value}): {remedy}")
    return from_plain(kind, data, what, remedy)


def from_plain(
    kind: type[Kind],
    data: Any,
    what: str = "this is not a record of giajax",
    remedy: str = "correct it",
) -> Kind:
    """The record that plain data hold.

    Arguments:
        kind: the dataclass, or a type made of some: `dict[str, Estimate]`.
        data: as JSON gives them.
        what: the beginning of an error, such as "FILE is not a result of giajax".
        remedy: its end.

    Raises:
        InputError: naming the first key that is missing, unknown, or not what it must be.
    """
    try:
        record: Kind = _reader(cast(Hashable, kind)).validate_python(data)
    except ValidationError as error:
        raise InputError(f"{what} ({_complaint(error, data)}): {remedy}") from None
    return record


@functools.cache
def _reader(kind: Any) -> SchemaValidator:
    return SchemaValidator(_as_stored(TypeAdapter(kind).core_schema))


_NUMBER = core_schema.union_schema(
    [
        core_schema.int_schema(strict=True),
        core_schema.float_schema(strict=True),
        core_schema.none_schema(),
    ],
    custom_error_type="number",
    custom_error_message="a number",
)


def _as_stored(schema: Any) -> Any:
    """A schema of pydantic by the rules of stored records, which differ from those of a program."""
    if isinstance(schema, list | tuple):
        return type(schema)(map(_as_stored, schema))
    if not isinstance(schema, dict):
        return schema
    kind = schema.get("type")
    if kind == "float":
        return _NUMBER
    if kind in ("int", "str", "bool"):
        return {**schema, "strict": True}
    stored = {key: _as_stored(value) for key, value in schema.items()}
    if kind == "dataclass":
        stored["config"] = {"extra_fields_behavior": "forbid", **schema.get("config", {})}
    return stored


# By the codes of pydantic, whose own words change.
_MUST = {
    "number": "a number",
    "string_type": "text",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "none_required": "null",
    "dict_type": "an object",
    "dataclass_type": "an object",
    "tuple_type": "a list",
    "list_type": "a list",
    "too_long": "a shorter list",
}


def _complaint(error: ValidationError, data: Any) -> str:
    """What is wrong with plain data, and where."""
    # Of the branches of a union, the one that the data follow farthest.
    errors = error.errors(include_url=False)
    places = [_place(one["loc"], one["type"] == "missing", data) for one in errors]
    first, (path, value) = max(zip(errors, places, strict=True), key=lambda pair: len(pair[1][0]))
    name = "".join(f".{part}" if str(part).isidentifier() else f"[{part!r}]" for part in path)
    name = abridged(name.removeprefix(".")) or "it"
    if first["type"] == "missing":
        return f"{name} is missing"
    if first["type"] == "unexpected_keyword_argument":
        return f"{name} is not a key known to this version"
    if first["type"] == "value_error":  # raised by the record
        return f"{name} {first['ctx']['error']}"
    must = _MUST.get(first["type"], "something else")
    if first["type"] == "literal_error":
        must = first["ctx"]["expected"].replace("'", '"')
    return f"{name} is {'null' if value is None else shown(value)}, but must be {must}"


def _place(location: Sequence[int | str], missing: bool, data: Any) -> tuple[list[int | str], Any]:
    """Keys and positions that lead to what an error is about, and what is there."""
    path: list[int | str] = []
    for number, part in enumerate(location):
        known = dict(enumerate(data)) if isinstance(data, list) else data
        if isinstance(known, Mapping) and part in known:
            data = known[part]
        elif not missing or number < len(location) - 1:
            break  # the name of a branch of a union
        path.append(part)
    return path, data
