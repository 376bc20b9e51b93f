"""Files that people name: whether they can be used, their limits, reading and writing."""

import contextlib
import json
import os
import re
import secrets
import stat
import time
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from .limits import DEPTH, NAME_BYTES, WHOLE
from .text import InputError, shown

try:
    import fcntl
except ImportError:  # of Windows
    fcntl = None  # type: ignore[assignment]

_DEVICES = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_path(path: str | Path) -> None:
    """Refuse a path that no file could have, here; whether there is a file does not matter.

    Raises:
        InputError: a NUL character, a name that is too long, a circle of links, or a folder that
            may not be searched.
    """
    try:
        names = [os.fsencode(name) for name in Path(path).parts]
        b"/".join(names).decode()
        if any(len(name) > NAME_BYTES for name in names):
            longest = max(names, key=len).decode(errors="replace")
            raise InputError(
                f"the path has the name {shown(longest)} of {max(map(len, names))} bytes, but a "
                f"name must have at most {NAME_BYTES} bytes: shorten it"
            )
        os.lstat(path)
        os.stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise InputError(f"{path} cannot be used ({error.strerror}): give another path") from None
    except InputError:
        raise
    except UnicodeDecodeError:
        raise InputError(
            f"the path {shown(str(path))} is not UTF-8, so no file can refer to it: rename it"
        ) from None
    except ValueError:
        raise InputError(
            f"the path {shown(str(path))} has a character that is not allowed in a path: correct it"
        ) from None


def check_kind(path: Path, mode: int) -> None:
    """Refuse, by its mode, what has a name and no content that ends: a pipe, a device."""
    device = _DEVICES.get(stat.S_IFMT(mode))
    if device is not None:
        raise InputError(f"{path} is {device}, but must be a file: write the content to a file")


def check_replaced(path: Path) -> None:
    """Refuse a place where a device, a pipe or a socket is, also behind a link.

    Where root writes, a file that is moved there takes its place for every program.
    """
    with contextlib.suppress(OSError):
        device = _DEVICES.get(stat.S_IFMT(path.stat().st_mode))
        if device is not None:
            raise InputError(f"{path} is {device}, which is not overwritten: give another name")


@contextlib.contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """A file whose content is read and ends: no pipe, no device.

    Raises:
        InputError: a path that cannot be, or something other than a file.
        OSError: there is no such file, or it cannot be read.
    """
    check_path(path)
    # Without waiting for who writes into a pipe; on Windows there is none.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as file:
        check_kind(path, os.fstat(handle).st_mode)
        yield file


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file of so many bytes at most, not of what never ends: a pipe, `/dev/zero`.

    Raises:
        InputError: a path that cannot be, something other than a file, or a file that is too large.
        OSError: there is no such file, or it cannot be read.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        # A file of the system that has nothing to say yet gives no data, not even none.
        data = b"" if size > most else file.read(size + 1) or b""
        if len(data) > size:  # a file that grows, or one of the system, which says no size
            data += file.read(most + 1 - len(data)) or b""
    if (size := max(size, len(data))) > most:
        raise InputError(f"{path} has {size:,} bytes, but at most {most:,} are allowed: shorten it")
    return data


def read_text(path: Path, most: int, form: str, wanted: str) -> str:
    """The text of a file in UTF-8, as `read_bytes`; what it is, and what to give, in errors.

    Raises:
        InputError: there is no such file, or it cannot be read, or is not a text.
    """
    try:
        return read_bytes(path, most).decode("utf-8-sig")
    except FileNotFoundError:
        raise InputError(f"{path} does not exist: give {wanted}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not text: it must be {form} in UTF-8") from None
    except OSError as error:
        raise InputError(f"{path} cannot be read ({error.strerror}): give {wanted}") from None


