"""The reference of the command line: what each `--help` prints."""

import os
from typing import Any

import typer

from giajax.cli import _app

_INTRODUCTION = """\
# Commands

What `giajax --help` and `giajax COMMAND --help` print.
"""
_WIDTH = 84


def page() -> str:
    """The text of the page."""
    # Rich, which typer may print with, asks the terminal.
    os.environ["COLUMNS"] = str(_WIDTH)
    parts = [_INTRODUCTION, _block("giajax", ())]
    names = _app.command_names()
    parts += [f"## giajax {name}\n\n{_block('giajax', (name,))}" for name in names]
    return "\n".join(parts)


def _block(program: str, words: tuple[str, ...]) -> str:
    """The help of a command as a block of text."""
    group = typer.main.get_command(_app._app_for(words))
    settings: dict[str, Any] = {"terminal_width": _WIDTH, "max_content_width": _WIDTH}
    context = group.make_context(program, [], resilient_parsing=True, **settings)
    if words:
        (name,) = words
        command = group.commands[name]  # type: ignore[attr-defined]
        context = command.make_context(name, [], parent=context, resilient_parsing=True, **settings)
    return f"```text\n{context.get_help().rstrip()}\n```\n"
