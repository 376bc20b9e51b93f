"""Framework of the commands: registration, parsing, errors, and shared options and output."""

import contextlib
import dataclasses
import functools
import inspect
import os
import re
import shlex
import shutil
import sys
import tempfile
import textwrap
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from inspect import Parameter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, cast, get_args, get_origin, get_type_hints

import typer
from typer.core import TyperCommand, TyperGroup

from ..runtime.aliases import UNTIL
from ..runtime.files import check_path
from ..runtime.pictures import all_pictures, pictures_as
from ..runtime.plugins import load_plugin
from ..runtime.process import CORES_VARIABLE, configure, is_stopped, stopped_status
from ..runtime.text import (
    InputError,
    abridged,
    error_in_words,
    narrowest,
    shown,
    time_in_words,
)
from ._values import number

if TYPE_CHECKING:
    from ..runtime.tasks import Outcome

Function = Callable[..., None]
Texts = list[str] | None
Paths = list[Path] | None

GROUPS = {
    "first": "First day",
    "data": "Data",
    "fit": "Fit",
    "trust": "Trust",
    "study": "Study",
    "plan": "Plan",
    "arm": "Arm",
    "paper": "Paper",
    "other": "Other",
}
"""Titles of the groups of commands, in the order used in the help."""

OLD_FORMS_END = UNTIL
"""Date until which old forms of options and earlier Python names work."""


