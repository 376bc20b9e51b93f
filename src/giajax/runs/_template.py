"""A sidecar to fill in, made from the declarations of the vocabulary."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from ..kinds import KINDS, Kind
from ._column_table import NOISE_KEYS
from ._definition import Definition
from ._fit_sections import Noise
from ._model import infer_model
from ._table import Table, read_table
from ._toml import key_path, toml_value


def sidecar_template(path: str | Path, rename: Mapping[str, str] | None = None) -> str:
    """TOML text of a sidecar for the run at `path`.

    It states what follows from the file (model, checksum, free motion) and offers, as comments
    with unit and meaning, every other key of the vocabulary that applies. An old sidecar is not
    read.

    Arguments:
        path: of the run.
        rename: the file's column name -> the name it has in the column table.

    Raises:
        InputError: the file is not a table of known columns.
    """
    path = Path(path)
    table = read_table(path, rename)
    model = infer_model(table.channels.values())
    kind = None if model is None else KINDS[model]
    lines = [
        f"# Sidecar of {path.name}. Remove the '#' before a key to state it; what is not stated",
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
    lines += ["", "# [truth]  what you know and a fit should find; no fit reads it"]
    return "\n".join(lines) + "\n"


def _offered(kind: Kind, table: Table) -> list[str]:
    """The sections that the kind of model offers for these columns."""
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
    # A column may have the name of a quantity's key: then it stands for itself.
    known = {NOISE_KEYS.get(channel.kind) for channel in measured} - {column}
    lines = [_line(Noise, name) for name in Noise.model_fields if name in known]
    meaning = "one column by its name, in its unit; wins over its quantity"
    lines.append(f"# {column} = 0.01  # {meaning}")
    return ["", "[noise]  # not stated: a fit estimates it", *lines]


def _line(section: type[BaseModel], name: str, value: Any = None) -> str:
    """`key = value  # meaning`, commented out unless the value is stated."""
    field = section.model_fields[name]
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    shown = extra["example"] if value is None else value
    text = f"{key_path((name,))} = {toml_value(shown)}  # {field.description}{_choices(field)}"
    return text if value is not None else f"# {text}"


def _choices(field: FieldInfo) -> str:
    """The values of a key that is one of a few, as its declaration says them."""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    return f": {extra['must']}" if "Literal[" in str(field.annotation) else ""
