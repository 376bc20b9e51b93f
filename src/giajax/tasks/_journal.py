"""Journal of a fit, from which it can be resumed, with its task as plain data.

The first line describes the fit, and each other line is a state of a fit. A line that was
incomplete when the process ended is ignored, so the file is readable at every moment.
"""

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import socket
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ConfigDict

from ..recordings import (
    Definition,
    StoredConfig,
    StoredTask,
    check_output_folder,
    make_folder,
    sidecar_path,
)
from ..runtime.files import check_unicode, read_bytes, written_to
from ..runtime.limits import JOURNAL_BYTES, RUN_BYTES
from ..runtime.plugins import SUM
from ..runtime.records import from_plain
from ..runtime.text import InputError

if TYPE_CHECKING:
    from ..fitting import FitResult

# Settings that end a fit or give its folder, but do not identify the fit.
_ASIDE = ("out", "budget", "max_iterations")


def checksums_of(files: Sequence[Path], source: Path | None = None) -> dict[str, str | None]:
    """Return the SHA-256 of the files that a fit reads, by path, or None for a missing sidecar.

    The fit definition comes first, if there is one, and each run is followed by its sidecar.
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
        raise InputError(f"{path} no longer exists: restore it") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): make it readable") from None


def moved_to(path: str | Path, digits: str, folder: Path | None) -> Path | None:
    """Return the new path of a moved file, found by name and checksum, or None.

    The current folder, the folder of the result and two folders above are searched.
    """
    near = () if folder is None else (folder, *folder.resolve().parents[:2])
    for place in (Path(), *near):
        there = place / Path(path).name
        if there.is_file() and _checksum(there, needed=True) == digits:
            return there
    return None


def _places(record: Mapping[str, Any], folder: Path) -> Callable[[str], Path]:
    """Return a function that finds the files of a record.

    They are in the current folder, in the same place relative to the result, or moved.

    Raises:
        InputError: a file is missing or has changed. The message names the first one.
    """
    out = Path(record["out"])
    bases = [Path()]
    if not out.is_absolute():
        bases.append(folder / os.path.relpath(Path(), out))
    names = [name for name, digits in record["inputs"].items() if digits is not None]
    there = [base for base in bases if all((base / name).exists() for name in names)]
    found = {n: moved_to(n, record["inputs"][n], folder) for n in names} if not there else {}
    if found and None not in found.values():
        return lambda name: found.get(name) or Path(name)
    if not there:
        missing = next(name for name in names if not (bases[0] / name).exists())
        raise InputError(
            f"{missing}, which the fit in {folder} uses, does not exist: run the command where the "
            "file is, or restore it"
        )
    # A different file with the same name may be here.
    complaints = [_change(record, base) for base in there]
    if None not in complaints:
        raise InputError(f"{complaints[0]} since the fit began: restore it, or fit again")
    base = there[complaints.index(None)]
    return lambda name: base / name


def _change(record: Mapping[str, Any], base: Path) -> str | None:
    """Return the first file of a task that has changed, and how, or None."""
    for name, before in record["inputs"].items():
        if _checksum(base / name, needed=before is not None) != before:
            return f"{base / name} {'is new' if before is None else 'has changed'}"
    return None


def differences(one: Mapping[str, Any], other: Mapping[str, Any]) -> list[str]:
    """Return the names of the keys in which the settings of two records differ."""
    names = [key for key in ("data", "validation", "rename", "begin") if one[key] != other[key]]
    before, after = (record["definition"] for record in (one, other))
    for section in sorted({*before, *after} - {"fit", "truth", "figures"}):
        if before.get(section) != after.get(section):
            names.append(f"[{section}]")
    before, after = before.get("fit", {}), after.get("fit", {})
    for key in sorted({*before, *after} - {*_ASIDE, "data", "validation"}):
        # A missing setting and an empty one are equivalent.
        usual = True if key == "nuisances" else None
        if (before.get(key, usual) or None) != (after.get(key, usual) or None):
            names.append(key)
    return names


def unchanged(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """Return the fields of the task that a record in a folder describes.

    Its files must be unchanged.
    """
    place, source = _places(record, folder), record["source"]
    return {
        "definition": Definition.parse(record["definition"], "the stored task"),
        "data": tuple(map(place, record["data"])),
        "validation": tuple(map(place, record["validation"])),
        "rename": record["rename"],
        "source": None if source is None else place(source),
        "begin": record["begin"],
    }


def known_to(config: Mapping[str, Any], definition: Definition) -> Definition:
    """Return the definition of a fit with this `config`. Earlier versions had no nuisances."""
    if "nuisances" in config:
        return definition
    held = definition.fit.model_copy(update={"nuisances": False})
    return definition.model_copy(update={"fit": held})


def check_again(now: Mapping[str, Any], before: Mapping[str, Any], folder: Path) -> None:
    """Refuse to continue the fit of a journal with different settings or files.

    Raises:
        InputError: settings or files differ. The message names the first file, or all settings.
    """
    _places(before, folder)
    same_files = list(now["inputs"].values()) == list(before["inputs"].values())
    # The nuisance parameters are part of the configuration, which is compared.
    by_other_names = ("nuisances", *(("data", "validation") if same_files else ()))
    if names := [name for name in differences(now, before) if name not in by_other_names]:
        raise InputError(
            f"the fit in {folder} has different settings ({', '.join(names)}): omit these settings "
            "to continue it, or fit again into another folder"
        )


def version_note(versions: Mapping[str, str]) -> str:
    """Return a sentence if another Python or library is used than before, otherwise ""."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    changed = []
    for name, before in versions.items():
        if before.startswith(SUM):
            continue
        try:
            now = platform.python_version() if name == "python" else version(name)
        except PackageNotFoundError:
            now = "none"
        if now != before:
            changed.append(f"{name} {before} before, {now} now")
    shown = (
        f"different versions are installed ({'; '.join(changed)}): the last digits of the result "
        "may differ"
    )
    return shown if changed else ""


