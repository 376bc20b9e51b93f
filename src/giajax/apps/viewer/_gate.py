"""Gate in front of the server of a page, which requires a secret token in the address.

The server of a page listens where only this account can reach it, and does not authenticate users.
The gate listens at the given host and port and reads the head of each request. It passes a request
on, without the token, only if its path begins with the token and it comes from the page itself. A
connection carries one request or one WebSocket.
"""

import asyncio
import atexit
import html
import ipaddress
import logging
import os
import re
import secrets
import shutil
import socket
import tempfile
import threading
import webbrowser
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path

from ...runtime.page_policy import VISER, policy
from ...runtime.text import InputError

# The servers of a page listen behind the gate, where other accounts and pages cannot reach them.

_LONGEST = 100  # longest path of a Unix socket, bytes; the smallest limit is that of macOS, 104


class PrivateSocket:
    """Path for a Unix socket, in a folder that only this account can enter.

    Attributes:
        path: path of the socket, which the server creates.

    Raises:
        InputError: the system has no Unix sockets, or no suitable temporary folder.
    """

    def __init__(self) -> None:
        if not hasattr(socket, "AF_UNIX"):
            raise InputError(
                "this system has no Unix sockets, which the page needs: use another system"
            )
        try:
            self._folder = tempfile.TemporaryDirectory(prefix="giajax-", ignore_cleanup_errors=True)
        except OSError as error:
            raise InputError(
                f"the temporary folder cannot be used ({error.strerror}): set TMPDIR to another "
                "folder"
            ) from None
        self.path = Path(self._folder.name, "page")
        if len(os.fsencode(self.path)) > _LONGEST:
            self.close()
            raise InputError(
                f"the path of the temporary folder {tempfile.gettempdir()} is too long for a "
                "socket: set TMPDIR to a shorter path, such as /tmp"
            )

    def close(self) -> None:
        """Remove the folder and the socket."""
        self._folder.cleanup()


def open_in_browser(address: str) -> None:
    """Open a page in the browser of this account.

    Other accounts can see the command line of the browser. The command line therefore names a file
    that only this account can read and that redirects to the address.
    """
    folder = tempfile.mkdtemp(prefix="giajax-")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    page = Path(folder, "open.html")
    target = html.escape(address)
    page.write_text(
        '<!doctype html><meta http-equiv="Content-Security-Policy" content="default-src \'none\'">'
        f'<meta http-equiv="refresh" content="0; url={target}">'
        f'<a href="{target}">open the page</a>\n'
    )
    webbrowser.open(page.as_uri())


LOOPBACK = "127.0.0.1"

_LONGEST_HEAD = 64 * 1024  # longest head of a request, bytes; a browser sends less for a page

# Timeouts, s: for the complete head of a request, and for any progress of an answer.
_HEAD_TIME, _IDLE_TIME = 10.0, 60.0

# Largest numbers of connections, in total and per peer. They apply separately to connections that
# have not sent a head and to admitted connections.
_MOST, _MOST_OF_PEER = 64, 32

_TOKEN = "The address of this page lacks the token: open the full address."
_ORIGIN = (
    "This request came from another page or host name: open the address that the command printed."
)
_FULL = "This page has too many connections: close other tabs."

_HOST = re.compile(r"([a-z0-9._-]+|\[[0-9a-f:.]+\])(?::([0-9]{1,5}))?")

_log = logging.getLogger(__name__)


class _RefusedError(Exception):
    """Request that is not passed on; its arguments are the status and the reason."""


