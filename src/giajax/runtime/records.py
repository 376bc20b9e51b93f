"""Storage of records as JSON, with one codec for all frozen dataclasses in files.

A record becomes an object with one key per field, in order. Tuples and arrays become lists. JSON
has neither NaN nor infinity: values that are not finite become null, and None when they are read
again. A field with a default may be missing, because earlier versions lack later fields. An unknown
key is an error. Numbers are read as they were written: 1 does not become 1.0.
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
    """Return a value as JSON would restore it (`TypeError`: it has no form in JSON)."""
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
    """Return a number if it is finite, otherwise None."""
    return float(value) if value is not None and math.isfinite(value) else None


def json_text(record: Any, head: Mapping[str, Any] | None = None, indent: int = 2) -> str:
    """Return the text of a file with a dataclass or plain data, with the keys of `head` first."""
    return json.dumps({**(head or {}), **plain_data(record)}, indent=indent, allow_nan=False) + "\n"


def parse_record(
    kind: type[Kind], text: str | bytes, head: Mapping[str, Any], what: str, remedy: str
) -> Kind:
    """Return the record in a text of `json_text` with this `head`; errors as in `from_plain`."""
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
    what: str = "this is not a giajax record",
    remedy: str = "correct it",
) -> Kind:
    """Return the record in plain data.

    Arguments:
        kind: the dataclass, or a type composed of dataclasses: `dict[str, Estimate]`.
        data: data as read from JSON.
        what: beginning of an error message, such as "FILE is not a giajax result".
        remedy: end of an error message.

    Raises:
        InputError: the message names the first key that is missing, unknown or invalid.
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
    """Convert a pydantic schema to the rules of stored records, which are stricter."""
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


# The texts are selected by pydantic's error codes, because its own messages change.
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
    """Describe the error in plain data and its location."""
    # For a union, the error of the branch that matches the data farthest is reported.
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
    """Return the keys and indices that lead to the location of an error, and the value there."""
    path: list[int | str] = []
    for number, part in enumerate(location):
        known = dict(enumerate(data)) if isinstance(data, list) else data
        if isinstance(known, Mapping) and part in known:
            data = known[part]
        elif not missing or number < len(location) - 1:
            break  # the name of a branch of a union
        path.append(part)
    return path, data
