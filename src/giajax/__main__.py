"""The command `giajax`, and `python -m giajax`: it listens for signals before all else."""

import contextlib
import gc
import os
import sys

from .runtime.process import listen, own_process, stopped_status

# Imports and tracing make millions of objects that stay: to look through them for cycles as often
# as Python does by default takes a tenth of a fit's time.
_OBJECTS = 100_000


def main() -> int:
    """Run the command line of this process.

    Returns:
        The exit status.
    """
    _open_streams()
    listen()
    gc.set_threshold(_OBJECTS, 50, 100)
    # The matrices of NumPy and SciPy are small here, and threads of theirs wait for each other by
    # keeping the cores busy; read when NumPy is imported.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        from .cli import main as command_line

        own_process()
        return command_line()
    except KeyboardInterrupt:  # while the command line was imported
        with contextlib.suppress(OSError):
            print("giajax: interrupted", file=sys.stderr, flush=True)
        return stopped_status()


def _open_streams() -> None:
    """Have all standard streams, and in them a form of every character, before all else.

    The next file that is opened would else have the number of one that was closed (`>&-`), and be
    written to by what prints.
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
