"""Draw random paragraphs from pages, help texts and messages for reviewers of the language.

python -m docs.machinery.paragraphs SEED [NUMBER]   (default: 40, half of them from pages)
"""

import ast
import random
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_LEAST = 8  # a paragraph must have more words than this
_SENTENCE = re.compile(r"[a-z]{2} [a-z]+ ")


def of_pages() -> list[str]:
    """Return the paragraphs and list items of all pages, without code and tables."""
    found = []
    for path in [
        ROOT / "README.md",
        ROOT / "CONTRIBUTING.md",
        *sorted((ROOT / "docs").glob("*.md")),
    ]:
        text = re.sub(r"^```.*?^```$", "", path.read_text(encoding="utf-8"), flags=re.S | re.M)
        for block in re.split(r"\n\s*\n|\n(?=\s*(?:-|\d+\.) )", text):
            if not block.lstrip().startswith(("|", "#", "!", "<", "(", ":")):
                found.append(f"{path.name}: {' '.join(block.split())}")
    return found


def docstrings_of(tree: ast.Module) -> set[str | None]:
    """Return all docstrings of a module."""
    kinds = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    return {ast.get_docstring(n, clean=False) for n in ast.walk(tree) if isinstance(n, kinds)}


def of_sources() -> tuple[list[str], list[str]]:
    """Return the help texts of the program, and its other sentences (results and errors)."""
    helps, messages = [], []
    for path in sorted((ROOT / "src").rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        docstrings = docstrings_of(tree)
        parts = {id(v) for n in ast.walk(tree) if isinstance(n, ast.JoinedStr) for v in n.values}
        for node in ast.walk(tree):
            if isinstance(node, ast.JoinedStr):
                text = ast.unparse(node)[2:-1]
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                if id(node) in parts or node.value in docstrings:
                    continue
                text = node.value
            else:
                continue
            if _SENTENCE.search(text) and path.parent.name == "cli":
                helps.append(f"{path.name}: {' '.join(text.split())}")
            elif _SENTENCE.search(text):
                messages.append(f"{path.name}: {' '.join(text.split())}")
    return helps, messages


def drawn(seed: int, number: int = 40) -> list[str]:
    """Draw half of the paragraphs from pages and a quarter each from help texts and messages."""
    helps, messages = of_sources()
    sources = ((of_pages(), number // 2), (helps, number // 4), (messages, number // 4))
    chance = random.Random(seed)
    return [
        text
        for texts, count in sources
        for text in chance.sample([t for t in texts if len(t.split()) > _LEAST], count)
    ]


if __name__ == "__main__":
    for place, paragraph in enumerate(drawn(*map(int, sys.argv[1:])), 1):
        print(f"{place}. {paragraph}\n")
