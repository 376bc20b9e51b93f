"""A page runs only its own scripts, and loads nothing from elsewhere."""

import re

import pytest

from browsing import opened
from giajax.runtime.page_policy import with_policy

PAGE = b"""<!doctype html><html><head><meta charset="utf-8"><title>a page</title>
<style>p { color: rgb(1, 2, 3) }</style></head><body><p>here</p><img src="picture.svg">
<script type="application/json" id="data">{"a": 1}</script>
<script>window.own = JSON.parse(document.getElementById("data").textContent).a;</script>
</body></html>
"""

# The content that a malicious name of a run would add to a page.
EVIL = b"""<script>window.evil = 1</script><img src="nothing" onerror="window.evil = 1">
<a id="link" href="javascript:window.evil = 1">a</a></body>"""


@pytest.mark.quick
def test_a_page_says_first_what_it_may_do():
    page = with_policy(PAGE)
    (said,) = re.findall(rb'<meta http-equiv="Content-Security-Policy" content="(.*?)">', page)
    assert page.index(said) < page.index(b"<style>")
    assert len(re.findall(rb"'sha256-[^']{44}'", said)) == 1
    assert b"script-src 'sha256-" in said
    assert (
        page.replace(b'<meta http-equiv="Content-Security-Policy" content="' + said + b'">\n', b"")
        == PAGE
    )
    assert b"script-src 'none';" in with_policy(b"<head><style></style></head>")
    with pytest.raises(AssertionError, match="that the policy could precede"):
        with_policy(b"<p>nowhere to put it</p>")


def test_a_browser_runs_no_other_script(browser, tmp_path):
    (tmp_path / "picture.svg").write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="7" height="7"></svg>'
    )
    for name, page in (("good", with_policy(PAGE)), ("open", PAGE)):
        (tmp_path / f"{name}.html").write_bytes(page)
        (tmp_path / f"{name}_evil.html").write_bytes(page.replace(b"</body>", EVIL))
    with opened(browser, tmp_path / "profile") as page:
        page.open((tmp_path / "good.html").as_uri())
        page.wait("window.own == 1 && document.images[0].naturalWidth == 7")
        assert page.evaluate("getComputedStyle(document.querySelector('p')).color") == (
            "rgb(1, 2, 3)"
        )
        assert not page.complaints
        for name, runs in (("good_evil", False), ("open_evil", True)):
            page.open((tmp_path / f"{name}.html").as_uri())
            page.wait(f"location.href.includes('{name}') && window.own == 1")
            page.evaluate("document.getElementById('link').click()")
            page.evaluate("fetch('http://127.0.0.1:9/').catch(() => 0)")
            assert page.evaluate("window.evil == 1") is runs
