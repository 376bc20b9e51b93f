"""The commands of `giajax`: a function says that it is one, with its examples."""

from collections.abc import Callable

COMMANDS: dict[str, tuple[Callable[..., None], str]] = {}
"""Functions and their examples, by the name of the command."""


def command(examples: str) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Make a function a command of `giajax`, whose help ends with examples."""

    def register(function: Callable[..., None]) -> Callable[..., None]:
        # `import` is a word of Python: its function is called import_.
        COMMANDS[function.__name__.rstrip("_")] = (function, examples)
        return function

    return register
