"""Pages for a browser, and checks that the required libraries are installed."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from ..fitting import FitResult
from ..recordings import Run
from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.pictures import SIGNATURE
from ..runtime.text import InputError, install_command
from ..studies import Contrast
from ._views import Table

_NEEDED = ("bokeh", "jinja2")


def check_page(path: str | Path | None = None, *, force: bool = False) -> None:
    """Refuse a page that cannot be written, before anything is computed.

    Arguments:
        path: path of the page; an existing giajax page is overwritten.
        force: overwrite any file.

    Raises:
        InputError: the required libraries are not installed, the path is a folder, or (without
            `force`) the file is not a giajax page or cannot be read.
    """
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"a report page requires {' and '.join(missing)}, which must be installed: "
            f"{install_command('report')}"
        )
    if path is None:
        return
    if Path(path).is_dir():
        raise InputError(
            f"{path} is a folder, but the page must be written to this path: move the folder"
        )
    if force or not Path(path).exists():
        return
    remedy = "move it, or give --force to overwrite it"
    try:
        beginning = read_bytes(Path(path), RESULT_BYTES)[:200]
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): {remedy}") from None
    if SIGNATURE.encode() not in beginning:
        raise InputError(f"{path} was not made by giajax: {remedy}")


def report_page(
    result: FitResult,
    runs: Sequence[Run],
    *,
    held_out: Sequence[Run] = (),
    source: str | Path | None = None,
) -> bytes:
    """Return a result as one HTML file below 5 MB that opens without a network connection.

    The verdict comes first, followed by the parameters, their limitations, plots and provenance. A
    model with visible parts is animated, which may require its simulation and compilation.

    Arguments:
        runs: the fitted runs, in the same order; `held_out` contains their held-out parts.
        source: path of `result.json`, from which the page derives how to repeat the fit.

    Raises:
        InputError: the required libraries are not installed, or the runs are not those of the
            result.

    Example:
        >>> page = report_page(result, [run])  # doctest: +SKIP
        >>> Path("report.html").write_bytes(page)  # doctest: +SKIP
    """
    check_page()
    from . import page

    where = None if source is None else Path(source)
    return page.report_page(result, runs, held_out=held_out, source=where)


def compare_page(found: Contrast, results: Sequence[FitResult]) -> bytes:
    """Return a comparison of results as one HTML file that opens without a network connection.

    `found` comes from `giajax.studies.contrast` and has the same order.

    Raises:
        InputError: the required libraries are not installed.
    """
    check_page()
    from . import page

    return page.compare_page(found, results)


def study_page(
    *,
    title: str,
    kind: str,
    grade: str,
    headline: str,
    notes: Sequence[str],
    tables: Sequence[tuple[str, Table, str]],
    pictures: Sequence[tuple[str, bytes, str]],
) -> bytes:
    """Return a verdict, tables and pictures as one HTML file that needs no network connection.

    Arguments:
        title, kind: title of the page, and the command that made it.
        grade: "good" or "doubtful", which determines the colour of the verdict.
        headline, notes: the verdict, and sentences below it.
        tables: tables, each with a heading and a note.
        pictures: PNG files, each with a heading and a description.

    Raises:
        InputError: the required libraries are not installed.
    """
    check_page()
    from . import page
    from ._style import as_data  # imports matplotlib

    return page.study_page(
        title=title,
        kind=kind,
        grade=grade,
        headline=headline,
        notes=list(notes),
        tables=list(tables),
        pictures=[(heading, as_data(content), words) for heading, content, words in pictures],
    )
