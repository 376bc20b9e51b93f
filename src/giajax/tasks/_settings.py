"""Settings of a task that are changed: the last word on a parameter counts."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy.typing as npt

from ..runs import Definition

Paths = str | Path | Sequence[str | Path]


def paths_of(files: Paths) -> tuple[Path, ...]:
    """One file, or several."""
    return (Path(files),) if isinstance(files, str | Path) else tuple(map(Path, files))


def parameters_of(
    definition: Definition,
    free: Sequence[str] | None,
    start: Mapping[str, npt.ArrayLike],
    fix: Mapping[str, npt.ArrayLike],
) -> dict[str, Any]:
    """`free`, `start` and `fix` of a definition with others on top, path by path."""
    below = definition.fit
    freed = below.free if free is None else list(free)
    starts, fixes = dict(below.start or {}), dict(below.fix or {})
    for path in fix:
        starts.pop(path, None)
        if not free and freed is not None:
            freed = [name for name in freed if name != path]
    for path in (*start, *(free or ())):
        fixes.pop(path, None)
    return {"free": freed, "start": {**starts, **start}, "fix": {**fixes, **fix}}
