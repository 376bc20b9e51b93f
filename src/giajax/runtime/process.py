"""Settings of a process: signals, and its use of JAX and the machine (64 bit, caches, cores)."""

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

# Effect of Ctrl-C, SIGTERM and SIGHUP on a command: the first signal stops it, a second one ends
# it.
#
# The first signal raises `KeyboardInterrupt`, after which a fit keeps its best result so far.
# Python raises it only between two of its own instructions, and a compilation is a single
# instruction. Therefore a separate thread waits for the second signal, which no instruction can
# delay.

# Signal of a closed terminal, which Windows does not have.
HANGUP = getattr(signal, "SIGHUP", signal.SIGTERM)

_SIGNALS = (signal.SIGINT, signal.SIGTERM, HANGUP)

# Some programs forward to a child a signal that the terminal sends to both.
_ONE_STROKE_S = 0.3

_first: int | None = None
_came = -math.inf  # time of the last signal, s


def listen() -> None:
    """Install the signal handlers; called once, by the process of a command."""
    taken = []
    for number in _SIGNALS:
        # Signals that nohup or a shell has set to be ignored remain ignored.
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _stop)
            taken.append(number)
    if not taken or os.name != "posix":
        return
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.set_wakeup_fd(writer, warn_on_full_buffer=False)
    threading.Thread(target=_end_at_the_second, args=(reader,), daemon=True).start()


# Event that stops a thread while it computes for a caller.
stop_of_thread: contextvars.ContextVar[threading.Event | None] = contextvars.ContextVar(
    "stop_of_thread", default=None
)


def is_stopped() -> bool:
    """Return whether a signal was received, or the caller of this thread was stopped.

    The exception of a signal may have been lost in a foreign library.
    """
    stop = stop_of_thread.get()
    return _first is not None or (stop is not None and stop.is_set())


def go_on() -> None:
    """Reset the stop, because another computation follows. A second signal ends the process."""
    global _first
    _first = None


def stop_if_asked(_: Any = None) -> None:
    """Raise `KeyboardInterrupt` again if it was lost, for example in a callback of a library."""
    if is_stopped():
        raise KeyboardInterrupt


def stopped_status() -> int:
    """Return the exit status of a stopped command: 130 by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP."""
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
"""Subfolder of the compilation cache for traced programs."""

_own_process = False


def own_process() -> None:
    """Declare that this process belongs to the command line and does not modify giajax."""
    global _own_process
    _own_process = True


def is_own_process() -> bool:
    """Return whether `own_process` was called."""
    return _own_process


def set_variables() -> None:
    """Set the environment variables that libraries read when they are imported."""
    # Equinox: its checks call back into Python, and JAX does not cache programs with such calls, so
    # each process would compile a fit again. With this setting a failed check returns NaN, which
    # all callers here test for.
    os.environ.setdefault("EQX_ON_ERROR", "nan")
    # NumPy and SciPy: the matrices of an arm are too small for parallel BLAS, whose threads halve
    # the speed for an arm with 160 links. `one_blas_thread` is used if several cores compute.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def configure() -> None:
    """Enable 64-bit numbers, the persistent compilation cache, and the storage of programs.

    This must be called before any computation. A library must not change these settings, but a
    process that belongs to the command line, or works for another process, may. The cache is at
    `JAX_COMPILATION_CACHE_DIR`, otherwise at `giajax` in the user's cache directory if that is
    writable.
    """
    set_variables()
    import jax

    jax.config.update("jax_enable_x64", True)
    directory, stated = compilation_cache()
    if _own_process:
        warnings.showwarning = _say_of_cache(warnings.showwarning)
    if directory is None:
        return
    # JAX itself may keep compiled programs at a network address.
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
    # By default JAX does not cache programs that compile within a second. A short command has only
    # such programs, hundreds of them with a single operation.
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", _MIN_COMPILE_SECONDS)


