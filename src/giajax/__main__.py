"""The command `giajax`, and `python -m giajax`; signal handlers are installed first."""

import contextlib
import gc
import os
import sys

from .runtime.process import listen, own_process, stopped_status

# Imports and tracing create millions of permanent objects. With Python's default thresholds,
# searching them for cycles takes a tenth of the time of a fit.
_OBJECTS = 100_000


def main() -> int:
    """Run the command line of this process.

    Returns:
        The exit status.
    """
    _open_streams()
    listen()
    gc.set_threshold(_OBJECTS, 50, 100)
    # The matrices of NumPy and SciPy are small here, and waiting BLAS threads keep the cores busy.
    # The variable is read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # This one is read when Equinox is imported, which some commands need to check their arguments.
    # JAX does not store programs that can raise errors: `configure` explains it.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    try:
        from .cli import main as command_line

        own_process()
        return command_line()
    except KeyboardInterrupt:  # during the import of the command line
        with contextlib.suppress(OSError):
            print("giajax: interrupted", file=sys.stderr, flush=True)
        return stopped_status()


def _open_streams() -> None:
    """Open all closed standard streams, and let output streams accept every character.

    Otherwise the next opened file would get the number of a closed stream (`>&-`), and printed
    output would be written to it.
    """
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            handle = os.open(os.devnull, os.O_RDWR)
            if handle != number:
                os.dup2(handle, number)
                os.close(handle)
            os.set_inheritable(number, True)
            mode, errors = "w" if number else "r", "backslashreplace"
            setattr(sys, name, os.fdopen(number, mode, encoding="utf-8", errors=errors))
        elif number and getattr(sys, name).errors == "strict":
            getattr(sys, name).reconfigure(errors="backslashreplace")


if __name__ == "__main__":
    sys.exit(main())
