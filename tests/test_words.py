"""Words that the pages, the help and the messages avoid, each with its replacement."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Phrases that readers of the field do not know, and what to write; docs/writing.md has examples.
REPLACEMENTS = {
    r"(?:tell|tells|told|telling) (?:\w+ )?apart": "distinguish",
    r"tells(?! apart)": "shows, states, reports",
    r"asks? for": "requires, depends on, suggests",
    r"hangs? on": "depends on",
    r"foretells?|foretold|foresees?|foreseen": "predict, expect",
    r"mend(?:s|ed|ing)?": "correct, repair",
    r"nobody|somebody": "name who or what it is",
    r"(?:is|are) none of": "is not a",
    r"(?<!there )(?:is|are) no(?= (?!longer\b|more\b|less\b))": "is not a, does not",
    r"anew": "again, new",
    r"(?:go|goes|going|gone|went) on from": "continue from, a warm start from",
    r"in all digits": "at full precision",
    r"as (?:it|they) will": "delete it, or name the condition",
    r"holds? for nothing|by heart|takes? at its word": "state it plainly",
}
PHRASES = {
    re.compile(rf"\b(?:{phrase})\b", re.IGNORECASE): new for phrase, new in REPLACEMENTS.items()
}
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
SOURCES = sorted((ROOT / "src").rglob("*.py"))


def found_in(text, line=1):
    """Each avoided phrase with its line, and its replacement."""
    text = re.sub(r"\s+", lambda m: "\n" if "\n" in m[0] else " ", text)
    for phrase, new in PHRASES.items():
        for match in phrase.finditer(text):
            yield line + text.count("\n", 0, match.start()), match[0], new


def texts_of(source):
    """The strings of a module with their lines: messages, helps and docstrings."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
