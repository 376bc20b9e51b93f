"""Pages for a browser, and whether what draws them is installed."""

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
    """Refuse a page that cannot be made, before anything is computed.

    Arguments:
        path: where a fit is to write it; a page that giajax made there is written over.
        force: write over any file.

    Raises:
        InputError: what draws it is not installed, there is a folder of this name, or (without
            `force`) the file is someone's own or cannot be read.
    """
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise InputError(
            f"a page needs {' and '.join(missing)}, which must be installed: "
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
    """A result as one HTML file, below 5 MB, that opens without a network.

    The verdict comes first, then the parameters, what limits them, plots and provenance. A model
    of which something is seen moves; it may be simulated and compiled for that.

    Arguments:
        runs: those that were fitted, in the same order; `held_out` is what was held out of them.
        source: the `result.json`, from which the page says how to fit it again.

    Raises:
        InputError: what draws it is not installed, or other runs than those of the result.

    Example:
        >>> page = report_page(result, [run])  # doctest: +SKIP
        >>> Path("report.html").write_bytes(page)  # doctest: +SKIP
    """
    check_page()
    from . import page

    where = None if source is None else Path(source)
    return page.report_page(result, runs, held_out=held_out, source=where)


def compare_page(found: Contrast, results: Sequence[FitResult]) -> bytes:
    """Results side by side as one HTML file that opens without a network.

    `found` is what `giajax.studies.contrast` says of them, in the same order.

    Raises:
        InputError: what draws it is not installed.
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
    """A verdict, tables and pictures as one HTML file that opens without a network.

    Arguments:
        title, kind: of the page, and what made it.
        grade: "good" or "doubtful", which colours the verdict.
        headline, notes: the verdict, and sentences below it.
        tables: each with a heading and a note.
        pictures: PNG files, each with a heading and what it shows.

    Raises:
        InputError: what draws it is not installed.
    """
    check_page()
    from . import page
    from ._style import as_data  # which imports matplotlib

    return page.study_page(
        title=title,
        kind=kind,
        grade=grade,
        headline=headline,
        notes=list(notes),
        tables=list(tables),
        pictures=[(heading, as_data(content), words) for heading, content, words in pictures],
    )
