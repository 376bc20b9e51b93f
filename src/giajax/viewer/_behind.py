"""Where the servers of a page listen: behind the gate, out of reach of other accounts and pages."""

import os
import socket
import tempfile
from pathlib import Path

from .._errors import InputError

# Of the path of a Unix socket; macOS has the least, 104.
_LONGEST = 100


class PrivateSocket:
    """A place for a Unix socket, in a folder that only this account may enter.

    Attributes:
        path: of the socket, which the server makes.

    Raises:
        InputError: this system has no such sockets, or no temporary folder that suits one.
    """

    def __init__(self) -> None:
        if not hasattr(socket, "AF_UNIX"):
            raise InputError("this system has no Unix sockets, but a page needs them: use another")
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="giajax-", ignore_cleanup_errors=True)
        except OSError as error:
            raise InputError(
                f"the temporary folder cannot be used ({error.strerror}): set TMPDIR to another"
            ) from None
        self.path = Path(self._folder.name, "page")
        if len(os.fsencode(self.path)) > _LONGEST:
            self.close()
            raise InputError(
                f"the temporary folder {tempfile.gettempdir()} has too long a path for a socket: "
                "set TMPDIR to a shorter one, such as /tmp"
            )

    def close(self) -> None:
        """Remove it."""
        self._folder.cleanup()
