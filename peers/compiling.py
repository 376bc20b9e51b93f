"""C sources compiled where they are used, by the compiler that the machine has."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

SOURCES = Path(__file__).resolve().parent
# Times with -O1, -O2 and -ffast-math differed by less than the noise of a busy machine, which put
# them in another order for each method; -O3 was not timed beside them.
FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")


class CompilerError(RuntimeError):
    """The machine lacks what a peer in C needs; the message is a sentence that says what."""


def compiled(source: Path, *arguments: str) -> ctypes.CDLL:
    """A C source as a library of this process; nothing of it stays on disk.

    Arguments:
        source: the file.
        arguments: what else the compiler is told, such as `-I` and libraries.

    Raises:
        CompilerError: no C compiler is there, or it refuses the source.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise CompilerError("no C compiler is there: install one (cc, gcc or clang)")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / f"{source.stem}.so"
        command = [compiler, *FLAGS, str(source), "-o", str(library), *arguments, "-lm", "-pthread"]
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise CompilerError(f"{source.name} does not compile: {ended.stderr.strip()}")
        return ctypes.CDLL(str(library))


def address(array: object) -> ctypes.c_void_p:
    """Where the numbers of a contiguous array are, for a C function."""
    return ctypes.c_void_p(array.ctypes.data)  # type: ignore[attr-defined]
