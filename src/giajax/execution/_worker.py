"""What a worker does: it gets ready once, and then does one task after the other."""

import contextlib
import functools
import os
import signal
import socket
import threading
import time
import traceback
from collections import OrderedDict
from collections.abc import Callable, Hashable, Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from .._cores import CORES_VARIABLE
from .._errors import InputError
from .._process import configure, own_process
from .._signals import is_stopped
from .._text import abridged
from ._outcome import Outcome, plain, read_outcome, write_outcome
from ._task import Task

Kept = TypeVar("Kept")

# What a process keeps for the tasks to come; a study has few structures.
_MOST = 8
_kept: "OrderedDict[Hashable, Any]" = OrderedDict()
_keeping = threading.RLock()


def prepared(key: Hashable, make: Callable[[], Kept]) -> Kept:
    """What a process prepares once for many tasks: recordings that it read, a model it built.

    The programs of giajax need no such place: they are compiled once a process and structure.

    Arguments:
        key: of all that it depends on, such as the checksums of files and a structure.
        make: makes it.

    Returns:
        That of an earlier task, if it is one of the last few of this process.
    """
    with _keeping:
        if key not in _kept:
            _kept[key] = make()
        _kept.move_to_end(key)
        while len(_kept) > _MOST:
            _kept.popitem(last=False)
        return _kept[key]


def identity() -> str:
    """Machine and process, as `host:process`."""
    return f"{socket.gethostname()}:{os.getpid()}"


def perform(task: Task, folder: Path | None, home: str, own: bool) -> Outcome:
    """Do a task, and write its file if it is done.

    Arguments:
        task: what to do.
        folder: of the files; a task that has one is not done again. None for no files.
        home: `identity` of the process whose tasks these are; another one gets ready first.
        own: whether that is a process of giajax's own (`giajax._process`).

    Returns:
        What came of it. Whatever the function raises is an outcome, too.

    Raises:
        InputError: the file cannot be written.
        KeyboardInterrupt: it was stopped.
    """
    if home != identity():
        get_ready(own)
    if folder is not None and (known := read_outcome(folder, task.key)) is not None:
        return known
    began = time.perf_counter()
    value, message = None, ""
    try:
        value = plain(task.call())
    except InputError as error:
        message = str(error)
    except Exception as error:
        message = _sentence(error)
    # A fit that is stopped returns, and what it returns is no result.
    if is_stopped():
        raise KeyboardInterrupt
    outcome = Outcome(
        key=task.key,
        status="failed" if message else "done",
        value=value,
        message=message,
        seconds=time.perf_counter() - began,
        worker=identity(),
    )
    # What fails may do so by the machine, or by what is put right: the next command tries again.
    if folder is not None and not message:
        write_outcome(folder, outcome)
    return outcome


def _sentence(error: Exception) -> str:
    """An error that is no `InputError`: what, where, and why."""
    frames = traceback.extract_tb(error.__traceback__)
    where = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return abridged(" ".join(f"{type(error).__name__}{where}: {error}".split()))


@functools.cache
def get_ready(own: bool) -> None:
    """Set a worker up as the command line sets up itself, on one thread; once a process."""
    os.environ.update(_VARIABLES)
    if own:
        own_process()
    configure()


def begin_process(own: bool, alive: Connection) -> None:
    """Begin a process of `Processes`, which ends when its parent closes the other end of a pipe.

    Arguments:
        own: as of `perform`.
        alive: one end of it; the other one is closed where the parent is killed, too.
    """
    # Ctrl-C goes to all processes of a terminal: the parent says what becomes of the others.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(alive,), daemon=True).start()
    get_ready(own)


def _end_with(alive: Connection) -> None:
    with contextlib.suppress(OSError):
        alive.poll(None)
    os._exit(1)


# Others have the other cores. NPROC is how many threads XLA begins.
_VARIABLES = {
    CORES_VARIABLE: "1",
    "NPROC": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Processes that are spawned meanwhile read these variables before they import anything."""
    new = {**_VARIABLES, "EQX_ON_ERROR": os.environ.get("EQX_ON_ERROR", "nan")}
    before = {name: os.environ.get(name) for name in new}
    os.environ.update(new)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
