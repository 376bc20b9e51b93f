"""The journal of a fit, which it is resumed from, and the task as plain data in it.

The first line says what is fitted to what; each other one is a state of a fit. A line that was
being written when the process ended is left out: the file is readable at every moment.
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

# What ends a fit or says where it goes, and not which fit it is.
_ASIDE = ("out", "budget", "max_iterations")


def checksums_of(files: Sequence[Path], source: Path | None = None) -> dict[str, str | None]:
    """SHA-256 of the files that a fit reads, by path; None for a sidecar that is not there.

    The fit definition comes first, if it is to be read, and the sidecar of each run after it.
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
    """A file that has moved, by name and checksum: here, by the result or in folders above that."""
    near = () if folder is None else (folder, *folder.resolve().parents[:2])
    for place in (Path(), *near):
        there = place / Path(path).name
        if there.is_file() and _checksum(there, needed=True) == digits:
            return there
    return None


def _places(record: Mapping[str, Any], folder: Path) -> Callable[[str], Path]:
    """Where each file of a record is: here, as it lay beside the result, or where it has moved to.

    An InputError names the first file that is missing or has changed.
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
            f"{missing}, to which {folder} was fitted, does not exist: run the command where the "
            "file is, or restore it"
        )
    # Another file of the same name may be here.
    complaints = [_change(record, base) for base in there]
    if None not in complaints:
        raise InputError(f"{complaints[0]} since the fit began: restore it, or fit again")
    base = there[complaints.index(None)]
    return lambda name: base / name


def _change(record: Mapping[str, Any], base: Path) -> str | None:
    """The first file of a task that is not as it was, and how; None where there is none."""
    for name, before in record["inputs"].items():
        if _checksum(base / name, needed=before is not None) != before:
            return f"{base / name} {'is new' if before is None else 'has changed'}"
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
        usual = True if key == "nuisances" else None
        if (before.get(key, usual) or None) != (after.get(key, usual) or None):
            names.append(key)
    return names


def unchanged(record: Mapping[str, Any], folder: Path) -> dict[str, Any]:
    """The fields of the task that a record in a folder describes, whose files are as they were."""
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
    """The definition of a fit as it was resolved to a `config`: earlier ones had no nuisances."""
    if "nuisances" in config:
        return definition
    held = definition.fit.model_copy(update={"nuisances": False})
    return definition.model_copy(update={"fit": held})


def check_again(now: Mapping[str, Any], before: Mapping[str, Any], folder: Path) -> None:
    """Refuse to go on with the fit of a journal by other settings, or on other files.

    An InputError names the first file, or all settings, that differ.
    """
    _places(before, folder)
    same_files = list(now["inputs"].values()) == list(before["inputs"].values())
    # What nuisances there are, its configuration says, which is compared.
    by_other_names = ("nuisances", *(("data", "validation") if same_files else ()))
    if names := [name for name in differences(now, before) if name not in by_other_names]:
        raise InputError(
            f"the fit in {folder} has other settings (different: {', '.join(names)}): omit "
            "these settings to continue it, or fit again into another folder"
        )


def version_note(versions: Mapping[str, str]) -> str:
    """A sentence where another Python or library computes here than before; else empty."""
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
    shown = f"other versions are installed ({'; '.join(changed)}): the last digits may differ"
    return shown if changed else ""


# One fit at a time in a folder: a lock that ends with the process that has it.

try:
    import fcntl
except ImportError:  # a system without such locks
    fcntl = None  # type: ignore[assignment]

LOCK = "fit.lock"

# File systems that have no such locks say so in one of these ways.
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder, which is made where it is missing and removed again where it stays empty.

    The system gives the lock back when the process ends, however it does; the file that a killed
    process leaves is not a lock, and is taken over.
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
            # While it is held: whoever has opened the file meanwhile sees that it is gone.
            with contextlib.suppress(OSError):
                path.unlink()
            os.close(descriptor)
    finally:
        for empty in made:
            with contextlib.suppress(OSError):
                empty.rmdir()


def _taken(path: Path) -> int:
    """The lock file, opened and held."""
    while True:
        try:
            # Never through a link that somebody has put there.
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
        os.close(descriptor)  # of a fit that has just ended, and removed it
    with contextlib.suppress(OSError):  # the words are for people; the lock holds without them
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    return descriptor


JOURNAL = "journal.jsonl"
_FORMAT = 2

Line = Mapping[str, Any]


class Journal:
    """The journal of a fit, which may have several starts.

    A line that cannot be written (the disk is full) does not end the fit: it is written with the
    next one, if there is room again. `complain` is called with a sentence then, once. The size is
    that up to the end of the last whole line, bytes; 0 where there is none yet.
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
        # Fits from several starts run at once.
        self._lock = threading.Lock()

    @property
    def is_begun(self) -> bool:
        """Whether it holds a state of a fit."""
        return any("fit" in line for line in self._lines)

    @property
    def is_written(self) -> bool:
        """Whether the result of its last state was written."""
        return bool(self._lines) and bool(self._lines[-1].get("written"))

    @property
    def is_complete(self) -> bool:
        """Whether each fit in it has ended by itself, so that none can go on."""
        last = {line["fit"]: line for line in self._lines if "fit" in line}
        return bool(last) and all(line["ending"] is not None for line in last.values())

    def of(self, number: int) -> "Part":
        """The journal of one fit, by its number from 1."""
        return Part(self, number, [line for line in self._lines if line.get("fit") == number])

    def append(self, line: Line) -> None:
        """Write a line, and have it on the disk before this returns."""
        # What a fit has reached is in its state; here only how each of them ended counts.
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
        """Put it away, whose result is written: removed, if nothing is left to go on with."""
        whole = len(result.starts) == result.config.get("starts", 0)
        ended = result.status == "not_converged" and self.is_complete
        if whole and (ended or result.status == "converged"):
            self.remove()
        else:
            self.append({"written": True})

    def warn(self, sentence: str) -> None:
        """Complain, about each thing once."""
        if sentence not in self._complained:
            self._complained.add(sentence)
            self.complain(sentence)

    def _write(self) -> None:
        if self._descriptor is None:
            flags = os.O_WRONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            if not self._size:
                # A new one is made, never through what somebody has put there.
                self.path.unlink(missing_ok=True)
                flags |= os.O_CREAT | os.O_EXCL
            self._descriptor = os.open(self.path, flags, 0o666)
        # What is behind the last whole line was torn, by the end of a process or of the disk.
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
    """The journal of one fit; what `giajax.fitting.FitJournal` describes."""

    def __init__(self, journal: Journal, number: int, lines: Sequence[Line]) -> None:
        self.journal, self.number, self.lines = journal, number, lines

    def append(self, line: Line) -> None:
        """Keep one more line."""
        self.journal.append({"fit": self.number, **line})

    def bits_differ(self) -> None:
        """Say that this machine computes other bits."""
        self.journal.warn(
            "this machine or its libraries differ from the journal in the last digits: the fit "
            "continues, and the last digits of the result may differ"
        )


def read_journal(folder: Path, complain: Callable[[str], None] = lambda _: None) -> Journal | None:
    """The journal in a folder; None where there is none, or none that holds a state of a fit."""
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
            # The last one may have its length on the disk, and not yet its content.
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
    """A state of a fit; the rest of it is read when the fit goes on."""

    __pydantic_config__ = _OTHERS
    fit: int
    ending: tuple[str, str, str] | None


def _parsed(text: bytes, number: int, path: Path) -> Line:
    """A line, checked to have what this file needs of it."""
    what = f"{path} is damaged in line {number}, or is not a journal of giajax"
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
