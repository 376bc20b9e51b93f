"""Docstrings as Sphinx reads them: they are plain text with `code`, and no reStructuredText.

Arguments are napoleon's business; what its language has beside them is escaped here.
"""

import inspect
import re
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

import giajax

_CODE = re.compile(r"(`[^`]*`)")
_MARKUP = re.compile(r"([*|\\]|(?<=\w)_(?!\w))")


def escaped(lines: list[str]) -> list[str]:
    """Lines of text in which `*`, `|` and `name_` are what they are; examples stay as they are.

    `code` may go on from one line to the next.
    """
    parts = _CODE.split("\n".join(lines))
    parts[::2] = [_escaped_text(part) for part in parts[::2]]
    return "".join(parts).split("\n")


def _escaped_text(text: str) -> str:
    return "\n".join(
        line if line.lstrip().startswith((">>>", "...")) else _MARKUP.sub(r"\\\1", line)
        for line in text.split("\n")
    )


def _process(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    lines[:] = escaped(_about(name) if what == "data" else lines)


def _types(app: Sphinx, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """The shape of an array may have a `*`, and napoleon writes types as they are."""
    lines[:] = [
        line.replace("*", r"\*") if line.startswith(":vartype ") else line for line in lines
    ]


def _about(name: str) -> list[str]:
    """What stands below a constant, in the file of its room that has it."""
    first, *rooms, last = name.split(".")
    folders = Path(__file__).resolve().parents[2] / "src" / first
    for path in sorted(folders.rglob("*.py")):
        if rooms and path.relative_to(folders).parts[0] != rooms[0]:
            continue
        module = ".".join([first, *path.relative_to(folders).with_suffix("").parts])
        found = ModuleAnalyzer.for_module(module.removesuffix(".__init__")).find_attr_docs()
        if ("", last) in found:
            return found["", last]
    return []


def _signature(app: Sphinx, *about: Any) -> tuple[str | None, str | None]:
    """An array is an array, wherever JAX keeps its class."""
    short = [text and text.replace("jaxlib._jax.Array", "Array") for text in about[-2:]]
    return short[0], short[1]


def _as_written(app: Sphinx) -> None:
    """Sphinx takes defaults from the source, which does not list the keywords of an `Unpack`."""
    for each in (getattr(giajax, name) for name in dir(giajax)):
        if inspect.isfunction(each):
            vars(each).pop("__signature__", None)


def setup(app: Sphinx) -> dict[str, Any]:
    """What Sphinx calls: before napoleon, which writes markup, and after it."""
    app.connect("builder-inited", _as_written)
    app.connect("autodoc-process-docstring", _process, priority=400)
    app.connect("autodoc-process-docstring", _types, priority=600)
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
