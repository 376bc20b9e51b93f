"""Definitions: the TOML vocabulary of sidecars, fit definitions and arm definitions."""

import difflib
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    Field,
    ValidationError,
    create_model,
    field_validator,
)
from pydantic.fields import FieldInfo

from ..runtime.files import check_size, parse_toml, read_text
from ..runtime.limits import TEXT_BYTES
from ..runtime.plugins import registered
from ..runtime.text import InputError, one_of, shown
from ..schema import (
    KINDS,
    FillingSection,
    Kind,
    MissionSection,
    Name,
    Prior,
    Section,
    UnrollingSection,
    cached_by_kinds,
    key,
)
from ._channels import column_table, infer_model
from ._fit_sections import Figure, FitSettings, Noise, Uncertainty
from ._table import Table, read_table

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def to_toml(data: dict[str, Any]) -> str:
    """Return nested dicts of strings, numbers, booleans and lists as TOML; None is left out.

    The order of the dicts is kept, with plain values before tables. A value that TOML cannot
    represent raises an `InputError`.
    """
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def key_path(parts: tuple[str, ...]) -> str:
    """Return a dotted key; a part that is not a bare key is quoted."""
    return ".".join(part if _BARE.fullmatch(part) else _string(part) for part in parts)


def _table(data: dict[str, Any], path: tuple[str, ...]) -> list[str]:
    lines = [
        f"{key_path((key,))} = {_value(value, (*path, key))}"
        for key, value in data.items()
        if value is not None and not isinstance(value, dict)
    ]
    for name, value in data.items():
        if isinstance(value, dict):
            inner = _table(value, (*path, name))
            only_tables = value and all(isinstance(item, dict) for item in value.values())
            heading = [] if only_tables else ["", f"[{key_path((*path, name))}]"]
            lines += [*heading, *inner]
    return lines


def _value(value: Any, path: tuple[str, ...]) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        # TOML can represent nan and inf, but no key of the vocabulary allows them.
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


def complaint(cls: type[BaseModel], error: ValidationError, source: str) -> InputError:
    """Return the first error in `error`, which `cls` raised, as an `InputError`.

    The message describes the legal values as the declaration of the key does, not in the wording of
    pydantic.
    """
    first = error.errors(include_url=False)[0]
    path, owner, field, entry = _locate(cls, first["loc"])
    name = key_path(path)
    in_list = "" if entry is None else f" of entry {entry}"
    if first["type"] == "extra_forbidden":
        return InputError(f"{source}: unknown key {name}{in_list}{_remedy(cls, owner, path)}")
    if first["type"] == "value_error":  # raised by a validator, with a full message
        sentence = str(first["ctx"]["error"])
        where = f"[{name}]" if field is None or sentence.startswith("key ") else name
        return InputError(f"{source}: {where} {sentence}" if name else f"{source}: {sentence}")
    if field is None:
        return InputError(f"{source}: [{name}] must be a table of keys: write it as one")
    about, must = field.json_schema_extra, "legal"
    # A bad number in a table of numbers does not make the whole table bad.
    if isinstance(about, dict) and _is_dict(field) and owner is None and len(path) > 2:
        must = str(about.get("entry", "a finite number or a list of them"))
    elif isinstance(about, dict):
        must = str(about["must"])
    if first["type"] == "missing":
        return InputError(f"{source}: {name}{in_list} is missing, and must be {must}: give it")
    value = shown(first["input"])
    return InputError(f"{source}: {name} = {value}{in_list} must be {must}: correct or remove it")


_MANY = 16  # a sentence lists at most this many keys


