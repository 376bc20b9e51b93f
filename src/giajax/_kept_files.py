"""The files of programs that are kept: what they depend on, and how they are read and written."""

import functools
import hashlib
import sys
import tempfile
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path

SUFFIX = ".stablehlo"
"""Of the files' names."""

_LIBRARIES = ("jax", "jaxlib", "equinox", "diffrax", "optimistix", "lineax", "numpy")


def sources() -> str:
    """What tracing depends on beside the arguments: the source of this package, and versions."""
    digest = hashlib.sha256(sys.version.encode())
    for name in _LIBRARIES:
        digest.update(f"{name} {version(name)}\n".encode())
    # Of the whole package, wherever in it this module lies.
    root = Path(str(files(__name__.partition(".")[0])))
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)}\0".encode())
        digest.update(path.read_bytes())
    return digest.hexdigest()


@functools.cache
def origin() -> str:
    """`sources`, as they were when the process began to keep programs."""
    return sources()


def read(path: Path) -> bytes:
    """A module as it was written.

    Raises:
        OSError: there is no such file, or it cannot be read.
        ValueError: it is cut off, or was changed.
    """
    content = path.read_bytes()
    digest, module = content[:32], content[32:]
    if hashlib.sha256(module).digest() != digest:
        raise ValueError(f"{path} is not as it was written")
    return module


def write(path: Path, module: bytes) -> None:
    """Write a file whole, or not at all; another process may write the same one."""
    temporary = None
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=path.parent, suffix=SUFFIX, delete=False) as file:
            temporary = Path(file.name)
            file.write(hashlib.sha256(module).digest() + module)
        temporary.replace(path)
    except OSError:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
