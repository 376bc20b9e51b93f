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
    """A peer in C cannot be made; the message is a sentence that says why."""


class NoCompilerError(CompilerError):
    """The machine has no C compiler."""


def compiled(source: Path, *arguments: str) -> ctypes.CDLL:
    """A C source as a library of this process; nothing of it stays on disk.

    Arguments:
        source: the file.
        arguments: what else the compiler is told, such as `-I` and libraries.

    Raises:
        NoCompilerError: no C compiler is there.
        CompilerError: it refuses the source, or the system refuses the library.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None:
        raise NoCompilerError("no C compiler is there: install one (cc, gcc or clang)")
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / f"{source.stem}.so"
        command = [compiler, *FLAGS, str(source), "-o", str(library), *arguments, "-lm", "-pthread"]
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise CompilerError(f"{source.name} does not compile: {ended.stderr.strip()}")
        try:
            return ctypes.CDLL(str(library))
        except OSError as error:
            raise CompilerError(f"{source.name} cannot be loaded: {error}") from None


def address(array: object) -> ctypes.c_void_p:
    """Where the numbers of a contiguous array are, for a C function."""
    return ctypes.c_void_p(array.ctypes.data)  # type: ignore[attr-defined]
