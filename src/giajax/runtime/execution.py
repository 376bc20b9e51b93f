"""Resumable execution of many tasks, in this process, on its machine, or on a cluster."""

import contextlib
import contextvars
import functools
import multiprocessing
import os
import signal
import socket
import threading
import time
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    ProcessPoolExecutor,
    ThreadPoolExecutor,
    wait,
)
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal, TypedDict, TypeVar

from .files import check_path, written_to
from .plugins import load_plugin, plugins
from .process import (
    CORES_VARIABLE,
    HANGUP,
    carried,
    configure,
    cores,
    is_own_process,
    is_stopped,
    one_blas_thread,
    own_process,
    stop_of_thread,
)
from .records import plain_data
from .tasks import Outcome, Task, read_outcome, write_outcome
from .text import InputError, abridged, error_in_words, install_command

Kept = TypeVar("Kept")

# Number of prepared objects that a process keeps for later tasks. A study has few structures.
_MOST = 8
_kept: "OrderedDict[Hashable, Any]" = OrderedDict()
_keeping = threading.RLock()


def prepared(key: Hashable, make: Callable[[], Kept]) -> Kept:
    """Return an object that a process prepares once for many tasks, such as recordings or a model.

    The object of an earlier task is returned if it was one of the last few that this process used.
    The compiled programs of giajax need not be kept here, because they are compiled once per
    process and structure.

    Arguments:
        key: key of everything on which the object depends, such as the checksums of files and a
            structure.
        make: function that prepares the object.
    """
    with _keeping:
        if key not in _kept:
            _kept[key] = make()
        _kept.move_to_end(key)
        while len(_kept) > _MOST:
            _kept.popitem(last=False)
        return _kept[key]


def identity() -> str:
    """Return the machine and the process, as `host:process`."""
    return f"{socket.gethostname()}:{os.getpid()}"


