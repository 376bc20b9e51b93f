"""The gate: nothing without the token, everything with it."""

import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import serve

from giajax import InputError
from giajax.apps.viewer import Gate, bound

pytestmark = pytest.mark.quick


class _Echo(BaseHTTPRequestHandler):
    """Answers with the path that it was asked for."""

    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        self.wfile.write(self.path.encode())

    def log_message(self, *arguments):
        pass


@pytest.fixture(scope="module")
def page():
    """A server of pages, and one that repeats what it is told."""
    pages = ThreadingHTTPServer(("127.0.0.1", 0), _Echo)
    repeats = serve(
        lambda socket: [socket.send(f"again {word}") for word in socket], "127.0.0.1", 0
    )
    for server in (pages, repeats):
        threading.Thread(target=server.serve_forever, daemon=True).start()
    gate = Gate({"": pages.server_port, "words": repeats.socket.getsockname()[1]})
    yield gate
    gate.close()
    pages.shutdown()
    pages.server_close()
    repeats.shutdown()


def read(address):
    with urlopen(address, timeout=10) as answer:
        return answer.read().decode()


def test_whoever_has_the_address_is_let_in(page):
    assert read(page.address) == "/"
    assert read(page.address + "a/b?c=1") == "/a/b?c=1"
    assert page.host == "127.0.0.1"
    assert not page.is_open


def test_nobody_else_is(page):
    root = f"http://127.0.0.1:{page.port}/"
    for wrong in ("", "a/b", page.token[:-1] + "/", page.token.swapcase() + "/", f"?{page.token}"):
        with pytest.raises(HTTPError) as refused:
            read(root + wrong)
        assert refused.value.code == 403
        assert b"a token" in refused.value.read()
    with pytest.raises(InvalidStatus):
        connect(f"ws://127.0.0.1:{page.port}/words")


def test_what_is_no_request_ends(page):
    for words in (b"\r\n\r\n", b"GET /\r\n\r\n", b"x" * 100_000):
        with socket.create_connection((page.host, page.port), timeout=10) as connection:
            connection.sendall(words)
            connection.shutdown(socket.SHUT_WR)
            assert connection.recv(100)[:12] in (b"HTTP/1.1 403", b"")


def test_a_connection_carries_one_request(page):
    """The second one would pass without being read."""
    with socket.create_connection((page.host, page.port), timeout=10) as connection:
        connection.sendall(f"GET /{page.token}/first HTTP/1.1\r\nHost: a\r\n\r\n".encode())
        answer = b""
        while part := connection.recv(1000):
            answer += part
        assert answer.endswith(b"/first")


def test_sockets_are_passed_on(page):
    address = page.address.replace("http://", "ws://")
    for each in (f"{address}words", f"{address}words/"):
        with connect(each) as words:
            words.send("hello")
            assert words.recv(timeout=10) == "again hello"


def test_a_port_in_use_is_one_sentence(page):
    with pytest.raises(InputError, match=f"port {page.port} .*in use.*: give another port"):
        Gate({"": 1}, port=page.port)
    with pytest.raises(InputError, match="the port is 70000"):
        bound("127.0.0.1", 70000)
    with pytest.raises(InputError, match=r"cannot listen at 203\.0\.113\.7"):
        bound("203.0.113.7", 0)
