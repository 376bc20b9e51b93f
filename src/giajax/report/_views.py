"""How a record beside a result is shown: a table, a section of its page, and a view of its type.

A command and the page of a result know records by their type alone. A view is known once it is
made: those of this room are found by their files, an application makes its own from above.
"""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

from ..fitting import FitResult
from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.text import InputError
from ..studies import StudyRecord

if TYPE_CHECKING:  # Slow to import, and no table needs it.
    from matplotlib.figure import Figure

R = TypeVar("R", bound=StudyRecord)


class Table(NamedTuple):
    """Headings and rows of text; how many columns at the left are words."""

    headings: list[str]
    rows: list[list[str]]
    words: int = 1


@dataclass(frozen=True, kw_only=True)
class PageSection:
    """A section of a page, from top to bottom; each plot and picture with a title.

    It stands beside the parameters where it is `early`, and a long table is `folded` under what its
    rows are called. Warnings are in bold, the note in small print.
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
        place: of its section among those of a page.
    """

    record: type[R]
    table: Callable[[R, FitResult, int | None], Table]
    sentences: Callable[[R, int | None], list[str]]
    section: Callable[[R, FitResult, Path], PageSection]
    figure: "Callable[[R, FitResult], Figure] | None" = None
    place: int = 9

    def __post_init__(self) -> None:
        # Those of giajax are made when one is looked for, and do not replace another one.
        _VIEWS.setdefault(self.record, self)


_VIEWS: dict[type[Any], RecordView[Any]] = {}


@functools.cache
def _make_views() -> None:
    for path in sorted(Path(__file__).parent.glob("_[a-z]*.py")):
        import_module(f".{path.stem}", __package__)


def view_of(record: R) -> RecordView[R]:
    """How a record is shown."""
    _make_views()
    return _VIEWS[type(record)]


def sections(result: FitResult, source: Path | None) -> list[PageSection]:
    """The sections of a page on the records that lie beside a result, the `source`, if it has one.

    What is of another fit has none; in place of what is damaged is a sentence.
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
