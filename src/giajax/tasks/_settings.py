"""Settings of a task that are changed: the last word on a parameter counts. Imports no JAX."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from ..runs import Definition

Paths = str | Path | Sequence[str | Path]
Item = TypeVar("Item")


def paths_of(files: Paths) -> tuple[Path, ...]:
    """One file, or several."""
    return (Path(files),) if isinstance(files, str | Path) else tuple(map(Path, files))


def contents_with(
    definition: Definition, above: Mapping[str, Any], values: Mapping[str, Any]
) -> dict[str, Any]:
    """The contents of a definition with other settings of `[fit]`.

    Arguments:
        definition: what was said before.
        above: as of `overridden`.
        values: of the other keys; None for what is not said, and "" for a budget without end.
    """
    said = {key: value for key, value in values.items() if value is not None}
    contents = definition.contents()
    contents["fit"] = {**contents.get("fit", {}), **overridden(definition, above), **said}
    if contents["fit"].get("budget") == "":
        del contents["fit"]["budget"]
    return contents


def overridden(definition: Definition, above: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of `[fit]` about parameters, path by path; the last word on one counts.

    Arguments:
        definition: what was said before.
        above: `free`, `start`, `fix`, `priors`, `bounds`, `ties`, `per_run` and `groups` of
            `FitTask.on_top`; None for what is not said.

    Returns:
        Values by key, of those keys that say anything now or before.
    """
    free, per_run = above["free"], above["per_run"]
    start, fix, bounds = above["start"] or {}, above["fix"] or {}, above["bounds"] or {}
    priors, ties, groups = above["priors"] or {}, above["ties"] or {}, above["groups"] or {}
    below = definition.fit
    held, following = set(fix), set(ties)
    apart = {*(per_run or ()), *groups}
    freed = {*(free or ()), *apart}
    no_more = held | following

    def kept(table: Mapping[str, Item] | None, without: Collection[str]) -> dict[str, Item]:
        return {path: item for path, item in (table or {}).items() if path not in without}

    frees = below.free if free is None else list(free)
    if not free and frees is not None:
        frees = [path for path in frees if path not in no_more]
    alone = below.per_run if per_run is None else list(per_run)
    if per_run is None and alone is not None:
        alone = [path for path in alone if path not in no_more | set(groups)]
    known = {path: entry.contents() for path, entry in below.priors.items()}
    settings: dict[str, Any] = {
        "free": frees,
        "start": {**kept(below.start, no_more), **start},
        "fix": {**kept(below.fix, freed | set(start) | following), **fix},
        "priors": kept(known, no_more) | {path: prior.contents() for path, prior in priors.items()},
        "bounds": {**kept(below.bounds, no_more), **bounds},
        "ties": {**kept(below.ties, freed | held), **ties},
        "per_run": alone,
        "groups": {**kept(below.groups, no_more | set(per_run or ())), **groups},
    }
    mentioned = {"free", "start", "fix", *below.contents()}
    return {key: item for key, item in settings.items() if item or key in mentioned}