# A lock allows one fit at a time in a folder. It ends with the process that holds it.

try:
    import fcntl
except ImportError:  # a system without such locks
    fcntl = None  # type: ignore[assignment]

LOCK = "fit.lock"

# Error codes of file systems without such locks.
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder, which is created if it is missing, and removed if it remains empty.

    The system releases the lock when the process ends for any reason. The file that a killed
    process leaves is not a lock, and is reused.
    """
    check_output_folder(folder)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    path = make_folder(folder) / LOCK
    try:
        descriptor = _taken(path)
        try:
            with written_to(folder):
                yield
        finally:
            # The file is removed while the lock is held, so a process that has opened it notices
            # this.
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)
    finally:
        for empty in made:
            with contextlib.suppress(OSError):
                empty.rmdir()


def _taken(path: Path) -> int:
    """Open and lock the lock file."""
    while True:
        try:
            # Never follow a symbolic link, which may have been planted there.
            flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
            descriptor = os.open(path, flags, 0o666)
        except OSError as error:
            raise InputError(
                f"{path} cannot be written ({error.strerror}): give another folder"
            ) from None
        try:
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            words = b""
            with contextlib.suppress(OSError):
                words = os.read(descriptor, 200).strip()
            os.close(descriptor)
            holder = words.decode(errors="replace") or "unknown process"
            raise InputError(
                f"another fit is writing to {path.parent} ({holder}): wait until it has ended, "
                "or give another folder"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
        with contextlib.suppress(FileNotFoundError):
            if os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(descriptor)):
                break
        os.close(descriptor)  # lock of a fit that has just ended and removed the file
    with contextlib.suppress(OSError):  # informative text, which the lock does not need
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    return descriptor


JOURNAL = "journal.jsonl"
_FORMAT = 2

Line = Mapping[str, Any]


class Journal:
    """Journal of a fit, which may have several starts.

    A line that cannot be written (for example to a full disk) does not end the fit. It is written
    with the next line, if there is space again.

    Arguments:
        path: path of the file.
        head: first line, which describes the fit.
        lines: later lines.
        size: size of the file up to the end of the last complete line, bytes, 0 for a new file.
        complain: function that is called with a sentence, once, if a line cannot be written.
    """

    def __init__(
        self,
        path: Path,
        head: Line,
        lines: Sequence[Line] = (),
        size: int = 0,
        complain: Callable[[str], None] = lambda sentence: None,
    ) -> None:
        self.path, self.head, self.complain = path, head, complain
        self._lines, self._size = list(lines), size
        self._waiting = b"" if size else _encoded({"giajax_journal": _FORMAT, **head})
        self._descriptor: int | None = None
        self._complained: set[str] = set()
        # Fits from several starts run in parallel.
        self._lock = threading.Lock()

    @property
    def is_begun(self) -> bool:
        """Whether the journal contains a state of a fit."""
        return any("fit" in line for line in self._lines)

    @property
    def is_written(self) -> bool:
        """Whether the result of its last state was written."""
        return bool(self._lines) and bool(self._lines[-1].get("written"))

    @property
    def is_complete(self) -> bool:
        """Whether each fit in the journal has ended by itself, so that none can continue."""
        last = {line["fit"]: line for line in self._lines if "fit" in line}
        return bool(last) and all(line["ending"] is not None for line in last.values())

    def of(self, number: int) -> "Part":
        """Return the journal of one fit, by its number from 1."""
        return Part(self, number, [line for line in self._lines if line.get("fit") == number])

    def append(self, line: Line) -> None:
        """Write a line, which is on the disk when this returns."""
        # The state contains the progress of a fit. Here, only the way in which each fit ended is
        # needed.
        kept = {key: line[key] for key in ("fit", "ending", "written") if key in line}
        with self._lock:
            self._lines.append(kept)
            self._waiting += _encoded(line)
            try:
                self._write()
            except OSError as error:
                self.warn(
                    f"{self.path} cannot be written ({error.strerror}): the fit continues, but "
                    "cannot be resumed unless this is corrected"
                )

    def settle(self, result: "FitResult") -> None:
        """Close the journal of a written result, and remove it if no fit can continue."""
        whole = len(result.starts) == result.config.get("starts", 0)
        ended = result.status == "not_converged" and self.is_complete
        if whole and (ended or result.status == "converged"):
            self.remove()
        else:
            self.append({"written": True})

    def warn(self, sentence: str) -> None:
        """Complain about each problem once."""
        if sentence not in self._complained:
            self._complained.add(sentence)
            self.complain(sentence)

    def _write(self) -> None:
        if self._descriptor is None:
            flags = os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            if not self._size:
                # A new file is created, and an existing link or file is never written through.
                self.path.unlink(missing_ok=True)
                flags |= os.O_CREAT | os.O_EXCL
            self._descriptor = os.open(self.path, flags, 0o666)
        # Data after the last complete line are incomplete, because the process ended or the disk
        # was full.
        os.ftruncate(self._descriptor, self._size)
        os.lseek(self._descriptor, self._size, os.SEEK_SET)
        done = 0
        while done < len(self._waiting):
            done += os.write(self._descriptor, self._waiting[done:])
        os.fsync(self._descriptor)
        self._size += done
        self._waiting = b""

    def close(self) -> None:
        """Close the file."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None

    def remove(self) -> None:
        """Close and remove the file."""
        self.close()
        with contextlib.suppress(OSError):
            self.path.unlink(missing_ok=True)


