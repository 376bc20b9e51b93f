"""How records that lie beside a result are shown: each type has one view, which others ask for.

A command and the page of a result know records by their type alone; an application registers its
own from above.
"""

from pathlib import Path
from typing import Any

from ..fitting import FitResult
from ..runtime.files import read_bytes
from ..runtime.limits import RESULT_BYTES
from ..runtime.text import InputError
from ._posterior import POSTERIOR_VIEW
from ._profiles import PROFILE_VIEW
from ._repetitions import BOOTSTRAP_VIEW, INFLUENCE_VIEW
from ._views import PageSection, R, RecordView

# In the order of the sections of a page.
_VIEWS: dict[type[Any], RecordView[Any]] = {}


def register(view: RecordView[Any]) -> None:
    """Show records of a type by this view, in commands and on pages."""
    _VIEWS[view.record] = view


for _view in (PROFILE_VIEW, BOOTSTRAP_VIEW, INFLUENCE_VIEW, POSTERIOR_VIEW):
    register(_view)


def view_of(record: R) -> RecordView[R]:
    """How a record is shown."""
    return _VIEWS[type(record)]


def sections(result: FitResult, source: Path | None) -> list[PageSection]:
    """The sections of a page on the records that lie beside a result.

    Arguments:
        result: that the page is about.
        source: its `result.json`; None where it was not read from a file.

    Returns:
        One for each record; what is damaged or of another fit has none.
    """
    if source is None:
        return []
    found = []
    for view in _VIEWS.values():
        try:
            record = view.record.of_json(read_bytes(source.parent / view.record.file, RESULT_BYTES))
        except (OSError, InputError):
            continue
        if record.is_of(result):
            found.append(view.section(record, result, source.parent))
    return found
