"""Display of a record of a study: a table, a section of the result's page, and a registered view.

Commands and the page of a result select the view by the type of the record. A view is registered
when it is made. Those of this package are found by their files, and an application makes its own.
"""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, Self, TypeVar

from ..fitting import FitResult
from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.text import InputError, with_run_column
from ..studies import StudyRecord

if TYPE_CHECKING:  # the import is slow, and tables do not need it
    from matplotlib.figure import Figure

R = TypeVar("R", bound=StudyRecord)


class Table(NamedTuple):
    """Headings and rows of text, and the number of columns at the left that contain words."""

    headings: list[str]
    rows: list[list[str]]
    words: int = 1

    @classmethod
    def of_parameters(
        cls, headings: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1
    ) -> Self:
        """Return a table of parameters, with the runs of those of single runs in a column."""
        cells = with_run_column(headings, rows)
        return cls(*cells, words + len(cells[0]) - len(headings))


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A section of a page, from top to bottom; each plot and picture has a title.

    An `early` section is next to the parameters. A long table is collapsed, with `folded` as the
    name of its rows. Warnings are bold, and the note is in small text.
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
    """Display of the records of one type.

    Attributes:
        record: type of the record.
        table: function of a record, the result and a number of rows (None for all).
        sentences: function of a record and a number of rows, for the text below the table.
        figure: function that draws the picture of a record; None if its files contain one anyway.
        section: function of a record, the result and its folder, for the section of a page.
        place: order of the section on a page.
    """

    record: type[R]
    table: Callable[[R, FitResult, int | None], Table]
    sentences: Callable[[R, int | None], list[str]]
    section: Callable[[R, FitResult, Path], PageSection]
    figure: "Callable[[R, FitResult], Figure] | None" = None
    place: int = 9

    def __post_init__(self) -> None:
        # Views of giajax are made on demand and do not replace an existing one.
        _VIEWS.setdefault(self.record, self)


_VIEWS: dict[type[Any], RecordView[Any]] = {}


@functools.cache
def _make_views() -> None:
    for path in sorted(Path(__file__).parent.glob("_[a-z]*.py")):
        import_module(f".{path.stem}", __package__)


def view_of(record: R) -> RecordView[R]:
    """Return the view of a record."""
    _make_views()
    return _VIEWS[type(record)]


def sections(result: FitResult, source: Path | None) -> list[PageSection]:
    """Return the sections of a page for the records stored next to a result (`source`), if any.

    Records of another fit are left out, and a damaged record is replaced by a sentence.
    """
    if source is None:
        return []
    _make_views()
    found = []
    for view in sorted(_VIEWS.values(), key=lambda view: view.place):
        path, remedy = source.parent / view.record.file, view.record.remedy
        try:
            record = view.record.of_json(read_bytes(path, RESULT_BYTES))
            if record.is_of(result):
                found.append(view.section(record, result, source.parent))
        except FileNotFoundError:
            continue
        except InputError as error:
            found.append(_damaged(path, str(error)))
        except OSError as error:
            found.append(
                _damaged(path, f"the file cannot be read ({error.strerror}): make it readable")
            )
        except (LookupError, TypeError, ValueError, ArithmeticError):
            found.append(_damaged(path, f"its numbers are inconsistent: {remedy}"))
    return found


def _damaged(path: Path, why: str) -> PageSection:
    sentence = f"{path.name} is damaged: {why}"
    heading = f"Omitted: {path.name}"
    return PageSection(
        id=path.stem, name=path.stem, heading=heading, table=Table([], []), warnings=(sentence,)
    )
