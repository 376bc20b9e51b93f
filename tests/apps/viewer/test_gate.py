"""The gate: access to everything with the token, and to nothing without it."""

import html
import socket
import stat
import subprocess
import sys
import threading
import time
import webbrowser
from contextlib import ExitStack, suppress
from http.server import BaseHTTPRequestHandler
from pathlib import Path
from socketserver import ThreadingUnixStreamServer
from urllib.error import HTTPError
from urllib.parse import urlparse
from urllib.request import urlopen

import pytest
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect
from websockets.sync.server import unix_serve

from giajax import InputError
from giajax.apps.viewer import Gate, PrivateSocket, _gate, bound, open_in_browser

pytestmark = pytest.mark.quick


class _Echo(BaseHTTPRequestHandler):
    """Answers with the requested path."""

    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        with suppress(OSError):
            while self.path == "/endless":
                self.wfile.write(bytes(1 << 16))
            self.wfile.write(self.path.encode())

    def log_message(self, *arguments):
        pass


@pytest.fixture(scope="module")
def page():
    """Start a page server, and one that echoes its input."""
    places = [PrivateSocket(), PrivateSocket()]
    pages = ThreadingUnixStreamServer(str(places[0].path), _Echo)
    repeats = unix_serve(
        lambda socket: [socket.send(f"again {word}") for word in socket], str(places[1].path)
    )
    for server in (pages, repeats):
        threading.Thread(target=server.serve_forever, daemon=True).start()
    gate = Gate({"": places[0].path, "words": places[1].path})
    yield gate
    gate.close()
    pages.shutdown()
    pages.server_close()
    repeats.shutdown()
    for place in places:
        place.close()


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
        assert b"the token" in refused.value.read()
    with pytest.raises(InvalidStatus):
        connect(f"ws://127.0.0.1:{page.port}/words")


def test_what_is_no_request_ends(page):
    for words in (b"\r\n\r\n", b"GET /\r\n\r\n", b"x" * 100_000):
        with socket.create_connection((page.host, page.port), timeout=10) as connection:
            connection.sendall(words)
            connection.shutdown(socket.SHUT_WR)
            assert connection.recv(100)[:12] in (b"HTTP/1.1 403", b"")


def test_a_connection_carries_one_request(page):
    """A second request would pass without being checked."""
    with socket.create_connection((page.host, page.port), timeout=10) as connection:
        connection.sendall(
            f"GET /{page.token}/first HTTP/1.1\r\nHost: 127.0.0.1:{page.port}\r\n\r\n".encode()
        )
        answer = b""
        while part := connection.recv(1000):
            answer += part
        assert answer.endswith(b"/first")


@pytest.mark.parametrize(
    "fields",
    [
        [],
        ["Host: evil.example:{port}"],
        ["Host: 127.0.0.1"],
        ["Host: 127.0.0.1:1{port}"],
        ["Host: 10.0.0.1:{port}"],
        ["Host: 127.0.0.1:{port}", "Host: 127.0.0.1:{port}"],
        ["Host: 127.0.0.1:{port}", "Origin: http://evil.example"],
        ["Host: 127.0.0.1:{port}", "Origin: http://localhost:{port}"],
        ["Host: 127.0.0.1:{port}", "Origin: https://127.0.0.1:{port}"],
        ["Host: 127.0.0.1:{port}", "Origin: null"],
        ["Host: evil.example:{port}", "Origin: http://evil.example:{port}"],
    ],
)
def test_what_another_page_asks_for_is_refused(page, fields):
    """Even with the token, because of its origin, or because its host name resolves to here."""
    assert asked(page, fields)[:12] == b"HTTP/1.1 403"


@pytest.mark.parametrize("host", ["127.0.0.1:{port}", "LOCALHOST:{port}", "127.0.0.2:{port}"])
def test_names_of_this_machine_are_let_in(page, host):
    assert asked(page, [f"Host: {host}"])[:12] == b"HTTP/1.0 200"
    assert asked(page, [f"Host: {host}", f"Origin: http://{host}"])[:12] == b"HTTP/1.0 200"


def asked(page, fields):
    """Return the answer to a request with these fields and the token."""
    lines = [each.format(port=page.port) for each in [f"GET /{page.token}/ HTTP/1.1", *fields]]
    with socket.create_connection((page.host, page.port), timeout=10) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        answer = b""
        while part := connection.recv(1000):
            answer += part
    return answer


def test_a_page_that_listens_everywhere_has_the_name_of_the_machine():
    gate = Gate({"": Path("nothing")}, host="0.0.0.0")
    try:
        name = socket.gethostname().lower()
        for host in (f"{name}:{gate.port}", f"192.0.2.1:{gate.port}", f"[2001:db8::1]:{gate.port}"):
            assert gate._host([f"Host: {host}".encode()]) == host
        with pytest.raises(Exception, match="from another page"):
            gate._host([f"Host: evil.example:{gate.port}".encode()])
    finally:
        gate.close()


