"""What Ctrl-C and SIGTERM do to a command: the first one stops it, a second one ends it at once.

A signal that stops raises `KeyboardInterrupt`, after which a fit keeps the best so far. Python
raises it only between two steps of its own, and compiling is one step: a thread waits for the
second signal, which no step can hold up.
"""

import os
import signal
import threading
import time
from types import FrameType

_SIGNALS = (signal.SIGINT, signal.SIGTERM)

_ONE_STROKE_S = 0.3  # some programs pass on to a child a signal that its terminal sends to both

_first: int | None = None


def listen() -> None:
    """Begin to take signals; to be called once, by the process that is a command."""
    taken = []
    for number in _SIGNALS:
        # What nohup or a shell has told the process to ignore stays ignored.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
            taken.append(number)
    if not taken or os.name != "posix":
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end_at_the_second, args=(reader,), daemon=True).start()


def is_stopped() -> bool:
    """Whether a signal has come; what it raised may have been lost in a foreign library."""
    return _first is not None


def stopped_status() -> int:
    """Exit status of a command that was stopped: 130 after Ctrl-C, 143 after SIGTERM."""
    return 128 + (signal.SIGINT if _first is None else _first)


def _stop(number: int, frame: FrameType | None) -> None:
    global _first
    if _first is None:
        _first = number
        raise KeyboardInterrupt


def _end_at_the_second(reader: int) -> None:
    began = None
    while byte := os.read(reader, 1):
        now = time.monotonic()
        if byte[0] not in _SIGNALS:
            continue
        if began is None:
            began = now
        elif now - began > _ONE_STROKE_S:
            os._exit(128 + byte[0])
