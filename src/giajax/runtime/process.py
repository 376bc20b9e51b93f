"""A process: its signals, and how it uses JAX and the machine (64 bit, caches, cores, BLAS)."""

import contextlib
import contextvars
import functools
import importlib
import math
import os
import signal
import stat
import sys
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any, ParamSpec, TypeVar

from .text import InputError

# What Ctrl-C, SIGTERM and SIGHUP do to a command: the first one stops it, a second one ends it.
#
# A signal that stops raises `KeyboardInterrupt`, after which a fit keeps the best so far. Python
# raises it only between two steps of its own, and compiling is one step: a thread waits for the
# second signal, which no step can hold up.

# A terminal that is closed hangs up; Windows has no such signal.
HANGUP = getattr(signal, "SIGHUP", signal.SIGTERM)

_SIGNALS = (signal.SIGINT, signal.SIGTERM, HANGUP)

_ONE_STROKE_S = 0.3  # some programs pass on to a child a signal that its terminal sends to both

_first: int | None = None
_came = -math.inf  # the last one, s


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


# Of a thread whose caller can be stopped while it computes.
stop_of_thread: contextvars.ContextVar[threading.Event | None] = contextvars.ContextVar(
    "stop_of_thread", default=None
)


def is_stopped() -> bool:
    """Whether a signal has come, or the caller of this thread was stopped.

    What the signal raised may have been lost in a foreign library.
    """
    stop = stop_of_thread.get()
    return _first is not None or (stop is not None and stop.is_set())


def go_on() -> None:
    """Say that what was signalled has stopped, and something else follows; a second one ends it."""
    global _first
    _first = None


def stop_if_asked(_: Any = None) -> None:
    """Stop what was signalled, where the exception was lost, as in a callback of a library."""
    if is_stopped():
        raise KeyboardInterrupt


def stopped_status() -> int:
    """Exit status of a command that was stopped: 130 by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP."""
    return 128 + (signal.SIGINT if _first is None else _first)


def _stop(number: int, frame: FrameType | None) -> None:
    global _first, _came
    again = time.monotonic() - _came < _ONE_STROKE_S
    _came = time.monotonic()
    if _first is None and not again:
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


_MIN_COMPILE_SECONDS = 0.0

PROGRAMS = "programs"
"""Folder of the stored traced programs, within the folder of the compilation cache."""

_own_process = False


def own_process() -> None:
    """Say that this process is the command line's own, and nothing in it changes giajax."""
    global _own_process
    _own_process = True


def is_own_process() -> bool:
    """Whether `own_process` was said."""
    return _own_process


def configure() -> None:
    """Switch on 64-bit numbers, the persistent compilation cache, and programs that are kept.

    To be called before anything is computed. A library must not set either; a process that
    belongs to the command line, or works for another one, may. The cache is what
    `JAX_COMPILATION_CACHE_DIR` says, else `giajax` in the user's cache directory, where that can be
    written.
    """
    # Equinox reads this when it is imported. Its checks call back into Python, and JAX keeps no
    # program that does: the fit would be compiled anew in every process. A failed check becomes
    # a NaN instead, which every caller here looks for.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    # The matrices of an arm are too small for OpenBLAS to share out: its threads cost half of the
    # speed of one with 160 links. Where several cores compute, `_blas` sees to it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    import jax

    jax.config.update("jax_enable_x64", True)
    directory, stated = compilation_cache()
    if _own_process:
        warnings.showwarning = _say_of_cache(warnings.showwarning)
    if directory is None:
        return
    # JAX itself may keep what it compiles at an address of a network.
    if "://" not in os.environ.get("JAX_COMPILATION_CACHE_DIR", ""):
        with contextlib.suppress(OSError):
            directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        for folder in (directory, directory / PROGRAMS):
            if not is_private(folder):
                jax.config.update("jax_compilation_cache_dir", None)
                _note(
                    f"{folder} can be written by other accounts, belongs to another account, or "
                    "cannot be entered, so its programs are not trusted and not used: "
                    "run chmod go-w on it, or set JAX_COMPILATION_CACHE_DIR to another folder"
                )
                return
        if _own_process:
            from .programs import cache_programs

            cache_programs(directory / PROGRAMS)
    if stated:
        return
    jax.config.update("jax_compilation_cache_dir", str(directory))
    # JAX leaves out what compiles within a second: of a short command all of it, which is hundreds
    # of programs of an operation each.
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", _MIN_COMPILE_SECONDS)