def test_a_page_is_told_what_it_may_do(page):
    with urlopen(page.address, timeout=10) as answer:
        said = answer.headers["Content-Security-Policy"]
        assert f"connect-src 'self' ws://127.0.0.1:{page.port} " in said
        assert said.startswith("default-src 'none'; ")
        assert answer.headers["X-Content-Type-Options"] == "nosniff"


def test_who_is_silent_is_let_go(page, monkeypatch):
    monkeypatch.setattr(_gate, "_HEAD_TIME", 0.2)
    for words in (b"", b"GET /", f"GET /{page.token}/ HTTP/1.1\r\n".encode()):
        with socket.create_connection((page.host, page.port), timeout=10) as connection:
            connection.sendall(words)
            with suppress(ConnectionResetError):
                assert connection.recv(100) == b""


def test_an_answer_that_nobody_takes_ends(page, monkeypatch):
    monkeypatch.setattr(_gate, "_IDLE_TIME", 0.3)
    with socket.create_connection((page.host, page.port), timeout=10) as connection:
        host = f"127.0.0.1:{page.port}"
        connection.sendall(f"GET /{page.token}/endless HTTP/1.1\r\nHost: {host}\r\n\r\n".encode())
        end = time.monotonic() + 10
        while not page._admitted:
            assert time.monotonic() < end
            time.sleep(0.01)
        while page._admitted:
            assert time.monotonic() < end
            time.sleep(0.01)


def test_one_peer_has_so_many_sockets(page):
    address = page.address.replace("http://", "ws://") + "words"
    with ExitStack() as stack:
        for _ in range(_gate._MOST_OF_PEER):
            stack.enter_context(connect(address))
        with pytest.raises(InvalidStatus) as refused:
            connect(address)
        assert refused.value.response.status_code == 503
    end = time.monotonic() + 10
    while page._admitted:
        assert time.monotonic() < end
        time.sleep(0.01)
    with connect(address) as words:
        words.send("hello")
        assert words.recv(timeout=10) == "again hello"


# A page, and a gate that may open only a few files.
FLOODED = """
import resource, sys, threading, time
from http.server import BaseHTTPRequestHandler
from socketserver import ThreadingUnixStreamServer
from giajax.apps.viewer import Gate, PrivateSocket
class Page(BaseHTTPRequestHandler):
    def do_GET(self):
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"here")
    def log_message(self, *arguments):
        pass
place = PrivateSocket()
server = ThreadingUnixStreamServer(str(place.path), Page)
threading.Thread(target=server.serve_forever, daemon=True).start()
gate = Gate({"": place.path})
resource.setrlimit(resource.RLIMIT_NOFILE, (256, 256))
print(gate.address, flush=True)
sys.stdin.read()
gate.close()
"""


def test_silent_connections_keep_nobody_out():
    """284 connections used up all file descriptors, and each further attempt wrote a traceback."""
    running = subprocess.Popen(
        [sys.executable, "-c", FLOODED],
        stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    with ExitStack() as stack:
        stack.callback(running.kill)
        address = running.stdout.readline().strip()
        host, port = address.split("/")[2].split(":")
        for _ in range(284):
            stack.enter_context(socket.create_connection((host, int(port)), timeout=10))
        began = time.monotonic()
        assert read(address) == "here"
        assert time.monotonic() - began < 5.0  # silent connections are kept for 10 s
        assert running.communicate("", timeout=30) == ("", "")
    assert running.returncode == 0


def test_sockets_are_passed_on(page):
    address = page.address.replace("http://", "ws://")
    for each in (f"{address}words", f"{address}words/"):
        with connect(each) as words:
            words.send("hello")
            assert words.recv(timeout=10) == "again hello"


def test_a_port_in_use_is_one_sentence(page):
    with pytest.raises(InputError, match=f"port {page.port} .*in use.*: give another port"):
        Gate({"": Path("nothing")}, port=page.port)
    with pytest.raises(InputError, match="the port is 70000"):
        bound("127.0.0.1", 70000)
    with pytest.raises(InputError, match=r"cannot listen at 203\.0\.113\.7"):
        bound("203.0.113.7", 0)
    with pytest.raises(
        InputError, match="the host is '', which is not an address: give an address such as"
    ):
        bound("", 0)
    with pytest.raises(InputError, match="cannot listen at aaaa"):
        bound("a" * 300, 0)


def test_a_token_is_in_no_words_of_a_process(monkeypatch):
    """Other users can see how a browser is started, but cannot read the file that it opens."""
    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    address = 'http://127.0.0.1:8000/?token=abc&more="d'
    open_in_browser(address)
    path = Path(urlparse(opened[0]).path)
    assert opened[0].startswith("file:")
    assert "abc" not in opened[0]
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    assert f'href="{html.escape(address)}"' in path.read_text()
    assert "Content-Security-Policy" in path.read_text()
