"""Convert notebooks to pages with their text, their code and its output.

Notebooks are stored without outputs. Each is executed once, and its outputs are kept in
`build/notebooks` until the notebook, the source of giajax or the installed packages change. If
GIAJAX_SHORT is set in the environment, the short form of each notebook is executed and kept
separately. CI builds the site in this way, and the tests of the notebooks then use the same
executions.
"""

import hashlib
import os
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from importlib import metadata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "build" / "notebooks"
_SOURCES = {".py", ".js", ".css", ".html", ".toml", ".md"}

# Kernels keep compiled programs and need no display. The last variable avoids a Jupyter warning.
_VARIABLES = {
    "JAX_COMPILATION_CACHE_DIR": str(ROOT / ".jax_cache"),
    "MPLBACKEND": "agg",
    "JUPYTER_PLATFORM_DIRS": "1",
}


def paths(root: Path = ROOT) -> list[Path]:
    """Return the notebooks of the project."""
    return sorted((root / "notebooks").glob("*.ipynb"))


def executed(path: Path, kept: Path = KEPT) -> Any:
    """Return a notebook with its outputs, kept ones or those of a new kernel in an empty folder.

    Raises:
        nbclient.exceptions.CellExecutionError: a cell raises an exception; nothing is kept.
    """
    form = "short" if "GIAJAX_SHORT" in os.environ else "full"
    place = kept / f"{path.stem}-{form}-{_key(path)}.ipynb"
    if place.exists():
        return nbformat.read(place, as_version=4)
    notebook = nbformat.read(path, as_version=4)
    with TemporaryDirectory() as folder:
        resources = {"metadata": {"path": folder}}
        client = NotebookClient(notebook, timeout=3600, kernel_name="python3", resources=resources)
        client.execute(env=_VARIABLES | os.environ)
    kept.mkdir(parents=True, exist_ok=True)
    # Another process may write or read the same file now, so the complete file is moved into place.
    own = place.with_suffix(f".{os.getpid()}")
    nbformat.write(notebook, own)
    own.replace(place)
    for old in {*kept.glob(f"{path.stem}-{form}-*.ipynb")} - {place}:
        old.unlink()
    return notebook


def _key(path: Path) -> str:
    """Return a checksum of everything on which the outputs of a notebook depend."""
    installed = sorted(f"{each.name} {each.version}" for each in metadata.distributions())
    found = hashlib.sha256(f"{sys.version} {installed}".encode())
    sources = (each for each in (ROOT / "src").rglob("*") if each.suffix in _SOURCES)
    for each in (path, Path(__file__), *sorted(sources)):
        found.update(each.read_bytes())
    return found.hexdigest()[:16]


def pages(of: list[Path]) -> list[str]:
    """Return executed notebooks as Markdown; two kernels run at a time."""
    with ThreadPoolExecutor(2) as pool:
        return list(pool.map(lambda path: markdown(executed(path)), of))


def markdown(notebook: Any) -> str:
    """Return a notebook as Markdown with embedded pictures."""
    parts = []
    for cell in notebook.cells:
        code = cell.cell_type == "code"
        parts.append(f"```python\n{cell.source}\n```" if code else cell.source)
        parts += _shown(cell.outputs) if code else []
    return "\n\n".join(parts) + "\n"


def _shown(outputs: list[Any]) -> Iterator[str]:
    """Yield the printed text of a cell, and the richest form of its other outputs."""
    for output in outputs:
        data = {"text/plain": output.text} if output.output_type == "stream" else output.data
        if "image/png" in data:
            picture = "".join(data["image/png"].split())
            yield f"![Drawn by the code above](data:image/png;base64,{picture})"
        elif "text/html" in data:
            yield f'```{{raw}} html\n<div class="table-wrapper">{data["text/html"]}</div>\n```'
        else:
            yield f"```text\n{data['text/plain'].rstrip()}\n```"
