"""A headless Chromium that a test drives: by its DevTools protocol, over a WebSocket."""

import base64
import itertools
import json
import re
import subprocess
import time
from contextlib import contextmanager

from websockets.sync.client import connect

# What viser and Chromium say of themselves.
NO_COMPLAINTS = (
    "Detected chrome version",
    "WebGL support",
    "Embedded data loaded",
    "THREE.Clock",
    "GPU stall due to ReadPixels",
    "GroupMarkerNotSet",
)


class Page:
    """One page of a browser."""

    def __init__(self, socket):
        self._socket = socket
        self._numbers = itertools.count(1)
        self.said = []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """One call of the protocol, and its result; what the page says meanwhile is kept."""
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        while True:
            message = json.loads(self._socket.recv(timeout=60))
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]
            self._heard(message)

    def _heard(self, message):
        method, about = message.get("method"), message.get("params", {})
        if method == "Runtime.consoleAPICalled":
            words = " ".join(str(part.get("value", "")) for part in about["args"])
            self.said.append((about["type"], words))
        elif method == "Runtime.exceptionThrown":
            self.said.append(("exception", json.dumps(about["exceptionDetails"])[:500]))
        elif method == "Log.entryAdded":
            self.said.append((about["entry"]["level"], about["entry"]["text"]))

    @property
    def complaints(self):
        """Errors and warnings of the console."""
        self.evaluate("0")
        return [
            (level, words)
            for level, words in self.said
            if level in ("error", "warning", "exception")
            and not any(known in words for known in NO_COMPLAINTS)
        ]

    def open(self, address):
        """Go there."""
        self.call("Page.navigate", url=address)

    def evaluate(self, script):
        """The value of an expression, of a promise as well."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script, seconds=30.0):
        """Until an expression is true; its value."""
        end = time.monotonic() + seconds
        # While a page is loaded, much of it is not there yet.
        within = f"(() => {{ try {{ return {script}; }} catch {{ return false; }} }})()"
        while not (value := self.evaluate(within)):
            assert time.monotonic() < end, f"not within {seconds} s: {script}"
            time.sleep(0.05)
        return value

    def picture(self, path):
        """Save what is seen."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))


@contextmanager
def opened(browser, folder, *, size=(1400, 900), more=()):
    """A browser with an empty page, started with more options."""
    options = ["--headless=new", "--no-sandbox", "--use-angle=swiftshader"]
    options += ["--enable-unsafe-swiftshader", "--hide-scrollbars", "--remote-debugging-port=0"]
    options += [f"--user-data-dir={folder}", f"--window-size={size[0]},{size[1]}"]
    process = subprocess.Popen(
        [browser, *options, *more, "about:blank"], stderr=subprocess.PIPE, text=True
    )
    try:
        port = None
        for line in process.stderr:
            if found := re.search(r"DevTools listening on ws://[^:]+:(\d+)/", line):
                port = int(found[1])
                break
        assert port is not None, "no browser"
        # Nobody reads what it says from here on.
        process.stderr.close()
        with connect(_page_of(port), max_size=None, compression=None) as socket:
            yield Page(socket)
    finally:
        process.kill()
        process.wait()


def _page_of(port):
    from urllib.request import urlopen

    for _ in range(100):
        with urlopen(f"http://127.0.0.1:{port}/json") as answer:
            pages = [each for each in json.load(answer) if each["type"] == "page"]
        if pages:
            return pages[0]["webSocketDebuggerUrl"]
        time.sleep(0.05)
    raise AssertionError("the browser has no page")
