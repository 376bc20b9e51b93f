"""A fit with its journal: begun, or gone on with, in a folder of its own."""

import contextlib
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from .._errors import InputError
from ..fitting import versions
from ._journal import JOURNAL, Journal, read_journal
from ._lock import locked
from ._record import check_again
from ._stored import check_config


def warn(sentence: str) -> None:
    """What becomes of complaints where nobody says otherwise: warnings of Python."""
    warnings.warn(sentence, stacklevel=2)


@contextlib.contextmanager
def kept(
    record: Mapping[str, Any],
    config: Mapping[str, Any],
    folder: Path,
    *,
    resume: bool,
    force: bool,
    complain: Callable[[str], None],
) -> Iterator[Journal]:
    """The journal of a fit in a folder; see `Preparation.kept_in`.

    Arguments:
        record: of the task.
        config: the settings as they were resolved.
        folder, resume, force, complain: as there.
    """
    with locked(folder):
        if resume:
            journal = _continued(record, config, folder)
        else:
            if not force:
                _check_none_is_lost(folder)
            head = {"versions": versions(), "task": dict(record), "config": dict(config)}
            journal = Journal(folder / JOURNAL, head)
        journal.complain = complain
        try:
            yield journal
        finally:
            journal.close()


def _check_none_is_lost(folder: Path) -> None:
    before = read_journal(folder)
    if before is not None and not before.is_written:
        raise InputError(
            f"{folder} holds the journal of a fit that was cut off: go on with giajax fit "
            f"--resume {folder}, give another folder, or --force to begin anew"
        )


def _continued(record: Mapping[str, Any], config: Mapping[str, Any], folder: Path) -> Journal:
    journal = read_journal(folder)
    if journal is None:
        raise InputError(f"{folder} has no journal of a fit: fit without resuming to begin one")
    check_again(record, journal.head["task"], folder)
    check_config(journal.head["config"], config, journal.path)
    return journal
