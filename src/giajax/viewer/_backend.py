"""The server of viser: on the loopback, quiet, and only where the extra is installed."""

import contextlib
import io
from typing import TYPE_CHECKING

from .._errors import InputError
from ._gate import LOOPBACK

if TYPE_CHECKING:
    from viser import ViserServer


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


def start() -> "ViserServer":
    """A server for one page, at a free port of the loopback."""
    check_viser()
    import viser

    # It would print its own address, which is not the one of the page.
    with contextlib.redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=LOOPBACK, port=0, label="giajax", verbose=False)
    server.scene.set_up_direction("+z")
    return server


def stop(server: "ViserServer") -> None:
    """End it; without its last word."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()