def plain(value: Any) -> Any:
    """Convert mappings, sequences, arrays and priors to dicts, lists and numbers, as in TOML."""
    if isinstance(value, Prior):
        return value.contents()
    if isinstance(value, Mapping):
        return {name: plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    return np.asarray(value).tolist() if hasattr(value, "__array__") else value


def _locate(
    cls: type[BaseModel], location: tuple[int | str, ...]
) -> tuple[tuple[str, ...], type[BaseModel] | None, FieldInfo | None, int | None]:
    """Return the dotted path, owning section and field (None: a whole section) of an error.

    The last value is the number of the entry, from 1, if the error is in a list of sections.
    What pydantic adds behind the key (the branch of a union, the position in a list of numbers) is
    left out.
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
    """Return the section class of the entries of a list, or None."""
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
    homes = [
        f"[{name}]"
        for name, field in cls.model_fields.items()
        if (section := _section_of(field)) is not None
        and not _is_dict(field)
        and unknown in section.model_fields
    ]
    if unknown in cls.model_fields and len(path) > 1:
        return ": it belongs at the top of the file, so move it there"
    if homes:
        return f": it belongs in {one_of(homes)}, so move it there"
    if len(known) > _MANY:
        return ": correct or remove it ('giajax init' writes all keys that are allowed here)"
    return f": correct or remove it (allowed here: {', '.join(known)})"


S = TypeVar("S", bound=Section)

_QUOTED = [f'"{name}"' for name in KINDS]


def _known_model(word: str) -> str:
    # Looking up the model of a package imports it, which registers its kind.
    if word not in KINDS and registered("model", word) is not None and word not in KINDS:
        raise ValueError(
            f"= {word!r} is a model that declares no channels: declare them in its class"
        )
    if word not in KINDS:
        raise ValueError(
            f"= {word!r} must be {one_of(_QUOTED)}, or a registered model: correct the name, give "
            "--plugin FILE.py, or install its package"
        )
    return word


KindName = Annotated[str, AfterValidator(_known_model)]
if not TYPE_CHECKING:
    KindName = Annotated[Literal[*KINDS] | str, AfterValidator(_known_model)]


class _Head(Section):
    """The keys at the top of a file."""

    schema_version: Literal[1] = key("1", "version of the schema of this file", default=1)
    model: KindName | None = key(one_of(_QUOTED), "model of the run", example=next(iter(KINDS)))
    origin: str | None = key(
        "text", "source of the run", example="who recorded the run, with which equipment, and when"
    )
    licence: str | None = key("text", "terms under which the run may be used", example="CC0-1.0")
    sha256: Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")] | None = key(
        "64 hexadecimal digits", "checksum of the data file"
    )
    free_motion: bool | None = key(
        "true or false", "true: the arm moves without commands", example=True
    )


def _classes() -> dict[str, type[Section]]:
    return {name: of for kind in KINDS.values() for name, of in kind.all_sections.items()}


if TYPE_CHECKING:

    class _Sections(_Head):
        """The sections of the kinds of models, as fields."""

else:
    _Sections = create_model(
        "_Sections",
        __base__=_Head,
        **{name: (section, Field(default_factory=section)) for name, section in _classes().items()},
    )


class Definition(_Sections):
    """A sidecar, a fit definition or a user's own arm. Every section and key is optional.

    A section that is not in the file exists with its defaults, so
    `definition.section(ArmSection).links` is always legal. `definition.contents()` returns only the
    contents of the file. Each kind of model adds its own sections.
    """

    noise: Noise = Field(default_factory=Noise)
    uncertainty: Uncertainty = Field(default_factory=Uncertainty)
    truth: dict[str, Any] = key(
        "a table",
        "true parameter values, known to the author of the data; a fit never reads them",
        default={},
    )
    fit: FitSettings = Field(default_factory=FitSettings)
    filling: FillingSection = Field(default_factory=FillingSection)
    unrolling: UnrollingSection = Field(default_factory=UnrollingSection)
    mission: MissionSection | None = key("a table of keys", "task that an operator is to complete")
    figures: dict[Name, Figure] = key(
        'a table like [figures."air.drag_coefficient"]',
        "figures that a result must reach",
        default={},
    )

    def section(self, of: type[S]) -> S:
        """Return the section of a class, with its defaults if it is not in the file."""
        # A definition made before a kind was registered lacks the sections of this kind.
        section: S = getattr(self, _names()[of], None) or of()
        return section

    @field_validator("sha256", mode="before")
    @classmethod
    def _lower_case(cls, digits: Any) -> Any:
        return digits.lower() if isinstance(digits, str) else digits

    @classmethod
    def parse(cls, data: Mapping[str, Any], source: str = "definition") -> "Definition":
        """Make a definition from plain data.

        Arguments:
            data: data as read by `tomllib`; mappings, sequences and arrays are accepted, too.
            source: name of the data in error messages.

        Raises:
            InputError: a key is unknown (the message gives the nearest known one), a value is not
                legal for its key, or the data exceed the size limits of a file.
        """
        check_size(data, source)
        try:
            _names()
            return cls.model_validate(upgraded(plain(data)))
        except ValidationError as error:
            raise complaint(cls, error, source) from None

    @classmethod
    def load(cls, path: str | Path) -> "Definition":
        """Read a TOML file.

        Raises:
            InputError: the file is missing, is not TOML, or is not legal.
        """
        path = Path(path)
        text = read_text(path, TEXT_BYTES, "TOML", "the path of a TOML file")
        return cls.parse(parse_toml(text, path), str(path))

    def merged_with(self, other: "Definition") -> "Definition":
        """Return this definition, overridden by `other` for each key within a section.

        Raises:
            InputError: the two definitions contradict each other.
        """
        merged = self.contents()
        for name, value in other.contents().items():
            # The keys of an entry of [figures] belong together, so it is replaced as a whole.
            depth = 1 if name == "figures" else 2
            merged[name] = _merge(merged.get(name), value, depth)
        return Definition.parse(merged, "combined definitions")

    def to_toml(self) -> str:
        """Return the contents as TOML, starting with the version; `load` reads this text."""
        return to_toml({"schema_version": self.schema_version, **self.contents()})


@cached_by_kinds
def _names() -> dict[type[Section], str]:
    """Return the section names of all kinds, and make each section a field of `Definition`."""
    fields = Definition.model_fields
    known = {name: field.annotation for name, field in fields.items()}
    added = {name: of for name, of in _classes().items() if known.get(name) is not of}
    for name, of in added.items():
        fields[name] = FieldInfo(annotation=of, default_factory=of)
    if added:
        Definition.model_rebuild(force=True)
    return {of: name for name, of in _classes().items()}


def fit_settings(
    keywords: Mapping[str, Any], source: str = "the arguments", settings: FitSettings | None = None
) -> FitSettings:
    """Return the settings of a fit from keywords, or the given settings object.

    Arguments:
        keywords: keywords of `FitKeywords`; None for those that are not set.
        source: name of the keywords in error messages.
        settings: settings object to use instead of keywords.

    Raises:
        InputError: as in `Definition.parse`, or both settings and keywords are given.
    """
    names = [name for name, value in keywords.items() if value is not None]
    if settings is not None:
        if names:
            raise InputError(
                f"{source} contain both a settings object and {', '.join(names)}: give all "
                "settings in only one of the two ways"
            )
        return settings
    said = {name: plain(value) for name, value in keywords.items() if value is not None}
    if "free" in said and not isinstance(free := keywords["free"], str):
        said["free"] = list(free)
    if isinstance(budget := said.get("budget"), float | int):
        if not 0 < budget < math.inf:
            raise InputError(f"the budget is {budget:g} s: give a positive number of seconds")
        said["budget"] = f"{budget:.9f}s"
    return Definition.parse({"fit": said}, source).fit


def upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Convert plain data of an older version to this one, using the rules of each kind of model."""
    for kind in KINDS.values():
        data = kind.upgraded(data)
    return data


def run_keys(*, model: bool) -> tuple[str, ...]:
    """Return the keys that a definition may contain about a run, with or without its `model`."""
    sections = [
        name
        for kind in KINDS.values()
        for name in (kind.all_sections if model else kind.run_sections)
    ]
    return (*(("model",) if model else ()), "free_motion", *dict.fromkeys(sections), "noise")


def _merge(below: Any, above: Any, depth: int) -> Any:
    if depth == 0 or not isinstance(below, dict) or not isinstance(above, dict):
        return above
    merged = dict(below)
    for name, value in above.items():
        merged[name] = _merge(merged.get(name), value, depth - 1)
    return merged


def sidecar_template(path: str | Path, rename: Mapping[str, str] | None = None) -> str:
    """Return a TOML sidecar for the run at `path`, whose columns may be renamed.

    It sets the values that follow from the file (model, checksum, free motion). All other
    applicable keys of the vocabulary are comments with unit and meaning. An existing sidecar is not
    read.

    Raises:
        InputError: the file is not a table with known column names.
    """
    path = Path(path)
    table = read_table(path, rename)
    model = infer_model(table.channels.values())
    kind = None if model is None else KINDS[model]
    lines = [
        f"# Sidecar of {path.name}. Remove the '#' before a key to set it. A key that is not set",
        "# is assumed or unknown." if kind is None else kind.template_heading,
        "schema_version = 1",
        _line(Definition, "model", model),
        _line(Definition, "origin"),
        _line(Definition, "licence"),
        _line(Definition, "sha256", table.sha256),
    ]
    if kind is not None:
        lines += _offered(kind, table)
        lines += _noise(kind, table)
    lines += ["", "# [truth]  true parameter values that a fit should recover; no fit reads them"]
    return "\n".join(lines) + "\n"


def _offered(kind: Kind, table: Table) -> list[str]:
    """Return the lines of the sections that the kind of model offers for these columns."""
    classes = kind.all_sections
    lines = []
    for offer in kind.offers(list(table.channels.values())):
        first, _, name = offer.section.partition(".")
        section = classes.get(first, Definition)
        if name and section.entries is not None:
            section = section.entries
        if offer.section:
            comment = f"  # {offer.comment}" if offer.comment else ""
            lines += ["", f"[{offer.section}]{comment}"]
        lines += [_line(section, name, value) for name, value in offer.keys.items()]
    return lines


def _noise(kind: Kind, table: Table) -> list[str]:
    measured = [c for c in table.channels.values() if c.kind in kind.outputs]
    if not measured:
        return []
    column = measured[-1].column
    # A column may have the name of the key of a quantity. The name then means the column.
    known = {column_table()[channel.kind].noise for channel in measured} - {column}
    lines = [_line(Noise, name) for name in Noise.model_fields if name in known]
    meaning = (
        "noise of the column with this name, in the unit of the column; replaces the noise of its "
        "quantity"
    )
    lines.append(f"# {column} = 0.01  # {meaning}")
    return ["", "[noise]  # a fit estimates the noise that is not given", *lines]


def _line(section: type[BaseModel], name: str, value: Any = None) -> str:
    """Return `key = value  # meaning`, commented out if no value is given."""
    field = section.model_fields[name]
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    # List the values of a key that allows only a few, as in its declaration.
    choices = f": {extra['must']}" if "Literal[" in str(field.annotation) else ""
    shown = _value(extra["example"] if value is None else value, ())
    text = f"{key_path((name,))} = {shown}  # {field.description}{choices}"
    return text if value is not None else f"# {text}"