class Part:
    """Journal of one fit, which implements `giajax.fitting.FitJournal`."""

    def __init__(self, journal: Journal, number: int, lines: Sequence[Line]) -> None:
        self.journal, self.number, self.lines = journal, number, lines

    def append(self, line: Line) -> None:
        """Store one more line."""
        self.journal.append({"fit": self.number, **line})

    def bits_differ(self) -> None:
        """Warn that this machine computes slightly different numbers."""
        self.journal.warn(
            "with this machine or its libraries, the last digits differ from those of the journal: "
            "the fit continues, but the last digits of the result may differ from those of an "
            "uninterrupted fit"
        )


def read_journal(folder: Path, complain: Callable[[str], None] = lambda _: None) -> Journal | None:
    """Return the journal in a folder, or None if there is none that contains a state of a fit."""
    path = folder / JOURNAL
    try:
        data = read_bytes(path, JOURNAL_BYTES)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): make it readable") from None
    lines, size = [], 0
    whole = data.split(b"\n")[:-1]
    for number, text in enumerate(whole, 1):
        try:
            lines.append(_parsed(text, number, path))
        except InputError:
            # The last line may have its length on the disk, but not yet its content.
            if number == len(whole) > 1:
                break
            raise
        size += len(text) + 1
    if not lines:
        return None
    journal = Journal(path, lines[0], lines[1:], size, complain)
    return journal if journal.is_begun else None


_OTHERS = ConfigDict(extra="ignore")


@dataclasses.dataclass(frozen=True)
class _Head:
    __pydantic_config__ = _OTHERS
    giajax_journal: int
    versions: dict[str, str]
    task: StoredTask
    config: StoredConfig


@dataclasses.dataclass(frozen=True)
class _State:
    """State of a fit. Its other fields are read when the fit continues."""

    __pydantic_config__ = _OTHERS
    fit: int
    ending: tuple[str, str, str] | None


def _parsed(text: bytes, number: int, path: Path) -> Line:
    """Return a line, after checking the fields that this module needs."""
    what = f"{path} is damaged at line {number}, or is not a giajax journal"
    remedy = "remove it, and fit again"
    try:
        line = json.loads(text)
        check_unicode(line, text.decode())
    except (ValueError, RecursionError):
        raise InputError(f"{what}: {remedy}") from None
    known = line if isinstance(line, dict) else {}
    if number == 1 and known.get("giajax_journal", _FORMAT) != _FORMAT:
        raise InputError(
            f"{path} was written by another version of giajax: continue with that version, or fit "
            "again"
        )
    if number == 1 or not known.get("written"):
        from_plain(_Head if number == 1 else _State, line, what, remedy)
    return dict(line)


def _encoded(line: Line) -> bytes:
    return json.dumps(line).encode() + b"\n"
