"""Information in a stored result on its fit and its final values. Imports no JAX."""

import shlex
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..recordings import (
    Definition,
    Run,
    SplitRun,
    fitted_parts,
    held_parts,
    observing,
    read_run,
    rows_of,
    run_keys,
    split_run,
    stored_result,
)
from ..runtime.records import plain_data
from ..runtime.text import InputError
from ..schema import ArmSection
from ._journal import moved_to

if TYPE_CHECKING:
    from ..fitting import FitResult, HeldOut, RunFit

# Keys that identify a fit, with their descriptions. Limits that end a fit early are not included.
_WORDS = {"definition": "the constants of the model", "runs": "the contents of the sidecars"}


def repeatable(path: str | Path) -> tuple[Path, dict[str, Any]]:
    """Return `stored_result` of a fit that can be repeated: it has a task and did not end early."""
    folder, record = stored_result(path)
    if optimiser := record["config"].get("optimiser"):
        raise InputError(
            f"{folder / 'result.json'} is from a fit with {optimiser}, which cannot be described "
            "in a file: repeat the fit from Python"
        )
    if not record.get("task"):
        raise InputError(
            f"{folder / 'result.json'} does not describe how to repeat the fit, because it "
            "was written by an earlier version, combines several fits, or is from a fit in Python "
            "without a task: fit the data again, or use the result as a warm start with --from"
        )
    timed = record["status"] == "not_converged" and "budget_s" in record["config"]
    if record["status"] == "interrupted" or timed:
        raise InputError(
            f"{folder / 'result.json'} is from a fit that was stopped, which cannot be "
            f"reproduced: continue with giajax fit --resume {shlex.quote(str(folder))}, or use it "
            "as a warm start with --from"
        )
    return folder, record


def check_config(before: Mapping[str, Any], now: Mapping[str, Any], where: Path) -> None:
    """Refuse a `Setup.config` that differs from that in the file of a result or a journal."""
    resolved = plain_data(now).items()
    before = {**before, "definition": _renamed(before.get("definition") or {})}
    differing = [_WORDS.get(key, key) for key, value in resolved if before.get(key) != value]
    if differing:
        raise InputError(
            f"this version of giajax resolves the settings of {where} differently (in "
            f"{', '.join(differing)}): continue with the version that wrote it, or fit again"
        )


def _renamed(definition: Mapping[str, Any]) -> dict[str, Any]:
    """Return the constants of a model with the current keys, without default values."""
    if "arm" not in definition:
        return dict(definition)
    arm = dict(definition["arm"])
    for part in (part for parts in ArmSection.quantities.values() for part in parts):
        if part.key is not None and part.key.earlier in arm:
            value = arm.pop(part.key.earlier)
            if value != part.default / part.factor:
                arm[part.key.name] = value
    return {**definition, "arm": arm}


def compared(result: "FitResult", before: Mapping[str, Any]) -> str:
    """Return a sentence on whether a repeated fit gave the numbers of the stored result."""
    keys = ("parameters", "correlation", "cost", "reduced_chi_square", "history")
    now = _plain(result, *keys, "runs", "held_out")
    # An earlier version stored fewer fields of an estimate.
    said = {name for estimate in before["parameters"].values() for name in estimate}
    for estimate in now["parameters"].values():
        for name in estimate.keys() - said:
            del estimate[name]
    same = all(now[key] == before[key] for key in keys)
    for key, what in (("runs", "fitted runs"), ("held_out", "runs with a part held out")):
        ours, theirs = now[key], before.get(key, [])
        if len(ours) != len(theirs):
            return (
                f"the fits differ: the number of {what} is {len(ours)} now, but was "
                f"{len(theirs)} before"
            )
        for one, other in zip(ours, theirs, strict=True):
            # Their files may have moved.
            same = same and one["channels"] == other["channels"]
            same = same and one.get("parameters", {}) == other.get("parameters", {})
    if same:
        return "all numbers are identical, bit for bit"
    moved = []
    for path, estimate in now["parameters"].items():
        value, other = estimate["value"], before["parameters"].get(path, {}).get("value")
        if estimate["free"] and value != other and other:
            moved.append((abs(value / other - 1), path))
    if not moved:
        return "the estimates are identical bit for bit, but quantities derived from them differ"
    by, path = max(moved)
    return f"the estimates differ: the relative difference in {path} is {by:.1e}"


