"""What a person sees at the end of `giajax fit`: the result, then its files."""

import shutil
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from .._errors import InputError

if TYPE_CHECKING:
    from ..fitting import FitResult
    from ..runs import Definition


def write_or_print(result: "FitResult", write: Callable[[], list[Path]]) -> list[Path]:
    """What `write` writes; where it cannot (a full disk), the result goes to standard output.

    Where that cannot take it either, such as a file on the same disk, it goes to standard error.
    """
    try:
        try:
            return write()
        except KeyboardInterrupt:  # once more, because this is what the fit was for
            write()
            raise
    except InputError:
        for stream in (sys.stdout, sys.stderr):
            try:
                print(result.to_json(), end="", file=stream, flush=True)
            except OSError:
                continue
            break
        typer.echo("the fit is above, because its files could not all be written:", err=True)
        raise


def _width() -> int | None:
    """Columns of the terminal; None where no person reads, so that a row is a line for grep."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def show_result(result: "FitResult", definition: "Definition") -> None:
    """Print the estimates, the summary and the figures to reach."""
    from ..report import parameter_table, reached, summary

    width = _width()
    print(parameter_table(result, width))
    print()
    print(summary(result, width))
    figures = reached(result, definition)
    if figures:
        print()
    for figure in figures:
        print(f"{'reached' if figure.reached else 'MISSED':<9}{figure.path} {figure.sentence}")
    sys.stdout.flush()


def show_diagnosis(result: "FitResult") -> None:
    """Print the first suspects, and what stated uncertainties of held numbers do."""
    from ..report import SUSPECT_HEADINGS, first_suspects, systematic_table
    from ._output import print_table

    if rows := first_suspects(result):
        print("\nwhat the residuals ask for (giajax suspects shows all of it):")
        print_table(SUSPECT_HEADINGS, rows)
    if any(error.stated for error in result.systematic):
        print("\nwhat a held number moves, in standard errors:")
        print_table(*systematic_table(result))


def show_files(files: list[Path]) -> None:
    """Print where the files are."""
    width = _width()
    print()
    wrote = f"wrote {files[0].parent}: {', '.join(path.name for path in files)}"
    print(wrote if width is None else textwrap.fill(wrote, width, subsequent_indent="  "))
