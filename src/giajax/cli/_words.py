"""What was typed for a number or a path, looked at before it is converted.

Python reads `1_0` as ten, and digits of every script; neither is how a number is written here.
"""

import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args, get_type_hints

from typer.core import TyperCommand

from .._errors import InputError
from .._files import check_path
from .._text import shown
from ._values import number

_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")


def command_of(function: Callable[..., None]) -> type[TyperCommand]:
    """A class for the command of a function, which checks numbers and paths by its signature."""
    hints = get_type_hints(function)
    types = {name: _type_of(hints[name]) for name in inspect.signature(function).parameters}

    class Command(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            """Check the words, then convert them."""
            typed = self.make_parser(ctx).parse_args(args=list(args))[0]
            for name, value in typed.items():
                for word in _words(value):
                    _check(types.get(name), word, name)
            return super().parse_args(ctx, args)

    return Command


def _type_of(hint: Any) -> Any:
    """`int`, `float` or `Path` of an annotation, which may be a list of them or leave them out."""
    if hint in (int, float, Path):
        return hint
    return next(filter(None, map(_type_of, get_args(hint))), None)


def _words(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, list | tuple):
        for item in value:
            yield from _words(item)


def _check(of: Any, word: str, name: str) -> None:
    option = f"--{name.replace('_', '-')}"
    if of is Path:
        check_path(word)
    elif of is int and not _WHOLE.fullmatch(word):
        raise InputError(f"{option} {shown(word)} must be a whole number, such as 10: correct it")
    elif of is float and number(word) is None:
        raise InputError(f"{option} {shown(word)} must be a number, such as 0.5: correct it")
