"""Names of runs, for the names of files."""

import re
from collections.abc import Sequence

from ._run import Run

# 50 characters of four bytes leave room for what is around them in a name.
_LONGEST = 50


def unique_names(runs: Sequence[Run]) -> list[str]:
    """A name for each run that no other has and any file system takes."""
    names: list[str] = []
    for run in runs:
        stem = re.sub(r"[^\w.-]+", "_", run.name).strip(".")[:_LONGEST] or "run"
        name = stem
        number = 1
        while name.lower() in (other.lower() for other in names):
            number += 1
            name = f"{stem}_{number}"
        names.append(name)
    return names
