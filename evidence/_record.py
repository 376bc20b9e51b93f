"""The file of a study: its figures, and what they depend on."""

import json
import os
import platform
import subprocess
import time
from importlib.metadata import version
from pathlib import Path
from typing import Any

from ._study import Study

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "docs" / "evidence"

LIBRARIES = ("giajax", "jax", "jaxlib", "diffrax", "equinox", "optimistix", "lineax", "numpy")
# What the figures depend on; the files of figures themselves do not count as changes.
SOURCES = ("src", "evidence", "constraints.txt")


def record(study: Study, size: int, seed: int) -> dict[str, Any]:
    """Run a study.

    Arguments:
        study: which.
        size: number of repetitions.
        seed: of the random numbers.

    Returns:
        The content of its file: figures, size, seed, commit, versions, machine and time, s.
    """
    # Before the run: what is committed meanwhile is not what runs.
    of = _git("rev-parse", "HEAD")
    # Figures of a working tree that no commit holds cannot be had again.
    changed = commit() is None
    began = time.perf_counter()
    figures = study.run(size, seed)
    return {
        "study": study.name,
        "size": size,
        "seed": seed,
        "commit": of,
        "uncommitted_changes": changed,
        "versions": {
            "python": platform.python_version(),
            **{library: version(library) for library in LIBRARIES},
        },
        "machine": {"system": platform.system(), "cores": os.cpu_count()},
        "seconds": round(time.perf_counter() - began, 1),
        "figures": figures,
    }


def commit() -> str | None:
    """The commit whose code runs; None where no commit holds it."""
    if _git("status", "--porcelain", "--", *SOURCES) != "":
        return None
    return _git("rev-parse", "HEAD")


def _git(*arguments: str) -> str | None:
    """What git prints; None outside of a repository, such as in a source distribution."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def write(content: dict[str, Any], folder: Path = FOLDER) -> Path:
    """Write NAME.json into a folder; returns its path."""
    from giajax.runtime.records import plain_data

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{content['study']}.json"
    # What is no number is null: a study that ran for an hour is not lost for it.
    text = json.dumps(plain_data(content), indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def read(study: Study) -> dict[str, Any]:
    """The stored file of a study.

    Raises:
        FileNotFoundError: it was never run.
    """
    content: dict[str, Any] = json.loads((FOLDER / f"{study.name}.json").read_text("utf-8"))
    return content
