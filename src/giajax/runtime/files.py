"""Files named by users: checks, limits, reading and writing."""

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
except ImportError:  # not available on Windows
    fcntl = None  # type: ignore[assignment]

_DEVICES = {
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def check_path(path: str | Path) -> None:
    """Reject a path that no file can have on this system; the file need not exist.

    Raises:
        InputError: the path has a NUL character, a name that is too long or a circle of links, or a
            folder in it may not be searched.
    """
    try:
        names = [os.fsencode(name) for name in Path(path).parts]
        b"/".join(names).decode()
        if any(len(name) > NAME_BYTES for name in names):
            longest = max(names, key=len).decode(errors="replace")
            raise InputError(
                f"the path contains the name {shown(longest)}, which has {max(map(len, names))} "
                f"bytes, but a name must have at most {NAME_BYTES} bytes: shorten it"
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
            f"the path {shown(str(path))} has a character that is not allowed in a path: remove it"
        ) from None


def check_kind(path: Path, mode: int) -> None:
    """Reject, by its mode, a pipe or a device, whose content may not end."""
    device = _DEVICES.get(stat.S_IFMT(mode))
    if device is not None:
        raise InputError(f"{path} is {device}, but must be a file: write the content to a file")


def check_replaced(path: Path) -> None:
    """Reject a path at which there is a device, a pipe or a socket, also behind a link.

    If the user is root, a file moved there would replace it for all programs.
    """
    with contextlib.suppress(OSError):
        device = _DEVICES.get(stat.S_IFMT(path.stat().st_mode))
        if device is not None:
            raise InputError(f"{path} is {device}, which is not overwritten: give another name")


@contextlib.contextmanager
def opened(path: Path) -> Iterator[BinaryIO]:
    """Open a regular file for reading; pipes and devices are rejected.

    Raises:
        InputError: the path is invalid, or is not a file.
        OSError: the file does not exist or cannot be read.
    """
    check_path(path)
    # Opening a pipe must not wait for its writer. The option does not exist on Windows.
    handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(handle, "rb") as file:
        check_kind(path, os.fstat(handle).st_mode)
        yield file


def read_bytes(path: Path, most: int) -> bytes:
    """Return the content of a file with at most `most` bytes; pipes and devices are rejected.

    Raises:
        InputError: the path is invalid, is not a file, or the file is too large.
        OSError: the file does not exist or cannot be read.
    """
    with opened(path) as file:
        size = os.fstat(file.fileno()).st_size
        # Reading a system file without data returns None instead of empty bytes.
        data = b"" if size > most else file.read(size + 1) or b""
        if len(data) > size:  # a growing file, or a system file without a size
            data += file.read(most + 1 - len(data)) or b""
    if (size := max(size, len(data))) > most:
        raise InputError(f"{path} has {size:,} bytes, but at most {most:,} are allowed: shorten it")
    return data


def read_text(path: Path, most: int, form: str, wanted: str) -> str:
    """Return the text of a UTF-8 file, as `read_bytes`; `form` and `wanted` are used in errors.

    Raises:
        InputError: the file does not exist, cannot be read, or is not text.
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
    """Write a file of a study in progress durably; its folder is created if it is missing.

    Raises:
        InputError: the file cannot be written; earlier files are unchanged.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_durably(path, data)
    except OSError as error:
        raise InputError(
            f"{path} cannot be written ({error.strerror}): free disk space or change the "
            "permissions, and run the same command again"
        ) from None


def part_of(path: Path) -> Path:
    """Return the temporary path at which a file is written before it is moved to its place.

    The name is random and short, and the file must be opened exclusively, so that no other process
    can have put a link there.
    """
    return path.with_name(f".{secrets.token_hex(16)}.part")


_PART = re.compile(r"\.[0-9a-f]{32}\.part")
# An active writer extends or moves its file within this time.
_STALE_S = 60.0


@contextlib.contextmanager
def written_to(folder: Path) -> Iterator[None]:
    """Write to a folder, after removing the incomplete files of killed writers.

    Several blocks may write at the same time, or the system may have no locks. Existing temporary
    files may then belong to another block, so recent ones are kept. Empty folders that were created
    for the block are removed again.
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
            # Another block may hold the lock briefly for its check; a script may hold it for a long
            # time.
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
    """Write a file atomically, and return when it is on the disk.

    Several processes may write the same file: the last complete one remains. The folder must exist.
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
    # The name is on the disk when its folder has been flushed. Not every system can open a folder.
    with contextlib.suppress(OSError):
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


# Parsing of TOML and JSON text to plain data within limits of depth and size.
#
# Brackets are counted before the text is parsed, because the parsers are recursive and Python's
# recursion limit differs between versions.

# Strings and comments, in which brackets are ordinary characters. One without an end extends to the
# end of the text.
_TOML_WORDS = re.compile(
    r'"""(?:\\.|[^\\])*?(?:"""|\Z)'
    r"|'''.*?(?:'''|\Z)"
    r'|"(?:\\.|[^"\\\n])*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*",
    re.DOTALL,
)
_JSON_WORDS = re.compile(r'"(?:\\.|[^"\\])*"', re.DOTALL)
_HALF = re.compile(r"\\ud[89a-f]", re.IGNORECASE)  # one half of an escaped surrogate pair
_BRACKETS = re.compile(r"[\[\]{}]")
_BETWEEN_KEYS = re.compile(r"[\[\]{},=\n]")


def parse_toml(text: str, path: Path) -> dict[str, Any]:
    """Return the content of a TOML file (`InputError`: it is invalid or beyond the limits)."""
    skeleton = _TOML_WORDS.sub("_", text)
    # Dotted keys are limited as well, because the time of the parser is quadratic in the number of
    # parts.
    dotted = (part.count(".") for part in _BETWEEN_KEYS.split(skeleton))
    if _is_deep(skeleton) or any(dots >= DEPTH for dots in dotted):
        raise _too_deep(str(path))
    import tomllib

    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        reason = " ".join(str(error).split())
        raise InputError(f"{path} is not valid TOML ({reason}): correct that line") from None
    except ValueError:  # an integer with more digits than Python converts
        raise InputError(f"{path} contains {_too_large()}") from None
    check_size(data, str(path))
    return data


def parse_json(text: str, path: Path | str) -> Any:
    """Return the content of a JSON file, in which each key of an object must be unique.

    Raises:
        InputError: the content is beyond the limits.
        ValueError: it is not JSON, which has neither NaN nor infinity, or a string is not Unicode.
    """
    if _is_deep(_JSON_WORDS.sub("_", text)):
        raise _too_deep(str(path))
    data = json.loads(text, object_pairs_hook=_once, parse_constant=_no_constant)
    check_size(data, str(path))
    check_unicode(data, text)
    return data


def check_unicode(data: Any, text: str) -> None:
    """Reject (`ValueError`) data of a JSON text in which a string contains half a character.

    JSON permits unpaired surrogates as escapes, but they can be neither written nor displayed.
    """
    if _HALF.search(text):
        try:
            json.dumps(data, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError(
                "a string contains an incomplete character: correct the string"
            ) from None


def check_size(data: Any, source: str) -> None:
    """Reject plain data that are nested too deeply, or contain an integer beyond 64 bits."""
    waiting: list[tuple[Any, int]] = [(data, 0)]
    while waiting:
        item, depth = waiting.pop()
        inner: Iterable[Any] = ()
        if isinstance(item, Mapping):
            inner = item.values()
        elif isinstance(item, list | tuple):
            inner = item
        elif isinstance(item, int) and not -WHOLE <= item < WHOLE:
            raise InputError(f"{source} contains {_too_large()}")
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
