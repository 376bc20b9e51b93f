"""The command line that made a file, to be written into it and run again."""

import shlex

import typer


def origin(context: typer.Context) -> str:
    """The command line without what only says where to write."""
    from importlib.metadata import version

    words = [f"giajax {version('giajax')} {context.command.name}"]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if (
            parameter.name in ("out", "force")
            or value in (None, [], ())
            or value == parameter.default
        ):
            continue
        items = value if isinstance(value, list | tuple) else [value]
        for item in items:
            shown = f"{item:.15g}" if isinstance(item, float) else str(item)
            # An argument has its place and no name.
            option = [parameter.opts[0]] if parameter.opts[0].startswith("-") else []
            words.append(" ".join([*option, shlex.quote(shown)]))
    return " ".join(words)
