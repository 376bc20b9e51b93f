"""The command `giajax`, and `python -m giajax`: it listens for signals before all else."""

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
        print("giajax: interrupted", file=sys.stderr)
        return stopped_status()


if __name__ == "__main__":
    sys.exit(main())