def is_private(folder: Path) -> bool:
    """Return whether no other account can write to a folder, or the folder does not exist."""
    if not hasattr(os, "geteuid"):
        return True
    try:
        state = folder.stat()
    except FileNotFoundError:
        return True
    except OSError:  # a parent folder cannot be entered
        return False
    return state.st_uid == os.geteuid() and not state.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def _note(sentence: str) -> None:
    """Print a sentence on standard error if this process belongs to the command line."""
    import multiprocessing  # slow to import, and most processes have no message

    if _own_process and multiprocessing.parent_process() is None:
        print(f"giajax: {sentence}", file=sys.stderr)


def _say_of_cache(show: Callable[..., None]) -> Callable[..., None]:
    """Return a function that shows warnings, with one sentence for all JAX cache warnings."""
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
                "so programs are compiled again: see 'giajax cache'"
            )

    return shown


def compilation_cache() -> tuple[Path | None, bool]:
    """Return the folder of compiled programs, if any, and whether the environment specifies it."""
    stated = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    if stated is None:
        return cache_directory(), False
    return (Path(stated) if stated else None), True


def cache_directory() -> Path | None:
    """Return the user's cache directory of giajax, created if missing; None if impossible."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    try:
        # The XDG specification requires that a relative XDG_CACHE_HOME is ignored.
        parent = Path(base) if os.path.isabs(base) else Path.home() / ".cache"
        directory = parent / "giajax"
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return None
    return directory if os.access(directory, os.W_OK | os.X_OK) else None


# Number of cores that a process uses, and the settings of its threads.
#
# JAX is imported only when necessary, because the help of the command line contains the name of the
# variable.

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")

CORES_VARIABLE = "GIAJAX_CORES"
"""Environment variable for the maximum number of cores."""

# Number of cores for a thread that computes in parallel with others.
_part: contextvars.ContextVar[int | None] = contextvars.ContextVar("giajax_cores", default=None)


def cores() -> int:
    """Return the number of cores to use: those available to this process, or as specified.

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
        # Not every system provides this function.
        allowed = getattr(os, "sched_getaffinity", None)
        there = len(allowed(0)) if allowed else os.cpu_count() or 1
        return min(there, cgroup_quota() or there)
    if not told.isdecimal() or int(told) == 0:
        raise InputError(f"{CORES_VARIABLE} is {told!r}: give the number of cores, or unset it")
    return int(told)


@functools.cache
def cgroup_quota(root: Path = Path("/sys/fs/cgroup")) -> int | None:
    """Return the number of cores that a container may use (cgroups 2 or 1); None without a limit.

    A container sees all cores of its machine, but is suspended for the rest of each period when its
    time is used up. More threads than this number make a step slower.
    """
    try:
        try:
            quota, period = (root / "cpu.max").read_text().split()
        except FileNotFoundError:
            quota, period = (
                (root / "cpu" / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
            )
        return max(1, math.ceil(int(quota) / int(period))) if int(quota) > 0 else None
    except (OSError, ValueError):  # no container, or "max"
        return None


def carried(function: Callable[Parameters, Result], among: int) -> Callable[Parameters, Result]:
    """Prepare a function for a given number of threads, with the precision of the current thread.

    Other settings of a JAX `with` statement (such as the detection of NaN) apply only to the
    calling thread.
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
    """Return JAX's context of 64-bit numbers in this thread; older versions had it elsewhere."""
    import jax

    home: Any = jax if hasattr(jax, "enable_x64") else importlib.import_module("jax.experimental")
    return home.enable_x64(wide)


# One thread for each call of BLAS and LAPACK while threads of giajax use the cores.
#
# The matrices of an arm are too small for parallel computation. If two threads attempt it, OpenBLAS
# makes them wait for each other, and an evaluation of 160 links takes a hundred times as long.

_lock = threading.Lock()
_users = 0
_limit: Any = None


@contextlib.contextmanager
def one_blas_thread() -> Iterator[None]:
    """Make BLAS compute in the calling thread, until the last of such contexts ends."""
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
    """Return the loaded libraries, which are searched once."""
    # JAX calls the LAPACK of SciPy, and loads it only with the first program that needs it.
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()
