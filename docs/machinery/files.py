"""Generate the file reference: every declared section and key of the TOML vocabulary."""

import inspect
import json
from collections.abc import Iterator
from typing import Any, get_args

from giajax.recordings import Definition
from giajax.schema import Section

_INTRODUCTION = """\
# Sections and keys

Every section and key of a sidecar, a fit definition and the file of an arm, made from the
declarations that read them. What files are for is in the [data contract](../data_contract.md).
`giajax init` writes a sidecar with those that apply to a run.
"""


def page() -> str:
    """Return the text of the page."""
    parts = [_INTRODUCTION, "## At the top\n", *_rows(Definition), ""]
    for name, section in _sections():
        about = inspect.cleandoc(section.__doc__ or "")
        parts += [f"## [{name}]\n", f"{about}\n", *_rows(section), ""]
    return "\n".join(parts)


def _sections() -> Iterator[tuple[str, type[Section]]]:
    """Yield the sections by name, each followed by its tables whose keys are declared, too."""
    known = {name: field.annotation for name, field in Definition.model_fields.items()}
    for name, annotation in known.items():
        for section in _within(annotation):
            yield name, section
            if section.entries is not None:
                yield f"{name}.NAME", section.entries
            for key, field in section.model_fields.items():
                yield from ((f"{name}.{key}", inner) for inner in _within(field.annotation))


def _within(annotation: Any) -> Iterator[type[Section]]:
    """Yield the sections in an annotation."""
    if inspect.isclass(annotation) and issubclass(annotation, Section):
        yield annotation
    for argument in get_args(annotation):
        yield from _within(argument)


def _rows(section: type[Section]) -> Iterator[str]:
    yield "| key | must be | unless stated | meaning |"
    yield "| --- | --- | --- | --- |"
    for name, field in section.model_fields.items():
        extra: Any = field.json_schema_extra
        # A section within a section is not listed as a key, because it has its own heading.
        if isinstance(extra, dict):
            preset = extra.get("preset")
            value = "" if preset is None else f"`{json.dumps(preset)}`"
            must, meaning = (cell(text) for text in (extra["must"], field.description or ""))
            yield f"| `{name}` | {must} | {value} | {meaning} |"


def cell(text: str) -> str:
    """Escape the text of a table cell, so brackets are not read as links."""
    return text.replace("|", r"\|").replace("[", r"\[").replace("]", r"\]")
