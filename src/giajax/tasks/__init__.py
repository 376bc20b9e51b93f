"""What `giajax fit` does, from Python: a fit with its data, its settings and its validation."""

from ._fit_task import FitTask as FitTask
from ._fitted_runs import fitted_runs as fitted_runs, held_out_runs as held_out_runs
from ._journal import JOURNAL as JOURNAL, Journal as Journal, read_journal as read_journal
from ._lock import locked as locked
from ._record import checksums_of as checksums_of, version_note as version_note
from ._stored import (
    compared as compared,
    repeatable as repeatable,
    stored_result as stored_result,
)
from ._windows_first import begun as begun
