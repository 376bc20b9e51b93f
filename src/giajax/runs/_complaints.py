"""Turns what pydantic has to say about a definition into one sentence about one key."""

import difflib
from collections.abc import Mapping
from typing import Any, get_args

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from .._errors import InputError
from .._text import one_of, shown
from ._toml import key_path


def complaint(cls: type[BaseModel], error: ValidationError, source: str) -> InputError:
    """The first complaint of `error`, raised by `cls`, as an `InputError`.

    What a key must be is what its declaration says, not the wording of pydantic.
    """
    first = error.errors(include_url=False)[0]
    path, owner, field, entry = _locate(cls, first["loc"])
    name = key_path(path)
    in_list = "" if entry is None else f" of entry {entry}"
    if first["type"] == "extra_forbidden":
        return InputError(f"{source}: unknown key {name}{in_list}{_remedy(cls, owner, path)}")
    if first["type"] == "value_error":  # raised by a validator of the vocabulary, in full
        sentence = str(first["ctx"]["error"])
        where = f"[{name}]" if field is None or sentence.startswith("key ") else name
        return InputError(f"{source}: {where} {sentence}" if name else f"{source}: {sentence}")
    if field is None:
        return InputError(f"{source}: [{name}] must be a table of keys: write it as one")
    # One bad number in a table of numbers is not the whole table.
    in_table = _is_dict(field) and owner is None and len(path) > 2
    must = _declared(field, in_table=in_table)
    if first["type"] == "missing":
        return InputError(f"{source}: {name}{in_list} is missing, and must be {must}: give it")
    value = shown(first["input"])
    return InputError(f"{source}: {name} = {value}{in_list} must be {must}: correct or remove it")


# More keys than this are no list to read in a sentence.
_MANY = 16


def _declared(field: FieldInfo, *, in_table: bool = False) -> str:
    extra = field.json_schema_extra
    if not isinstance(extra, dict):
        return "legal"
    return str(
        extra.get("entry", "a finite number or a list of them") if in_table else extra["must"]
    )


def plain(value: Any) -> Any:
    """Mappings, sequences and arrays as dicts, lists and Python numbers, as TOML would give."""
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return value


def _locate(
    cls: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[tuple[str, ...], type[BaseModel] | None, FieldInfo | None, int | None]:
    """Dotted path, owning section, and field (None for a whole section) of an error's place.

    And which entry of a list of sections it is in, from 1 on. What pydantic adds behind the key
    (the branch of a union, the place in a list of numbers) is left out.
    """
    path: list[str] = []
    owner: type[BaseModel] | None = cls
    field: FieldInfo | None = None
    entry: int | None = None
    in_dict = False
    for part in location:
        if not isinstance(part, str):
            section = None if field is None else _element_of(field)
            if section is None:
                break
            owner, field, entry = section, None, part + 1
            continue
        if in_dict:
            path.append(part)
            if owner is None:
                break
            in_dict, field = False, None
            continue
        if owner is None:
            break
        path.append(part)
        field = owner.model_fields.get(part)
        entries = getattr(owner, "entries", None)
        if field is None and entries is not None:
            owner = entries
            continue
        if field is None:  # an unknown key, or a column in [noise]
            if location[-1] == part and owner.model_config.get("extra") == "allow":
                field = next(iter(owner.model_fields.values()))
            break
        inner = _section_of(field)
        in_dict = _is_dict(field)
        owner = inner
        if inner is not None and not in_dict:
            field = None
    return tuple(path), owner, field, entry


def _is_dict(field: FieldInfo) -> bool:
    annotation = field.annotation
    return any(
        getattr(item, "__origin__", None) is dict for item in (annotation, *get_args(annotation))
    )


def _section_of(field: FieldInfo) -> type[BaseModel] | None:
    annotation = field.annotation
    for item in (annotation, *get_args(annotation)):
        if isinstance(item, type) and not get_args(item) and issubclass(item, BaseModel):
            return item
    return None


def _element_of(field: FieldInfo) -> type[BaseModel] | None:
    """The section that the entries of a list are."""
    for item in (field.annotation, *get_args(field.annotation)):
        for element in get_args(item) if getattr(item, "__origin__", None) is list else ():
            if isinstance(element, type) and issubclass(element, BaseModel):
                return element
    return None


def _remedy(cls: type[BaseModel], owner: type[BaseModel] | None, path: tuple[str, ...]) -> str:
    known = list(owner.model_fields) if owner is not None else []
    unknown = path[-1]
    near = difflib.get_close_matches(unknown, known, n=1, cutoff=0.7)
    if near:
        return f": did you mean {key_path((*path[:-1], near[0]))}?"
    homes = []
    for name, field in cls.model_fields.items():
        section = _section_of(field)
        if section is not None and not _is_dict(field) and unknown in section.model_fields:
            homes.append(f"[{name}]")
    if unknown in cls.model_fields and len(path) > 1:
        return ": it belongs at the top of the file, so move it there"
    if homes:
        return f": it belongs in {one_of(homes)}, so move it there"
    if len(known) > _MANY:
        return ": correct or remove it ('giajax init' writes all keys that are known here)"
    return f": correct or remove it (known here: {', '.join(known)})"