def perform(task: Task, folder: Path | None, home: str, own: bool) -> Outcome:
    """Perform a task unless its outcome is in the folder, and write the outcome there.

    Errors of the function are recorded as a failed outcome. A stopped task raises
    `KeyboardInterrupt`. A process other than `home`, which created the tasks, is set up first, as a
    process of the command line if `own`.
    """
    if home != identity():
        get_ready(own)
    if folder is not None and (known := read_outcome(folder, task.key)) is not None:
        return known
    if stop_of_thread.get() is None:
        from .programs import forget_programs_if_many  # after the setup of JAX in this process

        forget_programs_if_many()
    began = time.perf_counter()
    value, message = None, ""
    try:
        value = plain_data(task.call())
    except InputError as error:
        message = str(error)
    except (SystemExit, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # Polars' PanicException is not an Exception
        message = error_in_words(error)
    # A stopped fit returns an incomplete result, which is not an outcome.
    if is_stopped():
        raise KeyboardInterrupt
    seconds = time.perf_counter() - began
    status: Literal["failed", "done"] = "failed" if message else "done"
    outcome = Outcome(task.key, status, value, message, seconds, identity())
    # A failed task has no file, because the cause may be the machine or be corrected later. The
    # next command repeats it.
    if folder is not None and not message:
        write_outcome(folder, outcome)
    return outcome


@functools.cache
def get_ready(own: bool) -> None:
    """Set up a worker like the command line, on one thread; once per process."""
    os.environ.update(_VARIABLES)
    if own:
        own_process()
    configure()


def begin_process(own: bool, alive: Connection, added: Mapping[Path, str]) -> None:
    """Initialise a process of `Processes`, which ends when its parent closes a pipe.

    The pipe is also closed if the parent is killed. The process loads the plug-ins of the parent.
    """
    # A terminal sends signals to all its processes. The parent decides when the others stop.
    for number in {signal.SIGINT, HANGUP} - {signal.SIGTERM}:
        signal.signal(number, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(alive,), daemon=True).start()
    get_ready(own)
    for path, digest in added.items():
        load_plugin(path, digest)


def _end_with(alive: Connection) -> None:
    with contextlib.suppress(OSError):
        alive.poll(None)
    os._exit(1)


# Other processes use the other cores. NPROC is the number of threads that XLA starts.
_VARIABLES = {
    CORES_VARIABLE: "1",
    "NPROC": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}


@contextlib.contextmanager
def worker_environment() -> Iterator[None]:
    """Set variables that processes spawned in this context read before they import anything."""
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


_PATIENCE = "10s"  # timeout for a scheduler that does not answer


class InProcess(Executor):
    """Executor that performs a task when it is submitted, in the calling thread."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function immediately."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Threads(Executor):
    """Threads of this process, at most as many as cores, for tasks that each use one core.

    They share the compiled programs and inherit the context of the thread that submits.
    """

    def __init__(self, most: int) -> None:
        from .programs import forget_programs_if_many

        forget_programs_if_many()  # not while a thread uses them
        self.workers = min(most, cores())
        self._stop = threading.Event()
        self._blas = contextlib.ExitStack()
        self._blas.enter_context(one_blas_thread())
        self._pool = ThreadPoolExecutor(self.workers, "giajax")

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a thread."""
        context = contextvars.copy_context()
        context.run(stop_of_thread.set, self._stop)
        call = carried(function, self.workers)
        return self._pool.submit(context.run, call, *args, **kwargs)

    def stop(self) -> None:
        """Stop the tasks and wait until they have ended."""
        self._stop.set()
        self.shutdown(cancel_futures=True)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads after the submitted tasks."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)
        self._blas.close()


class Processes(Executor):
    """Spawned processes of this machine, with one thread each; dead processes are replaced.

    JAX does not survive a fork. The processes end with this process, however it ends.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise InputError(f"the number of workers is {workers}: give at least 1")
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function in a worker; the workers start with the first call."""
        with worker_environment():
            if self._pool is not None:
                try:
                    return self._pool.submit(function, *args, **kwargs)
                except BrokenExecutor:
                    self.stop()
            self._pool = self._new()
            return self._pool.submit(function, *args, **kwargs)

    def _new(self) -> ProcessPoolExecutor:
        context = multiprocessing.get_context("spawn")
        alive, self._alive = context.Pipe(duplex=False)
        return ProcessPoolExecutor(
            self.workers,
            mp_context=context,
            initializer=begin_process,
            initargs=(is_own_process(), alive, plugins()),
        )

    def stop(self) -> None:
        """End the processes immediately; the next task starts new ones."""
        if self._pool is not None:
            self._alive.close()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes after the submitted tasks."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)


@contextlib.contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """Return the executor for `--workers` and `--scheduler`, which is open until the block ends.

    It uses `workers` processes of this machine (None or 1: the current process), or a
    dask.distributed cluster at `tcp://host:8786`, whose workers have this version of giajax and
    access the same files.

    Raises:
        InputError: both are given; the number is invalid; there is no such scheduler; or
            `distributed` is not installed.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "both workers on this machine and a scheduler are given: give only one of the two"
            )
        if added := [path.name for path in plugins()]:
            raise InputError(
                f"the workers of a cluster lack the plug-in {added[0]}: install it there as a "
                "package, or omit the scheduler"
            )
        with _connected(scheduler) as client:
            yield client.get_executor(pure=False)
    elif workers in (None, 1):
        yield InProcess()
    else:
        with Processes(workers) as executor:
            yield executor


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "a scheduler requires the package distributed, which is not installed: "
            f"{install_command('cluster')}"
        ) from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        why = " ".join(str(error).split()) or type(error).__name__
        raise InputError(
            f"no scheduler answers at {address} ({why}): start one with dask scheduler, or give "
            "its address"
        ) from None
    with client:
        yield client


ATTEMPTS = 3
"""Maximum number of attempts at a task if its worker ends. A cluster has its own limit."""

_AHEAD = 256  # maximum number of tasks submitted to an executor of the caller
_BETWEEN_S = 2.0  # interval between checks of the scheduler of a cluster, s


class Execution(TypedDict, total=False):
    """Keywords of all studies for the execution and storage of their tasks; as for `run_tasks`."""

    executor: Executor | None
    folder: str | Path | None
    progress: Callable[[Outcome, int, int], None] | None


def run_tasks(
    tasks: Iterable[Task],
    *,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
) -> list[Outcome]:
    """Perform each of some tasks once.

    With a folder, the worker that performs a task writes `KEY.json` into it before it reports the
    outcome. A task with a file is not performed again, so the same call continues after a crash or
    Ctrl-C. Workers on other machines must access the folder and have this version of giajax.

    If a task raises an error, its outcome is "failed", with a sentence and without a file, and the
    next call repeats it. If its worker ends during the task, the task is repeated alone, with at
    most `ATTEMPTS` attempts in total. A cluster has its own number of attempts.

    Arguments:
        tasks: tasks in any order; tasks with the same key are performed once.
        executor: any executor of `concurrent.futures`, for example from `open_executor`. By
            default, the tasks are performed one after the other in this process. The executor is
            not shut down.
        folder: folder of the files, created if it is missing; None keeps the outcomes in memory
            only.
        progress: function that is called after each task with its outcome, the number of known
            outcomes (including those in the folder) and the total number.

    Returns:
        An outcome for each task, in the same order. After Ctrl-C, which stops the workers of
        `open_executor`, tasks that were not completed are "stopped".

    Raises:
        InputError: the folder is invalid or cannot be written; the executor accepts no tasks; or
            the scheduler of a cluster is lost. The same call can be repeated to continue.

    Example:
        >>> from giajax.runtime.tasks import Task
        >>> from giajax.runtime.execution import run_tasks
        >>> tasks = [Task("math:pow", {}), Task("os:getcwd")]
        >>> [outcome.status for outcome in run_tasks(tasks)]
        ['failed', 'done']
    """
    tasks = list(tasks)
    if folder is not None:
        folder = Path(folder).absolute()
        check_path(folder)
    study = _Study(executor or InProcess(), folder, progress, {task.key: task for task in tasks})
    with contextlib.nullcontext() if folder is None else written_to(folder):
        try:
            study.run()
        except KeyboardInterrupt:
            study.stop()
        except InputError:
            study.stop()
            raise
    known = study.known
    return [known.get(task.key) or Outcome(task.key, "stopped") for task in tasks]


class _Study:
    """Tasks by key, and their known outcomes.

    When a process of a pool dies, all tasks of the pool are lost, and each of them may be the
    cause. They are repeated one at a time, so only the task that kills its worker fails.
    """

    def __init__(
        self,
        executor: Executor,
        folder: Path | None,
        progress: Callable[[Outcome, int, int], None] | None,
        tasks: dict[str, Task],
    ) -> None:
        self.executor, self.folder, self.progress, self.tasks = executor, folder, progress, tasks
        self.known: dict[str, Outcome] = {}
        if folder is not None:
            found = (read_outcome(folder, key) for key in tasks)
            self.known = {outcome.key: outcome for outcome in found if outcome is not None}
        self.waiting = deque(key for key in tasks if key not in self.known)
        self.running: dict[Future[Any], str] = {}
        self.attempts: dict[str, int] = {}
        self.doubtful: deque[str] = deque()
        self.ahead = _AHEAD
        if isinstance(executor, InProcess):
            self.ahead = 1
        elif isinstance(executor, Processes | Threads):
            self.ahead = 2 * executor.workers

    def run(self) -> None:
        while self.waiting or self.running or self.doubtful:
            while self.waiting and not self.doubtful and len(self.running) < self.ahead:
                self._begin(self.waiting.popleft())
            if self.doubtful and not self.running:
                self._begin(self.doubtful.popleft())
            done = wait(self.running, _BETWEEN_S, FIRST_COMPLETED).done
            # The client of dask.distributed may have given up.
            client = getattr(self.executor, "_client", None)
            if getattr(client, "status", "") in ("closing", "closed"):
                raise InputError(
                    "the scheduler no longer answers: start it again, and run the same command "
                    "with its address"
                )
            for future in done:
                self._end(self.running.pop(future), future)

    def _begin(self, key: str) -> None:
        words = (self.tasks[key], self.folder, identity(), is_own_process())
        self.attempts[key] = self.attempts.get(key, 0) + 1
        try:
            self.running[self.executor.submit(perform, *words)] = key
        except RuntimeError as error:  # a pool that cannot be restarted
            why = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the executor accepts no tasks ({why}): create a new one, and repeat the call"
            ) from None

    def _end(self, key: str, future: Future[Any]) -> None:
        try:
            outcome = future.result()
        except InputError:  # Its file cannot be written, so other files will fail, too.
            raise
        except Exception as error:
            if isinstance(error, BrokenExecutor | CancelledError):
                if self.attempts[key] < ATTEMPTS:
                    self.doubtful.append(key)
                    return
                message = (
                    f"the worker ended {ATTEMPTS} times during the task: check its memory, and run "
                    "the task again"
                )
            else:
                message = abridged(" ".join(f"{type(error).__name__}: {error}".split()))
            outcome = Outcome(key, "failed", message=message)
        else:
            # The worker may not access the folder, or its file may become visible later.
            folder = self.folder if outcome.status == "done" else None
            if folder is not None and read_outcome(folder, key) is None:
                write_outcome(folder, outcome)
        self.known[key] = outcome
        if self.progress is not None:
            self.progress(outcome, len(self.known), len(self.tasks))

    def stop(self) -> None:
        """Start no further tasks, and keep the outcomes of those that have ended."""
        for future in self.running:
            future.cancel()
        if isinstance(self.executor, Processes | Threads):
            self.executor.stop()
        for future, key in self.running.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                self.known[key] = future.result()
