"""A task as plain data, in a result and in a journal: enough to fit the same again."""

import hashlib
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from ..recordings import Definition, sidecar_path
from ..runtime.files import read_bytes
from ..runtime.limits import RUN_BYTES
from ..runtime.text import InputError

# What ends a fit or says where it goes, and not which fit it is.
_ASIDE = ("out", "budget", "max_iterations")


def checksums_of(files: Sequence[Path], source: Path | None = None) -> dict[str, str | None]:
    """SHA-256 of the files that a fit reads, by path; None for a sidecar that is not there.

    Arguments:
        files: runs; the sidecar of each comes after it.
        source: the fit definition, if it is to be read.

    Raises:
        InputError: one cannot be read.
    """
    paths: dict[Path, bool] = {} if source is None else {source: True}
    for path in files:
        paths |= {path: True, sidecar_path(path): False}
    return {str(path): _checksum(path, needed) for path, needed in paths.items()}


def _checksum(path: Path, needed: bool) -> str | None:
    if not needed and not os.path.lexists(path):
        return None
    try:
        return hashlib.sha256(read_bytes(path, RUN_BYTES)).hexdigest()
    except FileNotFoundError:
        raise InputError(f"{path} does not exist any more: put it back") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): mend that") from None


def _base_of(record: Mapping[str, Any], folder: Path) -> Path:
    """Where the relative paths of a record begin: here, or as they lie beside the result.

    Arguments:
        record: of a task, whose files are named as they were when it ran.
        folder: that has its result or its journal now.

    Raises:
        InputError: naming the first file that is missing or has changed.
    """
    out = Path(record["out"])
    bases = [Path()]
    if not out.is_absolute():
        bases.append(folder / os.path.relpath(Path(), out))
    names = [name for name, digits in record["inputs"].items() if digits is not None]
    there = [base for base in bases if all((base / name).exists() for name in names)]
    if not there:
        missing = next(name for name in names if not (bases[0] / name).exists())
        raise InputError(
            f"{missing}, which {folder} was fitted to, is not there: run this where it is, or put "
            "it back"
        )
    # Another file of the same name may be here.
    complaints = [_change(record, base) for base in there]
    if None not in complaints:
        raise InputError(f"{complaints[0]} since the fit began: put it back as it was, or fit anew")
    return there[complaints.index(None)]


def _change(record: Mapping[str, Any], base: Path) -> str | None:
    """The first file of a task that is not as it was, and how; None where there is none."""
    for name, before in record["inputs"].items():
        path = base / name
        if _checksum(path, needed=before is not None) != before:
            return f"{path} {'is new' if before is None else 'has changed'}"
    return None


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """What differs between the settings of two records, by the names of their keys."""
    names = [key for key in ("data", "validation", "rename", "begin") if one[key] != other[key]]
    before, after = (record["definition"] for record in (one, other))
    for section in sorted({*before, *after} - {"fit", "truth", "figures"}):
        if before.get(section) != after.get(section):
            names.append(f"[{section}]")
    before, after = before.get("fit", {}), after.get("fit", {})
    for key in sorted({*before, *after} - {*_ASIDE, "data", "validation"}):
        # What is left out and what is empty is the same.
        if (before.get(key) or None) != (after.get(key) or None):
            names.append(key)
    return names


def unchanged(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The fields of the task that a record describes, whose files are as they were.

    Arguments:
        record: plain data.
        folder: that has its result or its journal.

    Raises:
        InputError: a file is missing or has changed.
    """
    base = _base_of(record, folder)
    source = record["source"]
    return {
        "definition": Definition.parse(record["definition"], "the stored task"),
        "data": tuple(base / name for name in record["data"]),
        "validation": tuple(base / name for name in record["validation"]),
        "rename": record["rename"],
        "source": None if source is None else base / source,
        "begin": record["begin"],
    }


def check_again(now: Mapping[str, Any], before: Mapping[str, Any], folder: Path) -> None:
    """Refuse to go on with a fit by other settings, or on other files.

    Arguments:
        now: record of the task to go on with.
        before: that of the journal.
        folder: of the journal.

    Raises:
        InputError: naming the first file, or all settings, that differ.
    """
    unchanged(before, folder)
    checksums_now = list(now["inputs"].values())
    names = differences(now, before)
    if checksums_now == list(before["inputs"].values()):
        # The same files by other names.
        names = [name for name in names if name not in ("data", "validation")]
    if names:
        raise InputError(
            f"the fit in {folder} has other settings (it differs in {', '.join(names)}): leave "
            "them out to go on with it, or fit anew into another folder"
        )


def version_note(versions: Mapping[str, str]) -> str:
    """A sentence where another Python or library computes here; else empty.

    Arguments:
        versions: by name, of what computed before.
    """
    import platform
    from importlib.metadata import PackageNotFoundError, version

    changed = []
    for name, before in versions.items():
        try:
            now = platform.python_version() if name == "python" else version(name)
        except PackageNotFoundError:
            now = "none"
        if now != before:
            changed.append(f"{name} {before} then, {now} now")
    if not changed:
        return ""
    return f"other versions compute here ({'; '.join(changed)}): the last digits may differ"
