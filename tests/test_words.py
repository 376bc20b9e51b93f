"""Phrases to avoid in pages, help texts and messages, with replacements (`docs/writing.md`)."""

import ast
import json
import re
from pathlib import Path

import pytest

from docs.machinery.paragraphs import docstrings_of

pytestmark = pytest.mark.quick

ROOT = Path(__file__).parents[1]
REPLACEMENTS = {
    r"(?:tell|tells|telling|told) (?:\w+ )?apart": "distinguish",
    r"(?:data|fit|it|model|residuals|suspect|that) asks? for": "requires, depends on, suggests",
    r"hangs? on": "depends on",
    r"foretells?|foresees?|foreseen": "predicts, expects",
    r"mend(?:s|ed|ing)?": "corrects, repairs",
    r"nobody|somebody": "name the thing or the person",
    r"(?<!there )(?:is|are) none of": "is not one of, does not",
    r"(?<!there )(?:is|are) no (?!longer\b|more\b|less\b|such\b)": "is not a, does not",
    r"anew": "again, new",
    r"(?:go|goes|going|gone|went) on from": "continues from, a warm start from",
    r"in all digits": "at full precision",
    r"by which it got there": "name what was computed",
    r"which no fit meets|what does it \w+ on": "cannot be reproduced; depends on",
}
PHRASES = [
    (re.compile(rf"\b(?:{phrase})" + r"\b" * (phrase[-1] != ")"), re.IGNORECASE), instead)
    for phrase, instead in REPLACEMENTS.items()
]
# This page quotes the phrases, and former names and paths cannot change.
QUOTES = {"writing.md", "aliases.py", "identities.py"}
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md")),
    *(ROOT / name / "README.md" for name in ("benchmarks", "docs/evidence")),
    *sorted((ROOT / "docs").glob("*.md")),
    *sorted((ROOT / "notebooks").glob("*.ipynb")),
]
SOURCES = sorted((ROOT / "src").rglob("*.py"))
SCRIPTS = sorted(path for path in (ROOT / "src").rglob("*") if path.suffix in (".html", ".js"))


def phrases_in(text):
    """Return each phrase to replace, with its line in the text."""
    # A phrase may be split over two lines.
    joined = re.sub(r"\s", " ", text)
    return [
        (text.count("\n", 0, match.start()), f"{match[0]!r}: write {instead}")
        for phrase, instead in PHRASES
        for match in phrase.finditer(joined)
    ]


def phrases_of(path):
    """Return the phrases of a page, of the text of a notebook, or of the strings of a module."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".ipynb":
        return [
            (f"cell {number}", what)
            for number, cell in enumerate(json.loads(text)["cells"], 1)
            if cell["cell_type"] == "markdown"
            for _, what in phrases_in("".join(cell["source"]))
        ]
    if path.suffix != ".py":
        return [(line + 1, what) for line, what in phrases_in(text)]
    return [
        (node.lineno + line, what)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
        for line, what in phrases_in(node.value)
    ]


# Templates for `format`, patterns, and lines of a style file.
_TEMPLATES = {"_fit.py", "_foreign.py", "_arm_figures.py", "_tracker.py", "_simulate.py"}
_NAMED = re.compile(r"\{_?[a-zA-Z_][\w.]*(:[^{}]*)?\}|\{[^{}]*\w\([^{}]*\)[^{}]*\}")


def test_no_message_lost_its_f():
    """A string with the name of a value in braces must be an f-string."""
    found = []
    for path in SOURCES:
        tree = ast.parse(path.read_text())
        docstrings = docstrings_of(tree)
        found += [
            f"{path.name}:{node.lineno}: {node.value}"
            for node in ast.walk(tree)
            if isinstance(node, ast.Constant) and isinstance(node.value, str)
            if node.value not in docstrings and "\n" not in node.value
            if path.name not in _TEMPLATES and _NAMED.search(node.value)
        ]
    assert found == []


@pytest.mark.parametrize("paths", [PAGES, SOURCES, SCRIPTS], ids=["pages", "sources", "scripts"])
def test_phrases_are_those_of_the_field(paths):
    assert len(paths) > 2
    found = [
        f"{path.relative_to(ROOT)}:{line}: {what}"
        for path in paths
        if path.name not in QUOTES
        for line, what in phrases_of(path)
    ]
    assert found == [], "\n".join(found)


@pytest.mark.parametrize(
    ("text", "count"),
    [
        ("The data tell\nthem apart.", 1),
        ("What the residuals ask for is no model.", 2),
        ("There is no model. It is no longer used.", 0),
        ("Depends on the drag.", 0),
        ("Everything hangs on it, and nobody mended it.", 3),
        ("He recommended an amendment.", 0),
    ],
)
def test_the_list_finds_what_it_names(text, count):
    assert len(phrases_in(text)) == count
