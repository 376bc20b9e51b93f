"""The file of a study: its figures, and the versions that they depend on."""

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
# Files on which figures depend. The stored figures themselves do not count as changes.
SOURCES = ("src", "evidence", "constraints.txt")


def record(study: Study, size: int, seed: int) -> dict[str, Any]:
    """Run a study.

    Arguments:
        study: the study.
        size: number of repetitions.
        seed: seed of the random numbers.

    Returns:
        The contents of its file: figures, size, seed, commit, versions, machine and time, s.
    """
    # Read before the run, because a commit during the run does not change the running code.
    of = _git("rev-parse", "HEAD")
    # Figures of uncommitted code cannot be reproduced.
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
    """Return the commit whose code runs; None if the code is not committed."""
    if _git("status", "--porcelain", "--", *SOURCES) != "":
        return None
    return _git("rev-parse", "HEAD")


def _git(*arguments: str) -> str | None:
    """Return the output of git; None outside a repository, such as in a source distribution."""
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
        )
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()


def write(content: dict[str, Any], folder: Path = FOLDER) -> Path:
    """Write NAME.json to a folder; return its path."""
    from giajax.runtime.records import plain_data

    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{content['study']}.json"
    # NaN is stored as null, because an error here would lose a study that ran for an hour.
    text = json.dumps(plain_data(content), indent=2, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")
    return path


def read(study: Study) -> dict[str, Any]:
    """Read the stored file of a study.

    Raises:
        FileNotFoundError: the study was never run.
    """
    content: dict[str, Any] = json.loads((FOLDER / f"{study.name}.json").read_text("utf-8"))
    return content