def is_private(folder: Path) -> bool:
    """Whether no other account can write into a folder, or it is not there."""
    if not hasattr(os, "geteuid"):
        return True
    try:
        state = folder.stat()
    except FileNotFoundError:
        return True
    except OSError:  # of a parent that may not be entered
        return False
    return state.st_uid == os.geteuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _note(sentence: str) -> None:
    """Say something on standard error, where this process is the command line's own."""
    import multiprocessing  # slow to import, and most processes have nothing to say

    if _own_process and multiprocessing.parent_process() is None:
        print(f"giajax: {sentence}", file=sys.stderr)


def _say_of_cache(show: Callable[..., None]) -> Callable[..., None]:
    """What shows warnings, but those of JAX about its cache: a sentence in place of all of them."""
    said = False

    def shown(message: Warning | str, *how: Any, **named: Any) -> None:
        nonlocal said
        if "persistent compilation cache" not in str(message):
            show(message, *how, **named)
        elif not said:
            said = True
            why = " ".join(str(message).partition(": ")[2].split())
            _note(
                f"compiled programs in {compilation_cache()[0]} cannot be read or written ({why}), "
                "so programs are compiled again: see giajax cache"
            )

    return shown


def compilation_cache() -> tuple[Path | None, bool]:
    """Where compiled programs are kept, if anywhere, and whether the user's environment says so."""
    stated = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if stated is None:
        return cache_directory(), False
    return (Path(stated) if stated else None), True


def cache_directory() -> Path | None:
    """The user's cache directory of giajax, made where it is missing; None where it cannot be."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # A relative XDG_CACHE_HOME is to be ignored, by the XDG specification.
        parent = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        directory = parent / "giajax"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return directory if os.access(directory, os.W_OK | os.X_OK) else None


# How many cores a process computes on, and what its threads have to know.
#
# Without JAX until it is asked: the command line has the variable's name in its help.

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

CORES_VARIABLE = "GIAJAX_CORES"
"""Environment variable for the maximum number of cores."""

# Of a thread that computes beside others: its part of the cores.
_part: contextvars.ContextVar[int | None] = contextvars.ContextVar("giajax_cores", default=None)


def cores() -> int:
    """On how many cores to compute: those that this process may use, or as many as so told.

    Raises:
        InputError: the environment variable is not a positive number.
    """
    import jax

    if jax.default_backend() != "cpu":
        return 1
    if (part := _part.get()) is not None:
        return part
    told = os.environ.get(CORES_VARIABLE)
    if not told:
        # Not every system lets a process ask.
        allowed = getattr(os, "sched_getaffinity", None)
        there = len(allowed(0)) if allowed else os.cpu_count() or 1
        return min(there, cgroup_quota() or there)
    if not told.isdecimal() or int(told) == 0:
        raise InputError(f"{CORES_VARIABLE} is {told!r}: give the number of cores, or unset it")
    return int(told)


@functools.cache
def cgroup_quota(root: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Cores whose time a container may use (cgroups, version 2 or 1); None where that is no less.

    A container sees all cores of its machine, and is stopped for the rest of each period when its
    time is used up: more threads than that make a step slower.
    """
    try:
        try:
            quota, period = (root / "cpu.max").read_text().split()
        except FileNotFoundError:
            quota, period = (
                (root / "cpu" / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
            )
        return max(1, math.ceil(int(quota) / int(period))) if int(quota) > 0 else None
    except (OSError, ValueError):  # No container, or "max"
        return None


def carried(function: Callable[Parameters, Result], among: int) -> Callable[Parameters, Result]:
    """A function for so many other threads, which computes with as many bits as the present one.

    What else a `with` of JAX sets (looking for NaN, say) counts in the caller's thread alone.
    """
    import jax

    part = max(1, cores() // among)
    wide = bool(jax.config.read("jax_enable_x64"))

    def call(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        _part.set(part)
        with enable_x64(wide):
            return function(*args, **kwargs)

    return call


def enable_x64(wide: bool) -> Any:
    """JAX's context of 64-bit numbers, in the present thread; it was in another place once."""
    import jax

    home: Any = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    return home.enable_x64(wide)


# One thread for each call of BLAS and LAPACK while threads of giajax's own have the cores.
#
# The matrices of an arm are too small to be shared out. Where two threads try, OpenBLAS lets them
# wait for each other: an evaluation of 160 links then takes a hundred times as long.

_lock = threading.Lock()
_users = 0
_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """BLAS computes in the thread that calls it, until the last of those who request it is done."""
    global _users, _limit
    with _lock:
        if not _users:
            _limit = _libraries().limit(limits=1, user_api="blas")
        _users += 1
    try:
        yield
    finally:
        with _lock:
            _users -= 1
            if not _users:
                _limit.restore_original_limits()


@functools.cache
def _libraries() -> Any:
    """The libraries that are loaded, found once."""
    # JAX calls the LAPACK of SciPy, and loads it only with the first program that does.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
