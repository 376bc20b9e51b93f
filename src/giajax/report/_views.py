"""What it takes to show a record beside a result: a table, a section of its page, and a view."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, NamedTuple, TypeVar

from matplotlib.figure import Figure

from ..fitting import FitResult
from ..studies import StudyRecord

R = TypeVar("R", bound=StudyRecord)


class Table(NamedTuple):
    """Headings and rows of text; how many columns at the left are words."""

    headings: list[str]
    rows: list[list[str]]
    words: int = 1


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A section of a page, from top to bottom.

    Attributes:
        id, name, heading: in the address, in the list of sections and above it.
        early: whether it stands beside the parameters, before recorded and fitted values.
        warnings: sentences in bold.
        intro: a paragraph.
        table: of the record.
        folded: what its rows are called where a long table is folded; empty where none is.
        sentences: a list.
        plots: title and what BokehJS embeds, of each.
        pictures: as data of a browser, each with what it shows.
        note: a paragraph in small print.
    """

    id: str
    name: str
    heading: str
    table: Table
    early: bool = False
    warnings: tuple[str, ...] = ()
    intro: str = ""
    folded: str = ""
    sentences: list[str] | tuple[str, ...] = ()
    plots: list[tuple[str, str]] | tuple[()] = ()
    pictures: list[tuple[str, str]] | tuple[()] = ()
    note: str = ""


@dataclass(frozen=True, kw_only=True)
class RecordView(Generic[R]):
    """How records of one type are shown.

    Attributes:
        record: the type.
        table: of a record, the result and a number of rows (None for all).
        sentences: below the table, likewise.
        figure: the picture of a record beside its file; None where the files have another way.
        section: of the page, of a record, the result and its folder.
    """

    record: type[R]
    table: Callable[[R, FitResult, int | None], Table]
    sentences: Callable[[R, int | None], list[str]]
    section: Callable[[R, FitResult, Path], PageSection]
    figure: Callable[[R, FitResult], Figure] | None = None
