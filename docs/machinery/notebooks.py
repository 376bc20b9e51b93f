"""Notebooks as pages: their text and their code. Nothing is executed: they have no outputs."""

import json
from pathlib import Path


def paths(root: Path) -> list[Path]:
    """The notebooks of the project."""
    return sorted((root / "notebooks").glob("*.ipynb"))


def markdown(text: str) -> str:
    """A notebook as Markdown."""
    parts = []
    for cell in json.loads(text)["cells"]:
        source = "".join(cell["source"])
        code = cell["cell_type"] == "code"
        parts.append(f"```python\n{source}\n```" if code else source)
    return "\n\n".join(parts) + "\n"