class Gate:
    """Gate that passes on the requests whose path begins with a token.

    Arguments:
        sockets: sockets of the servers behind the gate, by the first part of the path after the
            token; "" is the socket for all other paths.
        host, port: host and port to listen at; port 0 chooses a free one.

    Raises:
        InputError: the port is in use, or the host is not an address of this machine.
    """

    def __init__(self, sockets: Mapping[str, Path], *, host: str = LOOPBACK, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(16)
        self._sockets = dict(sockets)
        self._socket = bound(host, port)
        self.host, self.port = host, self._socket.getsockname()[1]
        self._names = {host.lower(), "localhost"}
        if self.is_open:
            self._names.add(socket.gethostname().lower())
        # The connections that have not sent a head yet (oldest first) and the admitted ones, each
        # with its peer.
        self._waiting: dict[asyncio.StreamWriter, str] = {}
        self._admitted: dict[asyncio.StreamWriter, str] = {}
        self._listens = threading.Event()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        self._listens.wait()

    @property
    def address(self) -> str:
        """Address of the page, with the host name of the machine if all interfaces are used."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/{self.token}/"

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach the gate."""
        return self.host not in (LOOPBACK, "localhost", "::1")

    def close(self) -> None:
        """Stop accepting connections and end the open ones."""
        if self._loop.is_running():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(timeout=5)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        # Errors caused by peers or by a lack of file descriptors do not need a traceback.
        self._loop.set_exception_handler(lambda _, about: _log.debug("%s", about["message"]))
        server = self._loop.run_until_complete(
            asyncio.start_server(self._admit, sock=self._socket, limit=_LONGEST_HEAD)
        )
        self._loop.call_soon(self._listens.set)
        try:
            self._loop.run_forever()
        finally:
            server.close()
            for writer in [*self._waiting, *self._admitted]:
                writer.transport.abort()
            if tasks := asyncio.all_tasks(self._loop):
                for task in tasks:
                    task.cancel()
                self._loop.run_until_complete(asyncio.wait(tasks, timeout=5))
            self._loop.close()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Handle one connection."""
        peer = (writer.get_extra_info("peername") or ("",))[0]
        self._make_room(peer)
        self._waiting[writer] = peer
        try:
            async with asyncio.timeout(_HEAD_TIME):
                head = await reader.readuntil(b"\r\n\r\n")
            self._waiting.pop(writer, None)
            path, inside, host = self._passed(head)
            if len(self._admitted) >= _MOST or self._of(peer, self._admitted) >= _MOST_OF_PEER:
                raise _RefusedError("503 Service Unavailable", _FULL)
            self._admitted[writer] = peer
            await _exchange(path, inside, host, reader, writer)
        except _RefusedError as refused:
            writer.write(_refusal(*refused.args))
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            writer.transport.abort()
        finally:
            await _closed(writer)
            self._waiting.pop(writer, None)
            self._admitted.pop(writer, None)

    def _of(self, peer: str, connections: Mapping[asyncio.StreamWriter, str]) -> int:
        return sum(each == peer for each in connections.values())

    def _make_room(self, peer: str) -> None:
        """End the longest-waiting silent connection if there are too many, to admit a new one."""
        silent = list(self._waiting)
        if self._of(peer, self._waiting) >= _MOST_OF_PEER:
            silent = [each for each in silent if self._waiting[each] == peer]
        elif len(silent) < _MOST:
            return
        del self._waiting[silent[0]]
        silent[0].transport.abort()

    def _passed(self, head: bytes) -> tuple[Path, bytes, str]:
        """Return the socket for a request, the rewritten head, and the host of the request."""
        line, *fields = head.rstrip(b"\r\n").split(b"\r\n")
        parts = line.decode("latin-1").split(" ")
        if len(parts) != 3 or parts[0] != "GET":
            raise _RefusedError("403 Forbidden", _TOKEN)
        # A WebSocket client omits the slash at the end.
        token, _, inside = parts[1].removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            raise _RefusedError("403 Forbidden", _TOKEN)
        host = self._host(fields)
        place = inside.split("/", 1)[0].split("?", 1)[0]
        path = self._sockets.get(place) if place else None
        if path is None:
            path = self._sockets[""]
        else:
            inside = inside.removeprefix(place).removeprefix("/")
        # A connection carries one request, because the gate removes the token only from the first.
        kept = [
            each
            for each in fields
            if not each.lower().startswith(b"connection:") or b"upgrade" in each.lower()
        ]
        if not any(each.lower().startswith(b"connection:") for each in kept):
            kept.insert(0, b"Connection: close")
        first = f"GET /{inside} {parts[2]}".encode("latin-1")
        return path, b"\r\n".join([first, *kept, b"", b""]), host

    def _host(self, fields: list[bytes]) -> str:
        """Return the host and port of a request, after a check that they are those of this page.

        Another page can make its own name resolve to this machine, and its requests then have this
        name as their host. A request that another page sends directly has that page as its origin.
        A numeric address cannot be such a name.
        """
        host, origin = (_values(fields, name) for name in ("host", "origin"))
        if len(host) == 1 and (not origin or origin == [f"http://{host[0]}"]):
            parts = _HOST.fullmatch(host[0])
            if parts and int(parts[2] or 80) == self.port and self._is_here(parts[1].strip("[]")):
                return host[0]
        raise _RefusedError("403 Forbidden", _ORIGIN)

    def _is_here(self, name: str) -> bool:
        if name in self._names:
            return True
        with suppress(ValueError):
            address = ipaddress.ip_address(name)
            return self.is_open or address.is_loopback
        return False


def _values(fields: list[bytes], name: str) -> list[str]:
    """Return the values of a header field of a request."""
    pairs = (each.decode("latin-1").partition(":") for each in fields)
    return [value.strip().lower() for key, _, value in pairs if key.strip().lower() == name]


def _refusal(status: str, why: str) -> bytes:
    return (
        f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n"
        "Content-Security-Policy: default-src 'none'\r\nX-Content-Type-Options: nosniff\r\n"
        f"Content-Length: {len(why) + 1}\r\n\r\n{why}\n"
    ).encode()


async def _exchange(
    path: Path,
    inside: bytes,
    host: str,
    reader: asyncio.StreamReader,
    writer: asyncio.StreamWriter,
) -> None:
    """Pass on a request and its answer, with a content security policy, or a WebSocket."""
    answers, asked = await asyncio.open_unix_connection(path, limit=_LONGEST_HEAD)
    try:
        asked.write(inside)
        async with asyncio.timeout(_IDLE_TIME):
            head = await answers.readuntil(b"\r\n\r\n")
        line, _, rest = head.partition(b"\r\n")
        allowed = policy(VISER, connect=f"'self' ws://{host} data: blob:")
        writer.write(
            line
            + f"\r\nContent-Security-Policy: {allowed}; frame-ancestors 'self'\r\n"
            "Referrer-Policy: no-referrer\r\nX-Content-Type-Options: nosniff\r\n".encode()
            + rest
        )
        if b" 101 " in line:
            # WebSockets have no idle timeout: the servers detect lost clients by themselves.
            await asyncio.gather(_pipe(reader, asked), _pipe(answers, writer))
        else:
            await _pipe(answers, writer, _IDLE_TIME)
    finally:
        await _closed(asked)


async def _pipe(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, idle: float | None = None
) -> None:
    """Copy all data until the end of the stream, or until no data moved for `idle` seconds."""
    try:
        while True:
            async with asyncio.timeout(idle):
                if not (data := await reader.read(1 << 16)):
                    break
                writer.write(data)
                await writer.drain()
    except TimeoutError:
        writer.transport.abort()
    except OSError:
        pass
    writer.close()


async def _closed(writer: asyncio.StreamWriter) -> None:
    """Close one side of a connection; data that are not received in time are lost."""
    with suppress(OSError):
        writer.close()
        async with asyncio.timeout(_HEAD_TIME):
            await writer.wait_closed()
    writer.transport.abort()


def bound(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an unused host and port of this machine."""
    if not host:
        raise InputError(
            "the host is '', which is not an address: give an address such as 127.0.0.1"
        )
    if not 0 <= port <= 65535:
        raise InputError(
            f"the port is {port}: give a port from 1024 to 65535, or 0 for any free port"
        )
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_STREAM)
    try:
        # Otherwise the port of a closed page stays in use for a minute.
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host, port))
        found.listen()
    except (OSError, ValueError) as error:
        found.close()
        why = (getattr(error, "strerror", None) or str(error)).lower()
        raise InputError(
            f"cannot listen at {host}, port {port} ({why}): give another port, or 0 for any free "
            "port"
        ) from None
    return found
