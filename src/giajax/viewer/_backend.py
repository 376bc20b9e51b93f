"""The server of viser: behind the gate, quiet, and only where the extra is installed."""

import contextlib
import io
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from .._errors import InputError
from ._behind import PrivateSocket

if TYPE_CHECKING:
    from viser import ViserServer

# What is exchanged while a server starts belongs to the whole process.
_STARTING = threading.Lock()


def check_viser() -> None:
    """Refuse to go on where the library is missing.

    Raises:
        InputError: it is not installed.
    """
    try:
        import viser  # noqa: F401
    except ImportError:
        raise InputError(
            "the viewer needs viser, which is not installed: pip install 'giajax[view]'"
        ) from None


class Backend:
    """A server for one page, on a Unix socket that only this account can reach.

    Attributes:
        server: of viser.
        socket: where it listens.

    Raises:
        InputError: viser is not installed, or it is one that listens elsewhere.
    """

    def __init__(self) -> None:
        check_viser()
        import viser

        self._place = PrivateSocket()
        self.socket = self._place.path
        try:
            # It would print its own address, which is not the one of the page.
            with contextlib.redirect_stdout(io.StringIO()), _listening_at(self.socket):
                self.server: ViserServer = viser.ViserServer(
                    host="127.0.0.1", port=0, label="giajax", verbose=False
                )
            if not self.socket.exists():
                self.close()
                raise InputError(
                    f"viser {viser.__version__} opens a port that other accounts can reach: "
                    "pip install 'viser==1.1.1'"
                )
        except BaseException:
            self._place.close()
            raise
        self.server.scene.set_up_direction("+z")

    def close(self) -> None:
        """End it; without its last word."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
        self._place.close()


@contextlib.contextmanager
def _listening_at(path: Path) -> Iterator[None]:
    """Have viser listen at a path.

    It offers a host and a port alone, and asks nobody who connects for anything. So the function
    that it listens by is exchanged while it starts; that this took place is checked afterwards.
    """
    from websockets.asyncio import server

    with _STARTING:
        usual = server.serve

        def at_path(handler: Any, host: Any = None, port: Any = None, **options: Any) -> Any:
            return usual(handler, unix=True, path=str(path), **options)

        server.serve = at_path  # type: ignore[assignment, misc]
        try:
            yield
        finally:
            server.serve = usual  # type: ignore[misc]
