"""A Sphinx extension that generates pages at each build and resolves links out of `docs`.

The pages are written for the repository, where a link may lead to `../CONTRIBUTING.md` or to a
notebook. On the site, these files are pages, too. They are written to `docs/_generated`, and every
link to one of them is changed accordingly.
"""

import os
import re
from pathlib import Path
from typing import Any

from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

from . import api, commands, files, notebooks

DOCS = Path(__file__).resolve().parents[1]
ROOT = DOCS.parent
MADE = DOCS / "_generated"

_LINK = re.compile(r"(\]\()([^)#:\s]+)((?:#[^)\s]*)?\))")


def _outside() -> list[Path]:
    """Return the Markdown files and notebooks outside `docs` that are pages of the site."""
    own = [ROOT / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "benchmarks/README.md")]
    return [*own, *sorted((ROOT / "data").rglob("README.md")), *notebooks.paths(ROOT)]


def _page(path: Path) -> Path:
    """Return the file that Sphinx reads as the page of a source file."""
    if path == ROOT / "README.md":
        return DOCS / "index.md"
    return MADE / path.relative_to(ROOT).with_suffix(".md") if path in _outside() else path


def _outside_texts() -> dict[Path, str]:
    """Return the Markdown of each file from outside `docs`; every page has a title."""
    of = notebooks.paths(ROOT)
    texts = dict(zip(of, notebooks.pages(of), strict=True))
    return {path: texts.get(path) or _text(path) for path in _outside()}


def _text(path: Path) -> str:
    text = path.read_text(encoding="utf-8")
    title = path.parent.name.replace("_", " ").capitalize()
    return text if text.startswith("# ") else f"# {title}\n\n{text}"


def linked(text: str, origin: Path, page: Path) -> str:
    """Change the relative links of a Markdown text, which moves from `origin` to `page`."""

    def moved(match: re.Match[str]) -> str:
        target = Path(os.path.normpath(origin.parent / match[2]))
        if not target.exists():
            return match[0]
        return match[1] + os.path.relpath(_page(target), page.parent) + match[3]

    return _LINK.sub(moved, text)


def _pages() -> dict[Path, str]:
    """Return the text of each generated page, by its file."""
    texts = _outside_texts()
    made = {_page(path): linked(text, path, _page(path)) for path, text in texts.items()}
    made[MADE / "commands.md"] = commands.page()
    made[MADE / "files.md"] = files.page()
    return made | {MADE / "api" / f"{name}.md": text for name, text in api.pages().items()}


def _make(app: Sphinx) -> None:
    """Write only the pages that differ, so Sphinx reads only these again."""
    made = _pages()
    for path, text in made.items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
    for path in set(MADE.rglob("*.md")) - set(made):
        path.unlink()


def _read(app: Sphinx, name: str, source: list[str]) -> None:
    """Change the links of a page; the front page is the README followed by index.md."""
    if name.startswith(MADE.name):
        return
    page = DOCS / f"{name}.md"
    source[0] = linked(source[0], page, page)
    if name == "index":
        readme = ROOT / "README.md"
        app.env.note_dependency(str(readme), docname=name)
        source[0] = linked(readme.read_text(encoding="utf-8"), readme, page) + "\n" + source[0]


def _find(app: Sphinx, env: BuildEnvironment, node: pending_xref, content: Any) -> Any:
    """Resolve a class that an annotation names by its private module to its public name."""
    if node["refdomain"] != "py":
        return None
    last = node["reftarget"].rpartition(".")[2]
    known = env.domains.python_domain.objects
    for name in (f"giajax.{last}", *(f"giajax.{room}.{last}" for room in api.rooms())):
        if name in known:
            return env.domains.python_domain.resolve_xref(
                env, node["refdoc"], app.builder, "obj", name, node, content
            )
    return None


def setup(app: Sphinx) -> dict[str, Any]:
    """Connect the functions to Sphinx."""
    app.connect("builder-inited", _make)
    app.connect("source-read", _read)
    app.connect("missing-reference", _find)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
