"""Compile C sources at run time with the C compiler of the machine."""

import ctypes
import shutil
import subprocess
import tempfile
from pathlib import Path

SOURCES = Path(__file__).resolve().parent
# The times with -O1, -O2 and -ffast-math differed by less than the timing noise of a busy machine,
# and their order varied between the methods. -O3 was not included in this comparison.
FLAGS = ("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")


class CompilerError(RuntimeError):
    """A C library cannot be built; the message is a sentence that gives the reason."""


class NoCompilerError(CompilerError):
    """The machine has no C compiler."""


def compiled(source: Path, *arguments: str) -> ctypes.CDLL:
    """Compile a C source and load it as a library; no file remains on disk.

    Arguments:
        source: C source file.
        arguments: further arguments for the compiler, such as `-I` and libraries.

    Raises:
        NoCompilerError: the machine has no C compiler.
        CompilerError: the source does not compile, or the library cannot be loaded.
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
    """Return the address of the data of a contiguous array, for a C function."""
    return ctypes.c_void_p(array.ctypes.data)  # type: ignore[attr-defined]
