"""Prepare docstrings for Sphinx: they are plain text with `code`, not reStructuredText.

Napoleon processes the arguments. This module escapes all other markup.
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
    """Escape `*`, `|` and `name_` in the lines of a text, except in examples.

    `code` may continue on the next line.
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
    """Escape a `*` in the shape of an array, because napoleon does not escape types."""
    lines[:] = [
        line.replace("*", r"\*") if line.startswith(":vartype ") else line for line in lines
    ]


def _about(name: str) -> list[str]:
    """Return the docstring below a constant, from the file that defines it."""
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
    """Shorten the class name of arrays, which depends on the version of JAX."""
    short = [text and text.replace("jaxlib._jax.Array", "Array") for text in about[-2:]]
    return short[0], short[1]


def _as_written(app: Sphinx) -> None:
    """Remove `__signature__`, so Sphinx takes the defaults from the source.

    The source does not list the keywords of an `Unpack`.
    """
    for each in (getattr(giajax, name) for name in dir(giajax)):
        if inspect.isfunction(each):
            vars(each).pop("__signature__", None)


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the functions to Sphinx, before and after napoleon, which writes markup."""
    app.connect("builder-inited", _as_written)
    app.connect("autodoc-process-docstring", _process, priority=400)
    app.connect("autodoc-process-docstring", _types, priority=600)
    app.connect("autodoc-process-signature", _signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
