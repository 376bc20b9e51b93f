"""The way in to a page: an address with a secret in it, and nothing without.

What serves a page here listens on the loopback alone and knows no users. The gate listens where it
is told to, reads the first line of each request, and passes on only what begins with the token,
without it. A connection carries one request or one WebSocket.
"""

import asyncio
import secrets
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress

from ...runtime.text import InputError

LOOPBACK = "127.0.0.1"

# Of a request: more than a browser sends for a page.
_LONGEST_HEAD = 64 * 1024

_REFUSAL = b"This page has an address with a token in it: open it by the whole address.\n"
_REFUSED = (
    b"HTTP/1.1 403 Forbidden\r\nContent-Type: text/plain; charset=utf-8\r\nConnection: close\r\n"
    b"Content-Length: %d\r\n\r\n%s" % (len(_REFUSAL), _REFUSAL)
)


class Gate:
    """Lets requests through whose path begins with a token.

    Arguments:
        ports: of the servers behind it, on the loopback, by the first part of the path after the
            token; "" is that of everything else.
        host: where to listen.
        port: where to listen; 0 for a free one.

    Raises:
        InputError: the port is in use, or the host is none of this machine.
    """

    def __init__(self, ports: Mapping[str, int], *, host: str = LOOPBACK, port: int = 0) -> None:
        self.token = secrets.token_urlsafe(16)
        self._ports = dict(ports)
        self._socket = bound(host, port)
        self.host, self.port = host, self._socket.getsockname()[1]
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def address(self) -> str:
        """Of the page, for a browser; by the name of this machine where all of it listens."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/{self.token}/"

    @property
    def is_open(self) -> bool:
        """Whether other machines can reach it."""
        return self.host not in (LOOPBACK, "localhost", "::1")

    def close(self) -> None:
        """Let nobody in any more."""
        if self._loop.is_running():
            self._loop.call_soon_threadsafe(self._loop.stop)
            self._thread.join(timeout=5)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(
            asyncio.start_server(self._admit, sock=self._socket, limit=_LONGEST_HEAD)
        )
        try:
            self._loop.run_forever()
        finally:
            server.close()
            # Both ends of each connection, so that what passes things on comes to its own end.
            for writer in list(self._writers):
                writer.transport.abort()
            if tasks := asyncio.all_tasks(self._loop):
                self._loop.run_until_complete(asyncio.wait(tasks, timeout=5))
            self._loop.close()

    async def _admit(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection."""
        self._writers.add(writer)
        with suppress(OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError):
            head = await reader.readuntil(b"\r\n\r\n")
            passed = self._passed(head)
            if passed is None:
                writer.write(_REFUSED)
                await writer.drain()
            else:
                port, inside = passed
                answers, asked = await asyncio.open_connection(LOOPBACK, port)
                self._writers.add(asked)
                asked.write(inside)
                await asyncio.gather(_pipe(reader, asked), _pipe(answers, writer))
                await self._closed(asked)
        await self._closed(writer)

    async def _closed(self, writer: asyncio.StreamWriter) -> None:
        """End one side of a connection."""
        writer.close()
        with suppress(OSError):
            await writer.wait_closed()
        self._writers.discard(writer)

    def _passed(self, head: bytes) -> tuple[int, bytes] | None:
        """To which server a request goes, and as what; None where it is refused."""
        line, _, rest = head.partition(b"\r\n")
        parts = line.decode("latin-1").split(" ")
        if len(parts) != 3:
            return None
        method, path, version = parts
        # A client of WebSockets leaves the slash at the end out.
        token, _, inside = path.removeprefix("/").partition("/")
        if not secrets.compare_digest(token.encode(), self.token.encode()):
            return None
        place = inside.split("/", 1)[0].split("?", 1)[0]
        port = self._ports.get(place) if place else None
        if port is None:
            port = self._ports[""]
        else:
            inside = inside.removeprefix(place).removeprefix("/")
        # A second request on the same connection would come with its token.
        fields = [
            each
            for each in rest.split(b"\r\n")
            if not each.lower().startswith(b"connection:") or b"upgrade" in each.lower()
        ]
        if not any(each.lower().startswith(b"connection:") for each in fields):
            fields.insert(0, b"Connection: close")
        return port, f"{method} /{inside} {version}\r\n".encode("latin-1") + b"\r\n".join(fields)


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Everything that comes, until nothing does."""
    with suppress(OSError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
    with suppress(OSError):
        writer.close()


def bound(host: str, port: int) -> socket.socket:
    """A socket that listens at a place.

    Raises:
        InputError: the port is in use, or the host is none of this machine.
    """
    if not 0 <= port <= 65535:
        raise InputError(f"the port is {port}: give one from 1024 to 65535, or 0 for a free one")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    found = socket.socket(family, socket.SOCK_STREAM)
    try:
        # Otherwise the port of a page that was closed is in use for a minute.
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host, port))
        found.listen()
    except OSError as error:
        found.close()
        why = (error.strerror or str(error)).lower()
        raise InputError(
            f"cannot listen at {host}, port {port} ({why}): give another port, or 0 for a free one"
        ) from None
    return found
