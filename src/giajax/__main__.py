"""The command `giajax`, and `python -m giajax`; signal handlers are installed first."""

import contextlib
import gc
import os
import sys

from .runtime.process import listen, own_process, set_variables, stopped_status

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
    set_variables()  # some commands import Equinox to check their arguments
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
