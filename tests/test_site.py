"""The generator of the documentation site, and the site itself if `make docs` has built it."""

import inspect
import re
from pathlib import Path

import nbformat
import pytest

import giajax
from docs.machinery import api, browse, commands, docstrings, files, notebooks, pictures
from giajax.cli import _app
from giajax.cli._commands import GROUPS
from giajax.schema import KINDS

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.glob("*.md"))]


@pytest.mark.quick
def test_every_picture_is_drawn_here_shown_and_small():
    drawn = pictures.shown().keys()
    stored = {path.name for path in pictures.FOLDER.iterdir()}
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert drawn == stored == set(re.findall(r"!\[[^\]]+\]\((?:docs/)?pictures/([^)]+)\)", text))
    assert all(path.stat().st_size < 1_000_000 for path in pictures.FOLDER.iterdir())


@pytest.mark.quick
def test_every_picture_of_the_gallery_has_the_command_that_draws_it():
    """test_readme.py checks the commands of every page."""
    shown = pictures.shown()
    assert len(shown) >= 20
    for name, lines in shown.items():
        words = lines[-1].split()
        if name in pictures.DRAWN_HERE:
            assert lines == [f"python -m docs.machinery.pictures {name}"]
        else:
            assert all(line.startswith("giajax ") for line in lines), name
            # The last command writes the picture to the folder of its result.
            out, comment, file = words[-3:]
            assert (comment, file.rpartition("/")[0]) == ("#", out.removeprefix("giajax-out/")), (
                name
            )


# Commands that take seconds; the others run before a release.
DRAWN = [
    "fig5.png",
    "joint.png",
    "equilibria.png",
    "filling.png",
    "filling_curve.png",
    "unrolling.png",
]


@pytest.mark.long
def test_commands_of_the_gallery_draw_their_pictures(tmp_path, capsys):
    found = dict(pictures.drawn(DRAWN, tmp_path))
    assert list(found) == DRAWN
    assert all(contents.startswith(b"\x89PNG") for contents in found.values())


@pytest.mark.long
def test_all_commands_of_the_gallery_draw_their_pictures(tmp_path, capsys):
    names = [name for name in pictures.shown() if name not in {*DRAWN, *pictures.DRAWN_HERE}]
    found = dict(pictures.drawn(names, tmp_path))
    assert all(contents.startswith(b"\x89PNG") for contents in found.values())


@pytest.mark.quick
def test_every_page_has_its_place_on_the_site():
    places = (DOCS / "index.md").read_text(encoding="utf-8").split()
    missing = [page.stem for page in DOCS.glob("*.md") if page.stem not in (*places, "index")]
    assert missing == [], "add them to a list of docs/index.md"


@pytest.mark.quick
def test_the_references_have_every_command_and_every_section():
    shown, sections = commands.page(), files.page()
    assert re.findall(r"^## giajax (\w+)$", shown, re.MULTILINE) == _app.command_names()
    assert re.findall(r"^\| \[`giajax (\w+)`\]\(#giajax-\1\) \|", shown, re.MULTILINE) == (
        _app.command_names()
    )
    assert [title for title in GROUPS.values() if f"\n## {title}\n" not in shown] == []
    assert "\n| `--hold-out NAME` | " in shown
    assert "\n| `--free PATH[=SD]` | " in shown
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
def test_a_notebook_is_its_text_its_code_and_what_it_shows():
    output, picture = nbformat.v4.new_output, {"image/png": "aGk=\n", "text/plain": "<Figure>"}
    outputs = [
        output("stream", text="1 2\n"),
        output("display_data", data=picture),
        output("execute_result", data={"text/html": "<table></table>", "text/plain": "a table"}),
        output("execute_result", data={"text/plain": "3"}),
    ]
    text = nbformat.v4.new_markdown_cell("# A\ntext")
    code = nbformat.v4.new_code_cell("x = 1", outputs=outputs)
    shown = notebooks.markdown(nbformat.v4.new_notebook(cells=[text, code]))
    assert shown == (
        "# A\ntext\n\n```python\nx = 1\n```\n\n```text\n1 2\n```\n\n"
        "![Drawn by the code above](data:image/png;base64,aGk=)\n\n"
        '```{raw} html\n<div class="table-wrapper"><table></table></div>\n```\n\n'
        "```text\n3\n```\n"
    )


@pytest.mark.quick
def test_every_public_name_has_a_place_and_an_example():
    public = [name for name in giajax.__all__ if not inspect.ismodule(getattr(giajax, name))]
    named = [name.removeprefix("giajax.") for names in api.topics().values() for name in names]
    assert sorted(named) == sorted({*public} - {"__version__"})
    in_docstrings = {name for name in named if ">>>" in inspect.getdoc(getattr(giajax, name))}
    assert {*named} - in_docstrings - api.examples().keys() == set(), "docs/python_examples.md"
    assert api.examples().keys() <= {*named} - in_docstrings
    (page,) = [
        text for text in api.pages().values() if ".. autofunction:: giajax.predict\n" in text
    ]
    assert ".. code-block:: python\n\n      predicted = giajax.predict(" in page


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
