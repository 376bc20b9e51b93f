"""The command `giajax`, and `python -m giajax`: it listens for signals before all else."""

import sys

from ._signals import listen, stopped_status


def main() -> int:
    """Run the command line of this process.

    Returns:
        The exit status.
    """
    listen()
    try:
        from .cli import main as command_line, own_process

        own_process()
        return command_line()
    except KeyboardInterrupt:  # while the command line was imported
        print("giajax: interrupted", file=sys.stderr)
        return stopped_status()


if __name__ == "__main__":
    sys.exit(main())
