"""One fit at a time in a folder: a lock that ends with the process that has it."""

import contextlib
import errno
import os
import socket
from collections.abc import Iterator
from pathlib import Path

from .._errors import InputError
from ..runs import check_output_folder, make_folder

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
    process leaves is no lock, and is taken over.

    Raises:
        InputError: another process holds it, or it cannot be made or written.
    """
    check_output_folder(folder)
    made = [path for path in (folder, *folder.parents) if not path.exists()]
    path = make_folder(folder) / LOCK
    try:
        descriptor = _taken(path)
        try:
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
            holder = _holder(descriptor)
            os.close(descriptor)
            raise InputError(
                f"another fit is writing to {path.parent} ({holder}): wait until it has ended, "
                "or give another folder"
            ) from None
        except OSError as error:
            if error.errno not in _NO_LOCKS:
                os.close(descriptor)
                raise
        if _is_there(path, descriptor):
            break
        os.close(descriptor)  # of a fit that has just ended, and removed it
    with contextlib.suppress(OSError):  # the words are for people; the lock holds without them
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {socket.gethostname()}\n".encode())
    return descriptor


def _is_there(path: Path, descriptor: int) -> bool:
    try:
        return os.path.samestat(os.stat(path, follow_symlinks=False), os.fstat(descriptor))
    except FileNotFoundError:
        return False


def _holder(descriptor: int) -> str:
    try:
        words = os.read(descriptor, 200).decode(errors="replace").strip()
    except OSError:
        words = ""
    return words or "its process is not known"