def keep(path: Path, data: bytes) -> None:
    """Write a file of a study that goes on, durably, into a folder that is made if it is missing.

    Raises:
        InputError: it cannot be written; what has been kept before is as it was.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(path, data)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}): free disk space or "
            "change the permissions, and run the same command again"
        ) from None


def part_of(path: Path) -> Path:
    """Where a file is written, beside its place, before it is moved there.

    Not guessable, short where the name is long, and to be opened only if it is not there: no
    other process can have put a link there.
    """
    return path.with_name(f".{secrets.token_hex(16)}.part")


_PART = re.compile(r"\.[0-9a-f]{32}\.part")
_STALE_S = 60.0  # a writer that lives adds to its file sooner, or has moved it


@contextlib.contextmanager
def written_to(folder: Path) -> Iterator[None]:
    """Write to a folder, from which what killed writers left unfinished is removed before.

    Several blocks may do so at once: what is there may be of another one then, as where the system
    has no locks, and what is new stays. Empty folders that were made for it go again.
    """
    made: list[Path] = []
    alone, descriptor = False, None
    try:
        with contextlib.suppress(OSError):
            made = [path for path in (folder, *folder.parents) if not path.exists()]
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = os.open(folder, os.O_RDONLY)
            if fcntl is not None:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                alone = True
        for path in folder.glob(".*.part"):
            with contextlib.suppress(OSError):
                old = alone or time.time() - path.lstat().st_mtime > _STALE_S
                if old and _PART.fullmatch(path.name):
                    path.unlink()
        if fcntl is not None and descriptor is not None:
            # Of another block that looks just now; but a script may have the folder for long.
            for _ in range(10):
                try:
                    fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
                except BlockingIOError:
                    time.sleep(0.005)
                    continue
                except OSError:
                    pass
                break
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)
        for empty in made:
            with contextlib.suppress(OSError):
                empty.rmdir()


def write_durably(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, and have it on the disk before this returns.

    Several processes may write the same one: the last is there, whole. Its folder must be there.
    """
    part = part_of(path)
    try:
        with part.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)
    # The name is on the disk when its folder is; not every system lets a folder be opened.
    with contextlib.suppress(OSError):
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


# TOML and JSON text as plain data, where it is not deeper or larger than any file has to be.
#
# Brackets are counted before the text is parsed: the parsers call themselves for each, and Python
# ends at some depth that differs from version to version.

# Strings and comments, in which a bracket is a character; one without an end goes on to the end.
_TOML_WORDS = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"""|\Z)'
    r"|'''.*?(?:'''|\Z)"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*",
    re.DOTALL,
)
_JSON_WORDS = re.compile(r'"(?:\\.|[^"\\])*"', re.DOTALL)
_HALF = re.compile(r"\\ud[89a-f]", re.IGNORECASE)  # of a character beyond 16 bits, by its number
_BRACKETS = re.compile(r"[\[\]{}]")
_BETWEEN_KEYS = re.compile(r"[\[\]{},=\n]")


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """The content of a TOML file (`InputError`: it is not TOML, or is beyond the limits)."""
    skeleton = _TOML_WORDS.sub("_", text)
    # Not only deep: the parser looks at each part of a dotted key once for each part before it.
    dotted = (part.count(".") for part in _BETWEEN_KEYS.split(skeleton))
    if _is_deep(skeleton) or any(dots >= DEPTH for dots in dotted):
        raise _too_deep(str(path))
    import tomllib

    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not valid TOML ({reason}): correct that line") from None
    except ValueError:  # of more digits than Python converts
        raise InputError(f"{path} has {_too_large()}") from None
    check_size(data, str(path))
    return data


def parse_json(text: str, path: Path | str) -> Any:
    """The content of a JSON file, whose objects have each key once.

    Raises:
        InputError: it is beyond the limits.
        ValueError: it is not JSON, which knows neither NaN nor infinity, or a text is not Unicode.
    """
    if _is_deep(_JSON_WORDS.sub("_", text)):
        raise _too_deep(str(path))
    data = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    check_size(data, str(path))
    check_unicode(data, text)
    return data


def check_unicode(data: Any, text: str) -> None:
    """Refuse (`ValueError`) data of a JSON text in which a string has half of a character.

    JSON may have such, by their numbers; nothing that is written or shown may.
    """
    if _HALF.search(text):
        try:
            json.dumps(data, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError("a text has an incomplete character: correct it") from None


def check_size(data: Any, source: str) -> None:
    """Refuse plain data that are nested too deeply, or hold a whole number beyond 64 bits."""
    waiting: list[tuple[Any, int]] = [(data, 0)]
    while waiting:
        item, depth = waiting.pop()
        inner: Iterable[Any] = ()
        if isinstance(item, Mapping):
            inner = item.values()
        elif isinstance(item, list | tuple):
            inner = item
        elif isinstance(item, int) and not -WHOLE <= item < WHOLE:
            raise InputError(f"{source} has {_too_large()}")
        if depth > DEPTH:
            raise _too_deep(source)
        waiting += [(one, depth + 1) for one in inner]


def _is_deep(skeleton: str) -> bool:
    depth = 0
    for bracket in _BRACKETS.finditer(skeleton):
        depth += 1 if bracket[0] in "[{" else -1
        if depth > DEPTH:
            return True
    return False


def _too_deep(source: str) -> InputError:
    return InputError(
        f"{source} has tables or lists nested more than {DEPTH} levels deep: reduce the nesting"
    )


def _too_large() -> str:
    return "a whole number of more than 64 bits: correct the number, or write it as 1e20"


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    data = dict(pairs)
    if len(data) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in data if names.count(name) > 1)
        raise ValueError(f"the key {shown(twice)} occurs twice")
    return data


def _no_constant(name: str) -> Any:
    raise ValueError(f"{name} is not a JSON number")
