"""Formatting of sentences and numbers, and the error for invalid input."""

import abc
import contextlib
import html
import inspect
import json
import math
import re
import shlex
import sys
import textwrap
import traceback
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any, ClassVar, TypeVar, get_args

if TYPE_CHECKING:
    import rich.table

Function = TypeVar("Function", bound=Callable[..., Any])

# Number of digits of a value without a standard error.
_DIGITS = 6
# Smaller numbers are written with an exponent, because many leading zeros are hard to count.
_LEAST_FIXED = 1e-4


def format_estimate(value: Any, standard_error: float | None) -> tuple[str, str]:
    """Format a value and its standard error with the significant digits.

    The error has two significant digits and the value ends at the same decimal place.

    Example:
        >>> format_estimate(1.0496623, 0.0060814)
        ('1.0497', '0.0061')
    """
    if value is None:
        return "-", "-"
    if isinstance(value, list):
        low, high = min(value), max(value)
        text = f"{low:.{_DIGITS}g}"
        return (text if low == high else f"{text} .. {high:.{_DIGITS}g}"), "-"
    if standard_error is None or not math.isfinite(standard_error) or standard_error <= 0:
        return f"{value:.{_DIGITS}g}", "-"
    # The exponent is taken from the rounded error, so that 0.0999 becomes 0.10 rather than 0.100.
    exponent = int(f"{standard_error:.1e}".partition("e")[2])
    decimals = 1 - exponent
    if max(abs(value), standard_error) >= _LEAST_FIXED and -4 <= decimals <= 7:
        places = max(decimals, 0)
        return (
            f"{round(value, decimals) + 0.0:.{places}f}",  # never -0
            f"{round(standard_error, decimals):.{places}f}",
        )
    digits = 0 if value == 0 else math.floor(math.log10(abs(value))) - exponent + 1
    return f"{value:.{min(max(digits, 0), 15)}e}", f"{standard_error:.1e}"


def format_number(value: float | None, digits: str = ".5g", missing: str = "-") -> str:
    """Format a number with the given digits, or return a word if there is none."""
    return missing if value is None else f"{value:{digits}}"


def format_range(
    ends: Sequence[float | None] | None, error: float | None = None, factor: float = 1.0
) -> str:
    """Format the ends of an interval times a factor: `open` for a missing end, a dash for None.

    With a standard error, the ends have the decimal places of `format_estimate`, otherwise 5
    significant digits.

    Example:
        >>> format_range((0.25, None), factor=2.0), format_range((1.0867, 1.133), 0.012)
        ('0.5 .. open', '1.087 .. 1.133')
    """
    if ends is None:
        return "-"

    def shown(end: float) -> str:
        value, known = format_estimate(end, error)
        return format_number(end) if known == "-" else value

    return " .. ".join("open" if end is None else shown(end * factor) for end in ends)


def format_bounds(lower: float | None, upper: float | None) -> str:
    """Format the bounds of a value; a dash if it has none."""
    if lower is None and upper is None:
        return "-"
    if upper is None:
        return f"> {lower:g}"
    return f"< {upper:g}" if lower is None else f"{lower:g} .. {upper:g}"


def time_in_words(seconds: float) -> str:
    """Format a duration with a suitable unit.

    Example:
        >>> time_in_words(45.2), time_in_words(600.0), time_in_words(5400.0)
        ('45 s', '10 min', '1.5 h')
    """
    for unit, length in (("h", 3600.0), ("min", 60.0)):
        if seconds >= length:
            return f"{seconds / length:.2g} {unit}"
    return f"{seconds:.2g} s"


def wrapped(text: str, width: int | None, first: str, others: str) -> Sequence[str]:
    """Wrap a text, with prefixes for the first and the other lines; an empty text has no lines.

    Without a width the text is not wrapped.
    """
    if not text:
        return []
    if width is None:
        return [first + text]
    return textwrap.wrap(
        text,
        width=max(width, len(others) + 20),
        initial_indent=first,
        subsequent_indent=others,
        break_long_words=False,
        break_on_hyphens=False,
    )


def one_of(names: Iterable[Any]) -> str:
    """Join names: `a`, `a or b`, `a, b or c`."""
    listed = [str(name) for name in names]
    if len(listed) < 2:
        return "".join(listed)
    return f"{', '.join(listed[:-1])} or {listed[-1]}"


def shown(value: Any, longest: int = 60) -> str:
    """Return a value much as its author wrote it, shortened to one line."""
    if isinstance(value, str | bytes):
        value = value[: longest + 1]  # sufficient to detect that it is too long
    text = repr(value) if not isinstance(value, bool) else str(value).lower()
    return text if len(text) <= longest else f"{text[: longest - 3]}..."


def with_run_column(
    headings: Sequence[str], rows: Sequence[Sequence[str]]
) -> tuple[list[str], list[list[str]]]:
    """Split names such as `offset of 'a'` into a parameter and a column `run`, if there are any.

    The parameter can then be pasted behind an option such as `--free`.

    Example:
        >>> with_run_column(("name", "value"), [("gain", "2"), ("offset of 'a', 'b'", "1")])
        (['name', 'run', 'value'], [['gain', 'all', '2'], ['offset', 'a, b', '1']])
    """
    names = [row[0].partition(" of ") for row in rows]
    if not any(runs for _, _, runs in names):
        return list(headings), list(map(list, rows))
    return [headings[0], "run", *headings[1:]], [
        [path, runs.strip("'").replace("', '", ", ") or "all", *row[1:]]
        for (path, _, runs), row in zip(names, rows, strict=True)
    ]


