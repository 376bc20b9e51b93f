"""How every command ends: one sentence on standard error, and an exit status."""

import contextlib
import os
import re
import sys
from collections.abc import Iterator
from typing import Any

import typer
from typer.core import TyperGroup

from .._errors import InputError
from .._signals import stopped_status
from .._text import abridged

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
    except KeyboardInterrupt:
        raise Ended(stopped_status()) from None
    except BrokenPipeError:
        raise Ended(BROKEN_PIPE) from None


def run(command: Any, arguments: list[str]) -> int:
    """Run the command line. An `InputError` and a usage error are one line on standard error.

    Returns:
        The exit status: 0, or that of the command's `typer.Exit(status)`; 2 for bad input or
        usage; 130 when interrupted, 143 when terminated.
    """
    try:
        result = command.main(args=arguments, prog_name="giajax", standalone_mode=False)
        sys.stdout.flush()
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except UsageError as error:
        return _say(_usage(error), BAD_INPUT)
    except Ended as ended:
        if ended.status == BROKEN_PIPE:
            return _close_quietly()
        return _say("interrupted", ended.status)
    except (KeyboardInterrupt, typer.Abort):
        return _say("interrupted", stopped_status())
    except BrokenPipeError:
        return _close_quietly()
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


def _close_quietly() -> int:
    # The reader has gone. Python flushes standard output once more at exit: into nothing.
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return BROKEN_PIPE
