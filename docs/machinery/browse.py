"""Open the built site in Chromium at two widths, and report defects that a reader would see.

    python -m docs.machinery.browse [SITE]                    build/docs by default
    python -m docs.machinery.browse [SITE] --pictures DIR     also saves a picture of every page

The defects are dead links and fragments, console messages, missing files, plots that are not drawn,
and pages that are wider than their window. A folder of reports can be checked, too. The exit status
is 1 if there is a defect, and 2 if there is no browser or no site.
"""

import functools
import html
import json
import re
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from html.parser import HTMLParser
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

SITE = Path(__file__).resolve().parents[2] / "build" / "docs"
WIDTHS = (1400, 390)
BROWSERS = ("chromium", "chromium-browser", "google-chrome")

# BokehJS reports its log level. The browser reports a page whose size changes during layout, which
# the frame causes here.
_NO_COMPLAINTS = ("setting log level to", "ResizeObserver loop completed")

# A page in a frame has the width of the frame, so one browser can open all pages.
_HARNESS = """\
<!doctype html><title>running</title><pre id="found"></pre><script>
const pages = PAGES, widths = WIDTHS, found = [];
const within = (root) => [...root.querySelectorAll("*")].flatMap(
  (one) => [one, ...(one.shadowRoot ? within(one.shadowRoot) : [])]);
const inked = (canvas) => canvas.width && canvas.height && canvas.getContext("2d")
  .getImageData(0, 0, canvas.width, canvas.height).data.some((part) => part > 0);
const wait = (ms) => new Promise((after) => setTimeout(after, ms));
const frame = document.body.appendChild(document.createElement("iframe"));
frame.height = 900;
(async () => {
  for (const width of widths) for (const page of pages) {
    frame.width = width;
    await new Promise((loaded) => { frame.onload = loaded; frame.src = page; });
    await wait(60);
    const body = frame.contentDocument.body, plots = [...body.querySelectorAll("[data-plot]")];
    for (let turn = 0; plots.length && !body.dataset.drawn && turn < 200; turn++) await wait(50);
    for (const plot of plots) {
      if (within(plot).some((one) => one.localName === "canvas" && inked(one))) continue;
      found.push(`${page} does not draw ${plot.dataset.plot} at ${width} px`);
    }
    for (const canvas of body.querySelectorAll("canvas.arm"))
      if (!inked(canvas)) found.push(`${page} does not draw the arm at ${width} px`);
    const wide = frame.contentDocument.documentElement.scrollWidth;
    if (wide > width) found.push(`${page} is ${wide} px wide in a window of ${width} px`);
  }
  document.getElementById("found").textContent = JSON.stringify(found);
  document.title = "done";
})();
</script>
"""


class _Links(HTMLParser):
    """The links and the fragments of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.links: list[str] = []
        self.fragments: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the links and the fragment of one element."""
        for name, value in attrs:
            if name == "id" and value:
                self.fragments.add(value)
            elif name == ("href" if tag in ("a", "link") else "src") and value is not None:
                self.links.append(value)


def dead_links(site: Path) -> list[str]:
    """Return the links within the site whose target does not exist."""
    pages = {}
    for path in site.rglob("*.html"):
        pages[path.resolve()] = parser = _Links()
        parser.feed(path.read_text(encoding="utf-8"))
    dead = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                continue
            target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            fragment = unquote(parts.fragment)
            known = pages[target].fragments if target in pages else None
            if not target.exists() or (fragment and known is not None and fragment not in known):
                dead.append(f"{path.relative_to(site.resolve())} links to {link}")
    return dead


class _Served(SimpleHTTPRequestHandler):
    """Server of the site and of the test page that opens it; it does not log requests."""

    harness = b""

    def do_GET(self) -> None:
        """Send a file or the test page."""
        if self.path != "/__harness__":
            return super().do_GET()
        self.send_response(200)
        self.send_header("Content-Type", "text/html; charset=utf-8")
        self.end_headers()
        self.wfile.write(self.harness)

    def log_message(self, format: str, *arguments: object) -> None:
        """Log nothing."""


@contextmanager
def _server(site: Path, pages: list[str]) -> Iterator[str]:
    """Serve the site on the local host only, and yield the address."""
    text = _HARNESS.replace("PAGES", json.dumps(pages)).replace("WIDTHS", json.dumps(WIDTHS))
    served = type("Served", (_Served,), {"harness": text.encode()})
    handler = functools.partial(served, directory=str(site))
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


def _chromium(browser: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    with tempfile.TemporaryDirectory() as profile:
        options = ["--headless", "--no-sandbox", "--disable-gpu", f"--user-data-dir={profile}"]
        return subprocess.run(
            [browser, *options, "--hide-scrollbars", "--enable-logging=stderr", *arguments],
            capture_output=True, text=True, timeout=600, check=False,
        )  # fmt: skip


def opened(site: Path, browser: str) -> list[str]:
    """Open all pages in a browser, and return the defects."""
    pages = sorted(f"/{path.relative_to(site)}" for path in site.rglob("*.html"))
    if not pages:
        return [f"there is no page in {site}"]
    # Virtual time, which passes immediately while the browser is idle.
    budget = 10_000 * len(pages) * len(WIDTHS)
    with _server(site, pages) as address:
        ended = _chromium(
            browser, "--dump-dom", f"--virtual-time-budget={budget}", f"{address}/__harness__"
        )
    wide = re.search(r'<pre id="found">(.+?)</pre>', ended.stdout, re.DOTALL)
    if wide is None:
        return [f"{browser} did not come to an end: {ended.stderr[-500:]}"]
    said = [line.partition("] ")[2] for line in ended.stderr.splitlines() if ":CONSOLE" in line]
    said = [line for line in said if not any(known in line for known in _NO_COMPLAINTS)]
    return [*json.loads(html.unescape(wide[1])), *dict.fromkeys(said)]


def pictures(site: Path, browser: str, folder: Path) -> None:
    """Save a picture of the top of every page at every width."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in sorted(site.rglob("*.html")):
        name = "-".join(path.relative_to(site).with_suffix("").parts)
        for width in WIDTHS:
            out = folder / f"{name}-{width}.png"
            _chromium(browser, f"--window-size={width},1600", f"--screenshot={out}", path.as_uri())


def installed() -> str | None:
    """Return the installed browser, or None."""
    return next(filter(None, map(shutil.which, BROWSERS)), None)


def main(words: list[str]) -> int:
    """Check the site and return the exit status."""
    folder = None
    if "--pictures" in words:
        place = words.index("--pictures")
        _, name = words[place : place + 2]
        folder, words = Path(name), words[:place] + words[place + 2 :]
    site = Path(words[0]) if words else SITE
    browser = installed()
    if browser is None or not any(site.rglob("*.html")):
        what = f"no browser, one of {', '.join(BROWSERS)}" if browser is None else f"no {site}"
        print(f"there is {what}: install it" if browser is None else f"{what}: make docs")
        return 2
    wrong = [*dead_links(site), *opened(site, browser)]
    print("\n".join(wrong) or "nothing is wrong")
    if folder is not None:
        pictures(site, browser, folder)
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
