"""A headless Chromium that a test controls by the DevTools protocol over a WebSocket."""

import base64
import itertools
import json
import re
import subprocess
import time
from contextlib import contextmanager

from websockets.sync.client import connect

# Console messages of viser and Chromium that are not errors.
NO_COMPLAINTS = (
    "Detected chrome version",
    "WebGL support",
    "Embedded data loaded",
    "THREE.Clock",
    "GPU stall due to ReadPixels",
    "GroupMarkerNotSet",
    "does not support reading pixels from",  # where `Page.draw_no_scene` omits the drawing
)

_NO_SCENE = """
for (const how of ["Arrays", "ArraysInstanced", "Elements", "ElementsInstanced"])
  WebGL2RenderingContext.prototype["draw" + how] = () => {};
"""


class Page:
    """One page of a browser."""

    def __init__(self, socket):
        self._socket = socket
        self._numbers = itertools.count(1)
        self.said = []
        for domain in ("Page", "Runtime", "Log"):
            self.call(f"{domain}.enable")

    def call(self, method, **parameters):
        """Send one command of the protocol and return its result; keep events that arrive."""
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
        """Return errors and warnings of the console."""
        self.evaluate("0")
        return [
            (level, words)
            for level, words in self.said
            if level in ("error", "warning", "exception")
            and not any(known in words for known in NO_COMPLAINTS)
        ]

    def open(self, address):
        """Open an address."""
        self.call("Page.navigate", url=address)

    def draw_no_scene(self):
        """Omit the triangles of WebGL, whose drawing in software takes most time, from now on."""
        self.call("Page.addScriptToEvaluateOnNewDocument", source=_NO_SCENE)

    def evaluate(self, script):
        """Return the value of an expression, or of a promise."""
        found = self.call(
            "Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True
        )
        assert "exceptionDetails" not in found, found
        return found["result"].get("value")

    def wait(self, script, seconds=30.0):
        """Wait until an expression is true, and return its value."""
        end = time.monotonic() + seconds
        # While a page is loading, objects may be missing.
        within = f"(() => {{ try {{ return {script}; }} catch {{ return false; }} }})()"
        while not (value := self.evaluate(within)):
            assert time.monotonic() < end, f"not within {seconds} s: {script}"
            time.sleep(0.05)
        return value

    def picture(self, path):
        """Save a screenshot."""
        data = self.call("Page.captureScreenshot", format="png")["data"]
        path.write_bytes(base64.b64decode(data))


@contextmanager
def opened(browser, folder, *, size=(1400, 900), more=()):
    """Start a browser with an empty page and further options."""
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
        # Nothing reads its error output from here on.
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