@dataclasses.dataclass(frozen=True)
class Registered:
    """A command: its function and the arguments that `command` was given for it."""

    function: Function
    examples: str
    group: str
    settings_after: str = ""
    pictures: bool = False
    old: Mapping[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    old_words: str = ""


COMMANDS: dict[str, Registered] = {}
"""All commands by their names."""


def command(
    examples: str,
    *,
    group: str,
    settings_after: str = "",
    pictures: bool = False,
    old: Mapping[str, str | tuple[str, ...]] | None = None,
    old_words: str = "",
) -> Callable[[Function], Function]:
    """Make a function a command of `giajax`, whose help ends with examples.

    A parameter becomes an option by its annotation: `Annotated[type, metavar, help]`. Without a
    metavar it is a switch. Further strings such as "--set" are the names of the option if it is not
    called like its parameter. Numbers are the smallest and the largest value. An option of a list
    type may be repeated. For keywords, `**settings: Unpack[Settings]`, each item of the `TypedDict`
    is an option. These options follow the parameter `settings_after` in the help. A command that
    draws `pictures` has `--format` and `--dpi`.

    The help lists the command in the group `group`, a key of `GROUPS`. `old` maps former options to
    their current forms: an option (or several), or an argument given by its metavar. The form
    "--hold-out last:F" means that the value is now written behind "last:". The key
    "--out FILE.json" means that values of the option with this ending are old. Excess words after
    the arguments were formerly arguments, and are now values of the option `old_words`.
    """
    if group not in GROUPS:
        raise ValueError(f"there is no group '{group}': use one of {', '.join(GROUPS)}")

    forms = {form: (new,) if isinstance(new, str) else new for form, new in (old or {}).items()}

    def register(function: Function) -> Function:
        # `import` is a keyword of Python: the function is called import_.
        COMMANDS[function.__name__.rstrip("_")] = Registered(
            function, examples, group, settings_after, pictures, forms, old_words
        )
        return function

    return register


def argument(metavar: str, text: str) -> Any:
    """Return a positional argument with its metavar and help text."""
    return typer.Argument(metavar=metavar, help=text)


_Formats = Annotated[
    Texts,
    "FORMAT",
    "Also write the pictures as svg or pdf, and their captions as text.",
    "--format",
]
_Dpi = Annotated[
    int | None,
    "N",
    "Resolution of the pictures in pixels per inch; their captions are also written as text. "
    "[default: 130]",
    30,
    2400,
]

_PLUGINS = Parameter(
    "plugin",
    Parameter.KEYWORD_ONLY,
    default=None,
    annotation=Annotated[
        Paths,
        "FILE.py",
        "Load a plug-in that registers drag or joint laws, wind fields, loss functions, solvers, "
        "sensors or models.",
    ],
)


_PICTURES = [
    Parameter("formats", Parameter.KEYWORD_ONLY, default=None, annotation=_Formats),
    Parameter("dpi", Parameter.KEYWORD_ONLY, default=None, annotation=_Dpi),
]


def with_options(registered: Registered) -> Function:
    """Return the function of a command in the form for typer, with an option per parameter."""
    function, settings_after = registered.function, registered.settings_after
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

    # Such a command only prints if no folder is given and no folder is the default.
    may_only_print = any(
        each.name == "out" and each.default is None and "[default: " not in str(each.annotation)
        for each in parameters
    )
    parameters += [*(_PICTURES if registered.pictures else []), _PLUGINS]

    @functools.wraps(function)
    def whole(
        plugin: Paths = None, formats: Texts = None, dpi: int | None = None, **given: Any
    ) -> None:
        if plugin:
            configure()  # Before the plug-in imports Equinox or creates an array.
        for path in plugin or ():
            load_plugin(path)
        if (formats or dpi) and given.get("figures") is False:
            raise InputError(
                "--format and --dpi have no effect with --no-figures: omit --no-figures, or omit "
                "--format and --dpi"
            )
        if (formats or dpi) and may_only_print and given["out"] is None:
            raise InputError(
                "no picture is written without --out: add --out DIR, or omit --format and --dpi"
            )
        with pictures_as(formats or (), dpi):
            function(**given)

    return with_signature(whole, [_with_option(each) for each in parameters])


def with_signature(function: Function, parameters: Sequence[Parameter]) -> Function:
    """Set the signature of a function to these parameters, and return the function."""
    function.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    function.__annotations__ = {each.name: each.annotation for each in parameters}
    return function


def _with_option(parameter: Parameter) -> Parameter:
    """Return a parameter whose annotation contains the option that its strings describe."""
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


# Check the words for numbers and paths before they are converted.
#
# Python reads `1_0` as ten and accepts digits of every script, which giajax does not.

_WHOLE = re.compile(r"[-+]?[0-9]{1,18}")


def command_of(function: Callable[..., None], registered: Registered) -> type[TyperCommand]:
    """Return a command class that checks numbers and paths by the signature of a function."""
    types = {name: _type_of(hint) for name, hint in get_type_hints(function).items()}

    class Command(TyperCommand):
        def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
            """Translate old forms, check the words, and then convert them."""
            translation = Translation(self, registered, args)
            args = translation.words
            typed = self.make_parser(ctx).parse_args(args=list(args))[0]
            for note in translation.notes:
                typer.echo(note, err=True)
            for name, value in typed.items():
                for word in _words(value):
                    _check(types.get(name), word, name)
            return super().parse_args(ctx, args)

    return Command


# Old forms of options are translated before the words are parsed.


def _named(command: Any) -> dict[str, Any]:
    """Return the options of a command by all of their names."""
    return {
        name: each
        for each in command.params
        for name in (*each.opts, *each.secondary_opts)
        if name.startswith("-")
    }


def _arguments(command: Any) -> list[Any]:
    return [each for each in command.params if not each.opts[0].startswith("-")]


def _shown(form: str, options: Mapping[str, Any]) -> str:
    """Return an option with its metavar, if it has one; an argument is its own metavar."""
    metavar = options[form].metavar if form in options else None
    return f"{form} {metavar}" if metavar else form


def old_forms(command: Any, registered: Registered) -> dict[str, tuple[str, str]]:
    """Return the old command lines of a command, each with its current form.

    The keys are those of `Registered.old`, and "" for words that have become values of an option.
    """
    options, pairs = _named(command), {}
    if words := registered.old_words:
        places = [each.metavar for each in _arguments(command)]
        pairs[""] = [*places, options[words].metavar], [*places, _shown(words, options)]
    for form, news in registered.old.items():
        # An option that has become an argument is shown with the metavar of the argument, and one
        # whose value has a new beginning with the rest of the value.
        metavars = [
            options[new].metavar if new in options else re.split("[ :]", new)[-1]
            for new in news[:1]
        ]
        was = [form] if " " in form else [form, *filter(None, metavars)]
        pairs[form] = was, [_shown(new, options) for new in news]
    return {
        form: (" ".join(["giajax", command.name, *old]), " ".join(["giajax", command.name, *now]))
        for form, (old, now) in pairs.items()
    }


class Translation:
    """The words of a command line, with its old forms translated.

    Attributes:
        words: current form of the words.
        notes: one line of text for each old form.

    Raises:
        InputError: an old form is given together with the new one.
    """

    def __init__(self, command: Any, registered: Registered, typed: Sequence[str]) -> None:
        self.words: list[str] = []
        self._behind: list[str] = []  # Words after "--", which are not options.
        self._registered, self._options = registered, _named(command)
        counts = (each.nargs if each.nargs > 0 else len(typed) for each in _arguments(command))
        self._places = sum(counts)  # Number of arguments that are still missing.
        self._given: set[str] = set()
        self._moved: dict[str, str] = {}  # Values of options that are now arguments, by metavar.
        self._found: dict[str, tuple[str, ...]] = {}  # Old forms and their current forms.
        left = list(typed)
        while left:
            word = left.pop(0)
            name, equals, value = word.partition("=")
            if word == "--":
                for each in left:
                    self._argument(each, self._behind)
                break
            if not name.startswith("-") or name == "-":
                self._argument(word, self.words)
            elif name in registered.old:
                self._old_option(name, equals + value, left)
            else:
                self._option(word, name, left)
        for value in self._moved.values():
            (self._behind if value.startswith("-") else self.words).append(value)
        self.words += ["--", *self._behind] if self._behind else []
        forms = old_forms(command, registered)
        for form, news in self._found.items():
            for new in self._given.intersection(new.partition(" ")[0] for new in news):
                old, now = forms[form]
                many = "" if form else f"{shown(self._word)} is an unexpected argument; "
                raise InputError(
                    f"{many}{old} is now {now}, but {new} is also given: omit one of them"
                )
        self.notes = [
            f"note: {old} is now {now}; the old form works until {OLD_FORMS_END}"
            for old, now in map(forms.__getitem__, self._found)
        ]
        if "--quiet" in self._given:
            self.notes = []

    def _argument(self, word: str, words: list[str]) -> None:
        """Handle a word that is not an option; excess words may be an old form."""
        option = self._registered.old_words
        self._places -= 1
        if self._places >= 0 or not option:
            words.append(word)
            return
        if "" in self._found and not self._options[option].multiple:
            words.append(word)  # The option takes one value only: typer reports this excess word.
            return
        self._found[""], self._word = (option,), word
        self.words += [option, word]

    def _old_option(self, name: str, value: str, left: list[str]) -> None:
        """Translate an option that has another name now, or has become an argument."""
        news = self._found[name] = self._registered.old[name]
        if all(new in self._options and self._options[new].is_flag for new in news):
            self.words += [new + value for new in news]
            return
        values = [value[1:]] if value else left[:1]
        del left[: 0 if value else 1]
        for new in news if values else news[:1]:
            option, _, form = new.partition(" ")
            if option in self._options:
                beginning = form[: form.rfind(":") + 1]
                self.words += [option, *(beginning + each for each in values)]
            elif values:  # The last one is used, as for any repeated option.
                self._places -= new not in self._moved
                self._moved[new] = values[0]

    def _option(self, word: str, name: str, left: list[str]) -> None:
        """Handle a current option, whose value may have an old file ending."""
        self._given.add(name)
        self.words.append(word)
        if name not in self._options or self._options[name].is_flag:
            return
        value = word.partition("=")[2]
        if "=" not in word:
            value = left[0] if left else ""
            self.words += left[:1]
            del left[:1]
        for form in self._registered.old:
            option, _, old_value = form.partition(" ")
            if old_value and option == name and value.lower().endswith(Path(old_value).suffix):
                self._found[form] = ()


def _type_of(hint: Any) -> Any:
    """Return `int`, `float` or `Path` of an annotation, also if it is a list or optional."""
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
        raise InputError(f"{option} is {shown(word)}: give a whole number, such as 10")
    elif of is float and number(word) is None:
        raise InputError(f"{option} is {shown(word)}: give a number, such as 0.5")


BAD_INPUT = 2
BROKEN = 4
BROKEN_PIPE = 141

# Typer bundles click from about version 0.16 on, and used the installed click before. The error
# that is raised for a wrong option is a base class of its BadParameter in both cases.
UsageError: Any = typer.BadParameter.__mro__[1]


class Ended(Exception):  # noqa: N818
    """Stop of a command from outside, with the exit status that reports it."""

    def __init__(self, status: int) -> None:
        super().__init__(status)
        self.status = status


class Commands(TyperGroup):
    """Typer's group, but Ctrl-C and closed pipes are handled by giajax."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Parse the words; without this method typer would handle Ctrl-C itself."""
        with _endings():
            return super().make_context(*args, **kwargs)

    def invoke(self, ctx: Any) -> Any:
        """Run the command of the context."""
        with _endings():
            return super().invoke(ctx)

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write a section for each group, with aligned summaries."""
        names = self.list_commands(ctx)
        longest = max(map(len, names))
        for group, title in GROUPS.items():
            rows = [
                (name.ljust(longest), self.commands[name].get_short_help_str(limit=1000))
                for name in names
                if COMMANDS[name].group == group
            ]
            with formatter.section(title):
                formatter.write_dl(rows)


@contextlib.contextmanager
def _endings() -> Iterator[None]:
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise Ended(stopped_status()) from None


_CONTROL = re.compile(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]")


class Output:
    """Standard output or error of a command, which continues after an output error.

    Control characters, such as those in text from files, are escaped, so that they do not control
    the terminal. After a closed pipe or a full disk all further output is discarded; `error` is the
    cause.
    """

    def __init__(self, stream: Any) -> None:
        self._stream = stream
        self.error: OSError | None = None

    def write(self, text: str) -> int:
        """Write a text, if possible."""
        shown = _CONTROL.sub(lambda one: f"\\x{ord(one[0]):02x}", text)
        self._tried(self._stream.write, shown)
        return len(text)

    def flush(self) -> None:
        """Flush the stream, if possible."""
        self._tried(self._stream.flush)

    def _tried(self, function: Callable[..., Any], *arguments: Any) -> None:
        if self.error is not None:
            return
        try:
            function(*arguments)
        except OSError as error:
            self.error = error
            # Python flushes the stream again at exit: redirect it to the null device.
            with contextlib.suppress(OSError):
                os.dup2(os.open(os.devnull, os.O_WRONLY), self._stream.fileno())

    def __getattr__(self, name: str) -> Any:
        if name == "buffer":  # Click would bypass this object with it.
            raise AttributeError(name)
        return getattr(self._stream, name)


def run(command: Any, arguments: list[str]) -> int:
    """Run the command line, and report every error as one line on standard error.

    The exit status is 0 or the status of the command's `typer.Exit(status)`. It is 2 for bad input
    or usage. It is 4 for any other error, whose traceback is in a file, or if standard output
    cannot be written. It is 129, 130 or 143 after a signal, and 141 if standard output is closed
    early.
    """
    out, err = Output(sys.stdout), Output(sys.stderr)
    with contextlib.redirect_stdout(cast(Any, out)), contextlib.redirect_stderr(cast(Any, err)):
        status = _ended(command, arguments)
        out.flush()
        if isinstance(out.error, BrokenPipeError):
            return status or BROKEN_PIPE
        if out.error is not None:
            _say(
                f"standard output cannot be written to ({out.error.strerror}): the rest of the "
                "output is lost, but all files that were written are complete",
                BROKEN,
            )
            return status or BROKEN
    return status


def _ended(command: Any, arguments: list[str]) -> int:
    """Run the command line and return the exit status."""
    try:
        with _endings():
            result = command.main(args=arguments, prog_name="giajax", standalone_mode=False)
    except InputError as error:
        return _say(str(error), BAD_INPUT)
    except UsageError as error:
        return _say(_usage(error), BAD_INPUT)
    except Ended as ended:
        return _say("interrupted", ended.status)
    except SystemExit as error:
        why = f"a plug-in ended the program (SystemExit: {error.code})"
        return _say(f"{why}: raise an exception with a message in the plug-in", BAD_INPUT)
    except (KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # Polars' PanicException is not an Exception.
        if is_stopped():  # A foreign library may convert the exception of the signal.
            return _say("interrupted", stopped_status())
        if isinstance(error, OSError) and isinstance(error.filename, str):
            # The name is too long, another program removed the file, or a disk failed.
            why = f"{error.filename} cannot be used ({error.strerror})"
            return _say(
                f"{why}: give another path, or correct the path in the file that contains it",
                BAD_INPUT,
            )
        return _say(_unexpected(error, arguments), BROKEN)
    # In this mode typer returns the status of `typer.Exit`, else the result of the command.
    return result if isinstance(result, int) else 0


def _unexpected(error: BaseException, arguments: list[str]) -> str:
    """Write the traceback of an unexpected error to a file, and return a sentence."""
    from importlib.metadata import version

    what = f"internal error ({error_in_words(error)})"
    trace = "".join(traceback.format_exception(error))
    try:
        handle, path = tempfile.mkstemp(prefix="giajax-", suffix=".txt")
        with open(handle, "w", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"giajax {version('giajax')} {shlex.join(arguments)}\n\n{trace}")
    except OSError as full:
        print(trace, end="", file=sys.stderr)
        why = f"which cannot be written to a file ({full.strerror})"
        return f"{what}: report it with the traceback above, {why}"
    return f"{what}: report it with {path}, which contains the traceback"


def _say(sentence: str, status: int) -> int:
    print(f"giajax: {abridged(' '.join(sentence.split()))}", file=sys.stderr)
    return status


def _usage(error: Any) -> str:
    sentence = " ".join(error.format_message().split()).rstrip(".")
    # Click writes two sentences if it has a suggestion, each with a capital letter.
    sentence = re.sub(r"(^|\. )([A-Z])", lambda m: (m[1] and ": ") + m[2].lower(), sentence)
    command = error.ctx.command_path if error.ctx is not None else "giajax"
    return f"{sentence}; '{command} --help' lists the options"


# Options that several commands share.


def print_table(headings: Sequence[str], rows: Sequence[Sequence[Any]], *, left: int = 1) -> None:
    """Print a table without rules; all columns but the first `left` are aligned to the right.

    Floats have 5 significant digits, and None is printed as `-`. Empty headings are left out. If
    standard output is not a terminal nothing is wrapped: each row is one line, for grep and awk.
    """
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    cells = [[_cell(value) for value in row] for row in rows]
    shown = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(headings))
    least = narrowest(headings, cells)
    for position, (heading, (width, wraps)) in enumerate(zip(headings, least, strict=True)):
        about: Any = {"justify": "left" if position < left else "right", "no_wrap": not wraps}
        shown.add_column(Text(heading), min_width=width, **about)
    for row in cells:
        shown.add_row(*map(Text, row))
    # Text from files must not control the terminal, so this console emits no control codes at all.
    console = Console(highlight=False, color_system=None)
    if console.is_terminal:
        # A truncated name or number cannot be copied: allow a long line instead.
        console.width = max(console.width, sum(width + 2 for width, _ in least))
        console.print(shown)
        return
    wide = Console(highlight=False, width=10_000, color_system=None)
    with wide.capture() as captured:
        wide.print(shown)
    print("\n".join(line.rstrip() for line in captured.get().splitlines()))


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    return f"{value:.5g}" if isinstance(value, float) else str(value)


Browser = Annotated[bool, "Open the page in a browser, or only print its address."]
Digits = Annotated[int, "N", "Number of significant digits in the output files.", 3, 17]
Figures = Annotated[bool, "Draw figures of the result."]
Folder = Annotated[Path | None, "DIR", "Folder in which each finished task is stored."]
Force = Annotated[bool, "Overwrite existing files."]
HoldOut = Annotated[
    Texts,
    "NAME",
    "Hold out a run, a channel, or the last part of each run (last for a fifth, last:0.3 for "
    "30 %).",
]
Host = Annotated[str, "ADDRESS", "Address on which the server listens; 0.0.0.0 for all interfaces."]
Json = Annotated[bool, "--json", "Print JSON instead of tables."]
Links = Annotated[int | None, "N", "Number of links."]
Missing = Annotated[float, "PERCENT", "Percentage of missing samples in each channel."]
Noise = Annotated[
    Texts, "KEY=VALUE", "Standard deviation of the white noise for KEY, a key of [noise]."
]
OnlyChannels = Annotated[Texts, "CHANNEL", "Use only this channel, named without the unit."]
Port = Annotated[int, "N", "Port of the server; 0 for any free port."]
Quiet = Annotated[bool, "Print errors only."]
Replayed = Annotated[Path | None, "FILE", "Use the commands and the wind of this run."]
RunModel = Annotated[Path | None, "MODEL", "Model; see below. [default: the model of the run]"]
Scenarios = Annotated[int, "N", "Number of random draws of the uncertain parameters.", 0]
Settings = Annotated[Texts, "PATH=VALUE", "Value of a parameter in SI units.", "--set"]
Solver = Annotated[str, "NAME", "Integration method, such as tsit5 or springs5."]
Tolerance = Annotated[float, "TOL", "Tolerance of the numerical integration."]
ToRun = Annotated[Path, "RUN.csv", "Output file for the run."]
Wind = Annotated[str | None, "X,Y,Z", "Mean wind velocity (m/s)."]

Step = Annotated[
    Texts, "JOINT=DEG[@T]", "Step change of the commanded angle of a joint. [default: @0.5]"
]
Ramp = Annotated[
    Texts,
    "JOINT=DEG[@START:DURATION]",
    "Linear change of the commanded angle of a joint. [default: @0.5:1]",
]
Renamed = Annotated[Texts, "OLD=NEW", "Read column OLD of the files as column NEW."]

Cores = Annotated[
    int | None,
    typer.Option(
        metavar="N", min=1, envvar=CORES_VARIABLE, help="Number of cores to use. [default: all]"
    ),
]


def write_folder(out: Path, contents: Mapping[str, bytes], *, force: bool) -> None:
    """Write files by name into a folder, which is created if necessary."""
    from ..recordings import make_folder, write_files

    make_folder(out)
    write_files({out / name: content for name, content in contents.items()}, force=force)


def terminal_width() -> int | None:
    """Return the columns of the terminal; None without a terminal, so that rows are not wrapped."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def say_written(out: Path, names: Iterable[str]) -> None:
    """Print which files of a folder were written."""
    where = "" if out == Path() else f"{shlex.quote(str(out))}: "
    wrote, width = f"wrote {where}{', '.join(all_pictures(names))}", terminal_width()
    if width is not None:
        wrapper = textwrap.TextWrapper(width, subsequent_indent="  ", break_on_hyphens=False)
        wrote = wrapper.fill(wrote)
    typer.echo(f"\n{wrote}")


def command_after(*words: str | Path) -> str:
    """Return the suggested next command as it would be typed, with the user's own paths."""
    return f"next: giajax {shlex.join(map(str, words))}"


@contextlib.contextmanager
def failed_simulation(options: str) -> Iterator[None]:
    """Report a failed simulation with the options that may help, and end the command."""
    from ..simulation import SimulationError

    try:
        yield
    except SimulationError as error:
        typer.echo(f"giajax: {error}{options}", err=True)
        raise typer.Exit(1) from None


def check_quiet(quiet: bool, *, written: Any, as_json: bool = False, by: str) -> None:
    """Raise an error if a command would neither print nor write its results."""
    if quiet and written is None and not as_json:
        raise InputError(f"--quiet suppresses all tables, and no output file is given: add {by}")


def say_progress(quiet: bool) -> Callable[[str], None] | None:
    """Return a function that prints a line on standard error; None if quiet."""
    return None if quiet else (lambda text: typer.echo(text, err=True))


def say_served(page: Any, whoever: str, end: str, *, browser: bool, quiet: bool) -> None:
    """Print the address of a page, what others can do with the address, and how to end it."""
    from ..apps.viewer import open_in_browser

    if not quiet:
        typer.echo(f"open {page.address}")
        if page.is_open:
            typer.echo(f"anyone with this address {whoever}, even from another machine")
        typer.echo(f"Ctrl-C {end}")
    if browser:
        open_in_browser(page.address)


_ONLY_WHERE = ("out", "to", "page", "force", "quiet", "as_json", "formats", "dpi")


def origin(context: typer.Context) -> str:
    """Return the command line without options that only specify where to write."""
    from importlib.metadata import version

    words = [f"giajax {version('giajax')} {context.command.name}"]
    for parameter in context.command.params:
        value = context.params.get(parameter.name or "")
        if parameter.name in _ONLY_WHERE or value in (None, [], (), parameter.default):
            continue
        if isinstance(value, bool):
            words += (parameter.opts if value else parameter.secondary_opts)[:1]
            continue
        items = value if isinstance(value, list | tuple) else [value]
        for item in items:
            shown = f"{item:.15g}" if isinstance(item, float) else str(item)
            # An argument has a position and no name.
            option = [parameter.opts[0]] if parameter.opts[0].startswith("-") else []
            words.append(" ".join([*option, shlex.quote(shown)]))
    return " ".join(words)


Workers = Annotated[int | None, "N", "Number of worker processes on this machine. [default: 1]", 1]

Scheduler = Annotated[
    str | None, "ADDRESS", "Address of a dask.distributed cluster, such as tcp://host:8786."
]

STARTS = "starts"  # Folder with a file for each start that workers fit, beside the journal.

# Interval between lines; the first tasks include compilation, so no time is estimated from them.
_BETWEEN_S = 5.0
_LEAST = 2


def end_if_stopped(folder: Path | None) -> None:
    """End a command that was stopped after it has written its results, and say how to continue.

    The finished tasks were stored in the folder, if one is given.
    """
    if is_stopped():
        how = "with --force" if folder is not None else "with --folder DIR and --force"
        typer.echo(f"giajax: stopped: run the same command {how} to continue", err=True)
        raise typer.Exit(stopped_status())


@contextlib.contextmanager
def workers_of_starts(
    workers: int | None, scheduler: str | None, starts: int, out: Path
) -> Iterator[dict[str, Any]]:
    """Provide the executor for the starts of a fit, as arguments of `Preparation.run`.

    There are no arguments if threads fit the starts. The folder of the result, `out`, contains a
    file for each start until all of them are done.
    """
    if workers is None and scheduler is None:
        yield {}
        return
    if starts < 2:
        raise InputError(
            "a fit from a single initial guess uses only one process: add --starts N, or omit "
            "--workers and --scheduler"
        )
    from ..runtime.execution import open_executor

    with open_executor(workers, scheduler) as executor:
        yield {"executor": executor, "folder": out / STARTS}


def forget_starts(out: Path) -> None:
    """Remove the files of the starts after their result is written."""
    for path in (out / STARTS).glob("*.json"):
        path.unlink(missing_ok=True)
    with contextlib.suppress(OSError):  # The folder does not exist, or contains other files.
        (out / STARTS).rmdir()


class ManyProgress:
    """Progress of `run_tasks`, whose tasks are called `what`, on standard error."""

    def __init__(self, what: str) -> None:
        self._what = what
        self._first: tuple[int, float] | None = None
        self._said = self._began = time.monotonic()
        self._failed = 0
        self._ended = False

    def __call__(self, outcome: "Outcome", done: int, total: int) -> None:
        self._failed += outcome.status == "failed"
        if self._first is None and done > 1:
            typer.echo(f"{done - 1} of {total} {self._what} are already done", err=True)
        self.after(done, total)

    def after(self, done: int, total: int) -> None:
        """Print how many tasks are done, and how long the others will take."""
        now = time.monotonic()
        if self._first is None:
            # The first task compiles the programs that the others share.
            self._first = done, now
        if self._ended or (done < total and now - self._said < _BETWEEN_S):
            return
        self._said, self._ended = now, done == total
        words = f"{done} of {total} {self._what} done"
        if self._failed:
            words += f", {self._failed} of them failed"
        first, began = self._first
        if done == total:
            words += f", in {time_in_words(now - self._began)}"
        elif done - first >= _LEAST:
            left = (now - began) / (done - first) * (total - done)
            words += f", about {time_in_words(left)} left"
        typer.echo(words, err=True)
