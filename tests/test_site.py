"""What makes the site of the documentation, and the site itself where `make docs` has built it."""

import json
import re
from pathlib import Path

import pytest

from docs.machinery import browse, commands, docstrings, files, notebooks, pictures
from giajax.schema import KINDS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]


@pytest.mark.quick
def test_every_picture_is_drawn_here_shown_and_small():
    drawn = {name for names in pictures.PICTURES for name in names.split()}
    stored = {path.name for path in pictures.FOLDER.iterdir()}
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert drawn == stored == set(re.findall(r"!\[[^\]]+\]\((?:docs/)?pictures/([^)]+)\)", text))
    assert all(path.stat().st_size < 1_000_000 for path in pictures.FOLDER.iterdir())


@pytest.mark.quick
def test_every_page_has_its_place_on_the_site():
    places = (DOCS / "index.md").read_text(encoding="utf-8").split()
    missing = [page.stem for page in DOCS.glob("*.md") if page.stem not in (*places, "index")]
    assert missing == [], "add them to a list of docs/index.md"


@pytest.mark.quick
def test_the_references_have_every_command_and_every_section():
    help_of_all, sections = commands.page(), files.page()
    assert re.findall(r"^## giajax (\w+)$", help_of_all, re.MULTILINE)[:2] == ["check", "fit"]
    assert "--hold-out" in help_of_all
    for kind in KINDS.values():
        for name, section in kind.all_sections.items():
            assert f"\n## [{name}]\n" in sections
            assert all(f"| `{key}` |" in sections for key in section.model_fields)


@pytest.mark.quick
def test_a_docstring_is_plain_text_with_code():
    lines = ["|V| V of `a_ * b_`, which", "is `code", "*here*`; and x_ too", ">>> 2 * x_"]
    assert docstrings.escaped(lines) == [
        r"\|V\| V of `a_ * b_`, which", "is `code", r"*here*`; and x\_ too", ">>> 2 * x_",
    ]  # fmt: skip


@pytest.mark.quick
def test_a_notebook_is_its_text_and_code():
    cells = [
        {"cell_type": "markdown", "source": ["# A\n", "text"]},
        {"cell_type": "code", "source": ["x = 1"]},
    ]
    shown = notebooks.markdown(json.dumps({"cells": cells}))
    assert shown == "# A\ntext\n\n```python\nx = 1\n```\n"


@pytest.mark.quick
def test_a_dead_link_is_seen(tmp_path):
    (tmp_path / "a.html").write_text('<p id="here"><a href="#here">a</a><a href="b.html#x">b</a>')
    (tmp_path / "b.html").write_text('<a href="a.html#gone">a</a><img src="c.png">')
    assert sorted(browse.dead_links(tmp_path)) == [
        "a.html links to b.html#x",
        "b.html links to a.html#gone",
        "b.html links to c.png",
    ]


@pytest.fixture
def site():
    if not (browse.SITE / "index.html").exists():
        pytest.skip("the site is not built: make docs")
    return browse.SITE


@pytest.mark.slow
def test_no_link_of_the_site_is_dead(site):
    assert browse.dead_links(site) == []


@pytest.mark.slow
def test_a_browser_has_nothing_to_say_of_the_site(site, browser):
    assert browse.opened(site, browser) == []
