"""Generate the command-line reference: tables of the commands by group, and of their options."""

import textwrap
from collections.abc import Iterator
from typing import Any

import typer

from giajax.cli import _app
from giajax.cli._commands import COMMANDS, GROUPS

from .files import cell

_INTRODUCTION = """\
# Commands

The commands of `giajax` by group, as `giajax --help` lists them. The section of a command has its
arguments and options, and the examples and notes of `giajax COMMAND --help`.
"""
_WIDTH = 80


def page() -> str:
    """Return the text of the page."""
    names = _app.command_names()
    group: Any = typer.main.get_command(_app._app_for(names))
    context = group.make_context("giajax", [], resilient_parsing=True)
    parts = [_INTRODUCTION]
    for key, title in GROUPS.items():
        parts += [f"## {title}\n", "| command | what it does |", "| --- | --- |"]
        for name in (name for name in names if COMMANDS[name].group == key):
            summary = cell(group.commands[name].get_short_help_str(limit=1000))
            parts.append(f"| [`giajax {name}`](#giajax-{name}) | {summary} |")
        parts.append("")
    for name in names:
        parts += _command(group.commands[name], context)
    return "\n".join(parts)


def _command(command: Any, above: Any) -> Iterator[str]:
    """Yield the section of a command."""
    context = command.make_context(
        command.name, [], parent=above, resilient_parsing=True, terminal_width=_WIDTH
    )
    yield f"## giajax {command.name}\n"
    yield f"{cell(command.help)}\n"
    yield f"```text\n{context.get_usage().removeprefix('Usage: ')}\n```\n"
    yield "| argument or option | meaning |"
    yield "| --- | --- |"
    for parameter in command.get_params(context):
        words, meaning = parameter.get_help_record(context)
        # Brackets within code are not links, and a backslash would be visible.
        shown = words.replace("|", r"\|")
        yield f"| `{shown}` | {cell(meaning)} |"
    formatter = context.make_formatter()
    command.format_epilog(context, formatter)
    yield f"\n```text\n{textwrap.dedent(formatter.getvalue()).strip()}\n```\n"