class ShownAsTable:
    """Base of objects that notebooks and `rich` show as a table; markup in it is plain text."""

    _most_rows: ClassVar[int | None] = 24  # more rows would be hard to read

    @abc.abstractmethod
    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        """Return the title, the headings, which may all be empty, and the rows."""

    def _few(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        try:
            title, headings, rows = self._table()
        except Exception:
            # A notebook must also show a batch of arms, an incomplete arm, or an arm without
            # numbers.
            return type(self).__name__, ("",), [(repr(self),)]
        rest = 0 if self._most_rows is None else len(rows) - self._most_rows
        return title, headings, [*rows[: self._most_rows], *([(f"{rest} more",)] * (rest > 0))]

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows."""
        title, headings, rows = self._few()

        def line(cells: Sequence[str], tag: str) -> str:
            return f"<tr>{''.join(f'<{tag}>{html.escape(cell)}</{tag}>' for cell in cells)}</tr>"

        head = f"<thead>{line(headings, 'th')}</thead>" if any(headings) else ""
        body = "".join(line(cells, "td") for cells in rows)
        return f"<p>{html.escape(title)}</p><table>{head}<tbody>{body}</tbody></table>"

    def __rich__(self) -> "rich.table.Table":
        """Return the table that `rich.print` shows."""
        from rich.table import Table
        from rich.text import Text

        title, headings, rows = self._few()
        table = Table(title=Text(title), show_header=any(headings))
        for heading, (width, wraps) in zip(headings, narrowest(headings, rows), strict=True):
            table.add_column(heading, min_width=width, no_wrap=not wraps)
        for cells in rows:
            table.add_row(*map(Text, cells))
        return table


# A longer cell is text that may be wrapped.
_SENTENCE = 24


def narrowest(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> list[tuple[int, bool]]:
    """Return the minimum width of each column of a table, and whether the column wraps."""
    columns = zip(headings, *(row for row in rows if len(row) == len(headings)), strict=True)
    found = []
    for column in columns:
        words = [len(word) for cell in column for word in cell.split()]
        longest = max(map(len, column))
        wraps = longest > max(_SENTENCE, *words, 0)
        found.append((max(words, default=0) if wraps else longest, wraps))
    return found


def install_command(extra: str) -> str:
    """Return the command that installs an extra of the running giajax.

    For an installation from a checkout, the command contains its folder, because no package index
    need provide giajax.
    """
    # Imported here because they are slow to import and rarely needed.
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    plain = f"pip install 'giajax[{extra}]'"
    try:
        origin = json.loads(distribution("giajax").read_text("direct_url.json") or "{}")
    except (PackageNotFoundError, ValueError):
        return plain
    folder = Path(url2pathname(urlsplit(origin.get("url", "")).path))
    if "dir_info" not in origin or not (folder / "pyproject.toml").is_file():
        return plain
    editable = "-e " if origin["dir_info"].get("editable") else ""
    python, where = shlex.quote(sys.executable), shlex.quote(f"{folder}[{extra}]")
    return f"{python} -m pip install {editable}{where}"


# Lengths that are sufficient for the path of a deep folder and for a sentence with a list.
_LONGEST_WORD = 300
_LONGEST_SENTENCE = 2_000


def abridged(sentence: str) -> str:
    """Shorten a sentence by omitting the middle of very long words or of the sentence itself.

    An invalid name or number in a file may have a megabyte. The beginning identifies it and the end
    contains the remedy.
    """
    if len(sentence) <= _LONGEST_WORD:
        return sentence
    words = re.sub(rf"\S{{{_LONGEST_WORD},}}", lambda word: _without_middle(word[0], 60), sentence)
    return words if len(words) <= _LONGEST_SENTENCE else _without_middle(words, 400)


def _without_middle(text: str, each: int) -> str:
    return f"{text[:each]}...{text[-each:]}"


def error_in_words(error: BaseException) -> str:
    """Describe an error other than an `InputError` on one line: type, location and reason."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({PurePath(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return abridged(" ".join(f"{type(error).__name__}{where}: {error}".split()))


class InputError(ValueError):
    """The input cannot be used.

    The message is one sentence: what is wrong and, after a colon, what to do. The command line
    prints it without a traceback and exits with status 2. Very long quotes of the input are
    shortened.
    """

    def __init__(self, sentence: str) -> None:
        super().__init__(abridged(sentence))


@contextlib.contextmanager
def tried(what: str) -> Iterator[None]:
    """Run user code such that an exception in it becomes an `InputError` that names the code."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        said = ": ".join([type(error).__name__, *str(error).splitlines()[:1]])
        raise InputError(f"{what} fails ({said}): correct it") from error


__version__: str


def __getattr__(name: str) -> str:
    if name != "__version__":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib.metadata import version  # slow to import, and rarely needed

    return version("giajax")


def keywords_listed(defaults: Mapping[str, Any] | None = None) -> Callable[[Function], Function]:
    """List each keyword of an `Unpack` argument in a function's signature, with these defaults."""

    def listed(function: Function) -> Function:
        signature = inspect.signature(function)
        *stated, rest = signature.parameters.values()
        (keywords,) = get_args(rest.annotation)
        stated += [
            rest.replace(
                name=name,
                kind=rest.KEYWORD_ONLY,
                default=(defaults or {}).get(name),
                annotation=annotation,
            )
            for name, annotation in keywords.__annotations__.items()
        ]
        function.__signature__ = signature.replace(parameters=stated)  # type: ignore[attr-defined]
        return function

    return listed
