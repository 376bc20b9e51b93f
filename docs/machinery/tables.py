"""Generate tables of the pages from the declarations of giajax.

    python -m docs.machinery.tables     write the tables into their pages

In a page, a table is between two comments, `<!-- table: NAME -->` and `<!-- end of table -->`. The
tests check that each table agrees with the declarations.
"""

import ast
import functools
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import equinox as eqx

import giajax
from giajax.cli._app import old_forms
from giajax.cli._commands import OLD_FORMS_END
from giajax.mechanics.joint import EmpiricalMuscle, Friction, Joint, Piston
from giajax.schema import KINDS, FillingSection, Section, UnrollingSection

DOCS = Path(__file__).resolve().parents[1]
SOURCE = DOCS.parent / "src" / "giajax"
ROOMS = sorted(path.parent.name for path in SOURCE.glob("*/__init__.py"))
_TABLE = re.compile(r"(<!-- table: ([\w ]+) -->\n\n).*?(<!-- end of table -->)", re.DOTALL)


def _assumed(model: eqx.Module) -> Iterator[str]:
    """Yield a row for each parameter whose default has no source."""
    yield "| parameter | assumed | unit | meaning |"
    yield "| --- | --- | --- | --- |"
    for path, parameter in giajax.declared(model).items():
        declaration = parameter.declaration
        if declaration.assumed:
            unit = declaration.unit or "-"
            yield f"| `{path}` | {declaration.default:g} | {unit} | {declaration.doc} |"


def _assumed_filling() -> Iterator[str]:
    """Yield the same rows for a filling, without those of its arm."""
    arm = giajax.declared(giajax.takeichi_20m())
    for row in _assumed(giajax.mechanics.inflation.Filling()):
        if not any(row.startswith(f"| `{path}` ") for path in arm):
            yield row


def _assumed_unrolling() -> Iterator[str]:
    """Yield the same rows for an unrolling, without those of its filling."""
    filling = giajax.declared(giajax.mechanics.inflation.Filling())
    for row in _assumed(giajax.mechanics.unrolling.Unrolling()):
        if not any(row.startswith(f"| `{path}` ") for path in filling):
            yield row


def _keys_of(section: type[Section]) -> Iterator[str]:
    """Yield a row for each key of a section."""
    yield "| key | must be | unless stated | meaning |"
    yield "| --- | --- | --- | --- |"
    for key, field in section.model_fields.items():
        extra = field.json_schema_extra
        assert isinstance(extra, dict)
        preset = "" if extra["preset"] is None else f"`{json.dumps(extra['preset'])}`"
        yield f"| `{key}` | {extra['must']} | {preset} | {field.description} |"


def _channels() -> Iterator[str]:
    """Yield a row for each channel, with the kinds of models for which it has the same meaning."""
    yield "| channel | model | part | values |"
    yield "| --- | --- | --- | --- |"
    yield "| `time` | any | input | time |"
    kinds: dict[tuple[str, str, str], list[str]] = {}
    for kind in KINDS.values():
        for row in kind.channels:
            texts = " or ".join(f"`{text}`" for text in row.texts)
            values = texts or (row.quantity or "any").replace("_", " ")
            kinds.setdefault((row.column, row.part, values), []).append(kind.name)
    for (column, part, values), names in kinds.items():
        yield f"| `{column}` | {', '.join(names)} | {part} | {values} |"


def _keys() -> Iterator[str]:
    """Yield a row for each key that sets a parameter."""
    yield "| key | parameter | unless stated | meaning |"
    yield "| --- | --- | --- | --- |"
    for kind in KINDS.values():
        for stated, of in {**kind.sections, **kind.run_sections}.items():
            name, section = (f"{stated}.NAME", of.entries) if of.entries else (stated, of)
            for key, parts in section.quantities.items():
                paths = ", ".join(f"`{path}`" for path in dict.fromkeys(p.path for p in parts))
                field = section.model_fields[key]
                extra = field.json_schema_extra
                preset = extra["preset"] if isinstance(extra, dict) else None
                value = "left out" if preset is None else f"`{preset}`"
                yield f"| `{name}.{key}` | {paths} | {value} | {field.description} |"


def _old_forms() -> Iterator[str]:
    """Yield a row for each former form of the command line."""
    yield "| earlier | now | until |"
    yield "| --- | --- | --- |"
    for old, new in old_forms():
        yield f"| `{old}` | `{new}` | {OLD_FORMS_END} |"


def _files(room: str) -> Iterator[str]:
    """Yield a row for each file of a package, with the first line of its docstring."""
    yield "| file | contents |"
    yield "| --- | --- |"
    folder = SOURCE / room
    for path in sorted(folder.rglob("*.py")):
        if path.name != "__init__.py":
            text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
            yield f"| `{path.relative_to(folder)}` | {text.partition(chr(10))[0]} |"


TABLES: dict[str, Callable[[], Iterator[str]]] = {
    "assumed arm": lambda: _assumed(giajax.ArmModel(giajax.takeichi_20m())),
    "assumed joint": lambda: _assumed(giajax.JointModel(Joint())),
    "assumed braided muscle": lambda: _assumed(giajax.MuscleModel(friction=Friction())),
    "assumed empirical muscle": lambda: _assumed(giajax.MuscleModel(EmpiricalMuscle())),
    "assumed piston": lambda: _assumed(giajax.MuscleModel(Piston())),
    "assumed filling": _assumed_filling,
    "filling keys": functools.partial(_keys_of, FillingSection),
    "assumed unrolling": _assumed_unrolling,
    "unrolling keys": functools.partial(_keys_of, UnrollingSection),
    "channels": _channels,
    "keys": _keys,
    "old forms": _old_forms,
    **{f"files {room}": functools.partial(_files, room) for room in ROOMS},
}
"""Function that yields the rows of each table, by the name of the table."""


def names(text: str) -> list[str]:
    """Return the names of the tables in a page."""
    return [match[2] for match in _TABLE.finditer(text)]


def written(text: str) -> str:
    """Return a page with its tables generated from the declarations."""
    return _TABLE.sub(lambda match: f"{match[1]}{_markdown(match[2])}\n{match[3]}", text)


def _markdown(name: str) -> str:
    return "".join(f"{row}\n" for row in TABLES[name]())


def main() -> None:
    """Write all tables into their pages."""
    for page in sorted(DOCS.glob("*.md")):
        text = page.read_text(encoding="utf-8")
        if (new := written(text)) != text:
            page.write_text(new, encoding="utf-8")
            print(f"{page.name}: {', '.join(names(text))}")


if __name__ == "__main__":
    main()