def reached_by(result: "str | Path | FitResult") -> dict[str, Any]:
    """Return the final values of a fit as plain data, in the form of `giajax.fitting.WarmStart`.

    Arguments:
        result: result, or its file or folder.
    """
    if isinstance(result, str | Path):
        record = stored_result(result)[1]
    else:
        record = {"model": result.model.kind, **_plain(result, "parameters", "config", "runs")}
    fixed = {path.partition("[")[0] for path in record["config"].get("fix", {})}
    # The nuisance parameters are omitted, because another recording may have another camera.
    nuisances = record["config"].get("nuisances", ())
    values = {
        path: estimate["value"]
        for path, estimate in record["parameters"].items()
        if (estimate["free"] and path not in nuisances) or path in fixed
    }
    own = {
        run["name"]: {path: item["value"] for path, item in run["parameters"].items()}
        for run in record["runs"]
        if run.get("parameters")
    }
    return {"model": record["model"], "values": values, "own": own}


def _plain(result: "FitResult", *names: str) -> dict[str, Any]:
    """Return some fields of a result in the form of its file."""
    plain: dict[str, Any] = plain_data({name: getattr(result, name) for name in names})
    return plain


def without(beginning: Mapping[str, Any], paths: Iterable[str]) -> dict[str, Any]:
    """Return a warm start without values that others replace, for whole parameters or elements."""
    replaced = set(paths)
    kept = {
        path: value
        for path, value in beginning["values"].items()
        if not {path, path.partition("[")[0]} & replaced
    }
    return {**beginning, "values": kept}


def fitted_runs(
    result: "FitResult",
    data: Sequence[str | Path] = (),
    *,
    rename: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> list[Run]:
    """Return the runs to which a result was fitted, with their channels, windows and definitions.

    They are in the order of the result, without the held-out data.

    Arguments:
        result: result from `giajax.load_result`.
        data: files, if they have moved, in any order.
        rename: map from the column names of the files to the names in the column table. The default
            is that of the fit.
        folder: folder of the result, near which a moved file is sought by its checksum.

    Raises:
        InputError: a file is missing or has changed, or a run was created in memory.
    """
    return fitted_parts(_read_again(result, result.runs, "runs", data, rename, folder))


def held_out_runs(
    result: "FitResult",
    data: Sequence[str | Path] = (),
    *,
    rename: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> list[Run]:
    """Return the held-out cells of a fit as runs, in the order of `result.held_out`.

    The arguments are those of `fitted_runs`.
    """
    return held_parts(_read_again(result, result.held_out, "hold_out", data, rename, folder))


def _read_again(
    result: "FitResult",
    records: "Sequence[RunFit | HeldOut]",
    key: str,
    data: Sequence[str | Path],
    rename: Mapping[str, str] | None,
    folder: Path | None,
) -> list[SplitRun]:
    """Read the runs of some records, restricted as the configuration of the fit specifies."""
    several = result.config.get(key, [])
    if len(records) != len(several):
        raise InputError(
            "the result does not identify the fitted data of all its runs: fit the data again"
        )
    read: dict[tuple[str, str], Run] = {}
    renamed = dict(rename or result.task.get("rename", {}))
    others = {read_run(path, rename=renamed).sha256: path for path in data}
    parts = []
    for record, about in zip(records, several, strict=True):
        path = others.get(record.sha256, record.path if not data else None)
        if path is None:
            files = ", ".join(map(str, data))
            raise InputError(
                f"'{record.name}' was made in memory and has no file: give the run itself in "
                "Python, as in result.plot(run)"
                if record.path is None
                else f"{files} do not have the content of the fitted file {record.path}: give "
                "that file"
            )
        if not data and not Path(path).exists() and record.sha256 is not None:
            path = moved_to(path, record.sha256, folder) or path
        if not data and not Path(path).exists():
            raise InputError(
                f"the fitted file {path} does not exist: give its new path with --data"
            )
        known = {key: item for key, item in about.items() if key in run_keys(model=False)}
        of = about.get("model", result.model.kind)
        definition = Definition.parse({"model": of, **known}, str(path))
        place = str(path), definition.to_toml()
        if place not in read:
            read[place] = read_run(path, rename=renamed, definition=definition)
        run = read[place]
        if run.sha256 != record.sha256:
            raise InputError(
                f"the content of {path} has changed since the fit: run the fit again, or give the "
                "original file"
            )
        if "channels" in about:
            run = observing(run, about["channels"])
        if run.times is not None and about.get("rows") not in (None, len(run.times)):
            # The window of the fit.
            first = int(np.searchsorted(run.times, about["from_s"] - 1e-9))
            run = rows_of(run, slice(first, first + int(about["rows"])), record.name)
        parts.append(split_run(run, about.get("held_from", {})))
    return parts
