"""Paths and files that people name: whether they can be used, before they are opened."""

import os
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
