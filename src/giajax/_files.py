"""Files: whether those that people name can be used, and how one is written for good."""

import contextlib
import os
import secrets
import stat
from pathlib import Path

from ._errors import InputError
from ._limits import NAME_BYTES
from ._text import shown

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
        if any(len(name) > NAME_BYTES for name in names):
            longest = max(names, key=len).decode(errors="replace")
            raise InputError(
                f"the path has the name {shown(longest)} of {max(map(len, names))} bytes, but "
                f"must have names of at most {NAME_BYTES}: shorten it"
            )
        os.lstat(path)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise InputError(f"{path} cannot be used ({error.strerror}): give another path") from None
    except InputError:
        raise
    except ValueError:
        raise InputError(
            f"the path {shown(str(path))} has a character that no path may have: correct it"
        ) from None


def read_bytes(path: Path, most: int) -> bytes:
    """The content of a file, not of what never ends or never begins: a pipe, `/dev/zero`.

    Arguments:
        path: of the file.
        most: bytes that it may have.

    Raises:
        InputError: a path that cannot be, something other than a file, or a file that is too large.
        OSError: there is no such file, or it cannot be read.
    """
    check_path(path)
    state = path.stat()
    device = _DEVICES.get(stat.S_IFMT(state.st_mode))
    if device is not None:
        raise InputError(f"{path} is {device}, but must be a file: write its content to one")
    if state.st_size > most:
        raise InputError(
            f"{path} has {state.st_size:,} bytes, but may have {most:,} at most: shorten it"
        )
    return path.read_bytes()


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
            f"{path} cannot be written ({error.strerror}): free some space or let it be written, "
            "and give the same command"
        ) from None


def write_durably(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, and have it on the disk before this returns.

    Several processes may write the same one: the last is there, whole.

    Arguments:
        path: of the file, in a folder that is there; what is there is replaced.
        data: its content.

    Raises:
        OSError: it cannot be written.
    """
    part = path.with_name(f".{secrets.token_hex(16)}.part")
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
