"""Fits and sweeps from Python as in `giajax fit`, with data, settings and a journal."""

from typing import TYPE_CHECKING

from ..recordings import stored_result as stored_result
from ..runtime.aliases import earlier as _earlier
from ._fit_task import FitTask as FitTask, with_warm_start as with_warm_start
from ._journal import (
    JOURNAL as JOURNAL,
    Journal as Journal,
    checksums_of as checksums_of,
    locked as locked,
    read_journal as read_journal,
    version_note as version_note,
)
from ._plan import Plan as Plan
from ._stored import (
    compared as compared,
    fitted_runs as fitted_runs,
    held_out_runs as held_out_runs,
    repeatable as repeatable,
)
from ._sweep import FITS as FITS, TABLE as TABLE, sweep as sweep

# Type checkers should report missing names.
if not TYPE_CHECKING:
    __getattr__ = _earlier(__name__)
