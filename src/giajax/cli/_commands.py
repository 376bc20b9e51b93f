"""What every command is made of: its registration, its words, and how it ends."""

import contextlib
import functools
import inspect
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from inspect import Parameter
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from ..runtime.files import check_path
from ..runtime.plugins import load_plugin
from ..runtime.process import stopped_status
from ..runtime.text import InputError, abridged, shown
from ._values import number

Function = Callable[..., None]
Texts = list[str] | None
Paths = list[Path] | None

COMMANDS: dict[str, tuple[Function, str, str]] = {}
"""Functions, their examples and `settings_after`, by the name of the command."""


def command(examples: str, *, settings_after: str = "") -> Callable[[Function], Function]:
    """Make a function a command of `giajax`, whose help ends with examples.

    A parameter is an option by its annotation: `Annotated[type, metavar, help]`, and without the
    metavar a switch. Words such as "--set" follow where the option is not called as its parameter,
    numbers are the least and the greatest value, and what is a list may be repeated. Of keywords,
    `**settings: Unpack[Settings]`, each item of the `TypedDict` is one.
    They stand in the help behind the parameter `settings_after`.
    """

    def register(function: Function) -> Function:
        # `import` is a word of Python: its function is called import_.
        COMMANDS[function.__name__.rstrip("_")] = (function, examples, settings_after)
        return function

    return register


def argument(metavar: str, text: str) -> Any:
    """An argument, which has a place and no name: what the help calls it, and says of it."""
    return typer.Argument(metavar=metavar, help=text)


_PLUGINS = Parameter(
    "plugin",
    Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        Paths, "FILE.py", "Import a law or a model of yours, which the file registers."
    ],
)


def with_options(function: Function, settings_after: str = "") -> Function:
    """The function of a command as typer reads it, with an option for each parameter."""
    parameters: list[Parameter] = []
    for each in inspect.signature(function, eval_str=True).parameters.values():
        if each.kind is Parameter.VAR_KEYWORD:
            (settings,) = get_args(each.annotation)
            place = [one.name for one in parameters].index(settings_after) + 1
            parameters[place:place] = [
                Parameter(name, Parameter.KEYWORD_ONLY, default=None, annotation=hint)
                for name, hint in get_type_hints(settings, include_extras=True).items()
            ]
        else:
            parameters.append(each.replace(kind=Parameter.KEYWORD_ONLY))

    parameters.append(_PLUGINS)

    @functools.wraps(function)
    def whole(plugin: Paths = None, **given: Any) -> None:
        for path in plugin or ():
            load_plugin(path)
        function(**given)

    return with_signature(whole, [_with_option(each) for each in parameters])


def with_signature(function: Function, parameters: Sequence[Parameter]) -> Function:
    """The function, which says that it has these parameters."""
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {each.name: each.annotation for each in parameters}
    return function


def _with_option(parameter: Parameter) -> Parameter:
    """A parameter whose annotation has the option that its words describe."""
    kind, *about = get_args(parameter.annotation) or [None]
    words = [each for each in about if isinstance(each, str)]
    if not words:
        return parameter
    least, greatest = [*(each for each in about if not isinstance(each, str)), None, None][:2]
    names = [each for each in words if each.startswith("--")]
    *metavar, text = [each for each in words if each not in names]
    if any(get_origin(each) is list for each in (kind, *get_args(kind))):
        text = re.sub(r"(?= \[[^]]*\]$)|$", " Repeatable.", text, count=1)
    if not (metavar or names):
        name = parameter.name.replace("_", "-")
        names = [f"--{name}/--no-{name}" if parameter.default is True else f"--{name}"]
    option = typer.Option(
        *names, metavar="".join(metavar) or None, help=text, min=least, max=greatest
    )
    return parameter.replace(annotation=Annotated[kind, option])


# What was typed for a number or a path, looked at before it is converted.
#
# Python reads `1_0` as ten, and digits of every script; neither is how a number is written here.

_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")


def command_of(function: Callable[..., None]) -> type[TyperCommand]:
    """A class for the command of a function, which checks numbers and paths by its signature."""
    types = {name: _type_of(hint) for name, hint in get_type_hints(function).items()}

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


BAD_INPUT = 2
BROKEN_PIPE = 141

# Typer brings its own click since 0.16 or so, and used the installed one before: what it raises
# for a wrong option is a base of its BadParameter in both.
UsageError: Any = typer.BadParameter.__mro__[1]


class Ended(Exception):  # noqa: N818
    """A command that was stopped from outside, with the exit status that says so."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status


class Commands(TyperGroup):
    """Typer's group, without its own endings for Ctrl-C and a closed pipe."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the words; typer would end Ctrl-C here without one of its own."""
        with _endings():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Run the command that the context names."""
        with _endings():
            return super().invoke(ctx)


@contextlib.contextmanager
def _endings() -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise Ended(stopped_status()) from None
    except BrokenPipeError:
        raise Ended(BROKEN_PIPE) from None


def run(command: Any, arguments: list[str]) -> int:
    """Run the command line. An `InputError` and a usage error are one line on standard error.

    The exit status is 0, or that of the command's `typer.Exit(status)`; 2 for bad input or usage;
    130 when interrupted, 143 when terminated.
    """
    try:
        with _endings():
            result = command.main(args=arguments, prog_name="giajax", standalone_mode=False)
            sys.stdout.flush()
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except UsageError as error:
        return _say(_usage(error), BAD_INPUT)
    except Ended as ended:
        if ended.status != BROKEN_PIPE:
            return _say("interrupted", ended.status)
        # The reader has gone. Python flushes standard output once more at exit: into nothing.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    # Without standalone mode typer returns the status of `typer.Exit`, else what the command did.
    return result if isinstance(result, int) else 0


def _say(sentence: str, status: int) -> int:
    print(f"giajax: {abridged(' '.join(sentence.split()))}", file=sys.stderr)
    return status


def _usage(error: Any) -> str:
    sentence = " ".join(error.format_message().split()).rstrip(".")
    # Click says two sentences where it has a suggestion, each with its capital.
    sentence = re.sub(r"(^|\. )([A-Z])", lambda m: (m[1] and ": ") + m[2].lower(), sentence)
    command = error.ctx.command_path if error.ctx is not None else "giajax"
    return f"{sentence}; '{command} --help' shows what there is"
