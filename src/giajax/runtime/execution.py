"""Many tasks on many workers: this process, processes of this machine, or a cluster; resumable."""

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

# What a process keeps for the tasks to come; a study has few structures.
_MOST = 8
_kept: "OrderedDict[Hashable, Any]" = OrderedDict()
_keeping = threading.RLock()


def prepared(key: Hashable, make: Callable[[], Kept]) -> Kept:
    """What a process prepares once for many tasks: recordings that it read, a model it built.

    It is that of an earlier task, if that was one of the last few of this process. The programs of
    giajax need no such place: they are compiled once a process and structure.

    Arguments:
        key: of all that it depends on, such as the checksums of files and a structure.
        make: makes it.
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
    """Do a task, unless it has a file in the folder, and write that if it is done.

    Whatever the function raises is an outcome, too; what is stopped raises `KeyboardInterrupt`.
    Another process than `home`, whose tasks these are, gets ready first, as one of its `own` does.
    """
    if home != identity():
        get_ready(own)
    if folder is not None and (known := read_outcome(folder, task.key)) is not None:
        return known
    if stop_of_thread.get() is None:
        from .programs import forget_programs_if_many  # not before the process is ready for JAX

        forget_programs_if_many()
    began = time.perf_counter()
    value, message = None, ""
    try:
        value = plain_data(task.call())
    except InputError as error:
        message = str(error)
    except (SystemExit, KeyboardInterrupt, GeneratorExit):
        raise
    except BaseException as error:  # Polars' PanicException is no Exception
        message = error_in_words(error)
    # A fit that is stopped returns, and what it returns is no result.
    if is_stopped():
        raise KeyboardInterrupt
    seconds = time.perf_counter() - began
    status: Literal["failed", "done"] = "failed" if message else "done"
    outcome = Outcome(task.key, status, value, message, seconds, identity())
    # What fails may do so by the machine, or by what is put right: the next command tries again.
    if folder is not None and not message:
        write_outcome(folder, outcome)
    return outcome


@functools.cache
def get_ready(own: bool) -> None:
    """Set a worker up as the command line sets up itself, on one thread; once a process."""
    os.environ.update(_VARIABLES)
    if own:
        own_process()
    configure()


def begin_process(own: bool, alive: Connection, added: Mapping[Path, str]) -> None:
    """Begin a process of `Processes`, which ends when its parent closes the other end of a pipe.

    That is closed where the parent is killed, too. Plug-ins are those of the parent.
    """
    # What a terminal sends goes to all its processes: the parent says what becomes of the others.
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


_PATIENCE = "10s"  # with a scheduler that does not answer


class InProcess(Executor):
    """Does a task when it is submitted, in the thread of the caller."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Call a function now."""
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


class Threads(Executor):
    """Threads of this process, as many as cores: for tasks that compute in one program on one.

    They share the compiled programs, and see the context of the thread that submits.
    """

    def __init__(self, most: int) -> None:
        from .programs import forget_programs_if_many

        forget_programs_if_many()  # not while a thread computes with them
        self.workers = min(most, cores())
        self._stop = threading.Event()
        self._blas = contextlib.ExitStack()
        self._blas.enter_context(one_blas_thread())
        self._pool = ThreadPoolExecutor(self.workers, "giajax")

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a thread call a function."""
        context = contextvars.copy_context()
        context.run(stop_of_thread.set, self._stop)
        call = carried(function, self.workers)
        return self._pool.submit(context.run, call, *args, **kwargs)

    def stop(self) -> None:
        """Tell the tasks to stop, and wait until they have."""
        self._stop.set()
        self.shutdown(cancel_futures=True)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the threads when they have done what was submitted."""
        self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)
        self._blas.close()


class Processes(Executor):
    """Spawned processes of this machine, one thread each; new ones where one has died.

    JAX does not survive a fork. The processes end with this one, however it ends.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise InputError(f"the number of workers is {workers}: give at least 1")
        self.workers = workers
        self._pool: ProcessPoolExecutor | None = None

    def submit(self, function: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """Have a worker call a function; the workers begin with the first."""
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
        """End the processes now, whatever they do; the next task begins new ones."""
        if self._pool is not None:
            self._alive.close()
            self._pool.shutdown(wait=True, cancel_futures=True)
            self._pool = None

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes when they have done what was submitted."""
        if self._pool is not None:
            self._pool.shutdown(wait=wait, cancel_futures=cancel_futures)


@contextlib.contextmanager
def open_executor(workers: int | None = None, scheduler: str | None = None) -> Iterator[Executor]:
    """The executor of `run_tasks` that `--workers` and `--scheduler` request, until the block ends.

    So many processes of this machine (None or 1: this one), or a cluster of dask.distributed at
    `tcp://host:8786`, whose workers have this version of giajax and see the same files.

    Raises:
        InputError: both were asked for, a number that is none, no such scheduler, or
            `distributed` is not installed.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "both workers on this machine and a scheduler are given: give only one of them"
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
            "a scheduler needs the package distributed, which is not installed: "
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
"""Maximum number of attempts of a task whose worker ends; a cluster has its own limit."""

_AHEAD = 256  # tasks that wait at the workers of an executor that somebody else has made
_BETWEEN_S = 2.0  # between two looks at whether the scheduler of a cluster is there, s


class Execution(TypedDict, total=False):
    """Keywords of all studies: who does their tasks, and what is kept; as of `run_tasks`."""

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
    """Do tasks, each once.

    With a folder, the worker that does a task writes `KEY.json` into it before it says so. What
    has a file is not done again: after a crash or Ctrl-C the same call goes on. Workers of other
    machines must see the folder, and have this version of giajax.

    Whatever a task raises makes it a failed one, with a sentence and without a file: the next call
    begins it again. If its worker ends under it, it is begun again, alone and `ATTEMPTS` times at
    most; how often a cluster has tried it is the cluster's own choice.

    Arguments:
        tasks: in any order; those of the same key are done once.
        executor: any of `concurrent.futures`, such as that of `open_executor`; by default this
            process, one after the other. It is not shut down.
        folder: of the files, made where it is missing; None keeps them in memory.
        progress: called after each with its outcome, how many there are now (those of the folder
            too) and how many there will be.

    Returns:
        An outcome for each task, in their order. After Ctrl-C, which stops the workers that
        `open_executor` began, those that were not completed are "stopped".

    Raises:
        InputError: a folder that cannot be or be written, an executor that takes no tasks, or a
            cluster whose scheduler is gone. The same call goes on.

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
    """Tasks by key, and what is known of them.

    A process that dies takes all tasks with it that the pool had: each of them may have killed
    it. They are begun again one at a time, so that the one that kills is found and no other fails.
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
            # Of dask.distributed, whose client may have given up.
            client = getattr(self.executor, "_client", None)
            if getattr(client, "status", "") in ("closing", "closed"):
                raise InputError(
                    "the scheduler is lost: start it again, and run the same command with its "
                    "address"
                )
            for future in done:
                self._end(self.running.pop(future), future)

    def _begin(self, key: str) -> None:
        words = (self.tasks[key], self.folder, identity(), is_own_process())
        self.attempts[key] = self.attempts.get(key, 0) + 1
        try:
            self.running[self.executor.submit(perform, *words)] = key
        except RuntimeError as error:  # of a pool that nobody can begin again
            why = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"the executor accepts no tasks ({why}): create a new one, and repeat the call"
            ) from None

    def _end(self, key: str, future: Future[Any]) -> None:
        try:
            outcome = future.result()
        except InputError:  # Its file cannot be written, nor will those of the others be.
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
            # Of a worker that does not see the folder, or sees it later.
            folder = self.folder if outcome.status == "done" else None
            if folder is not None and read_outcome(folder, key) is None:
                write_outcome(folder, outcome)
        self.known[key] = outcome
        if self.progress is not None:
            self.progress(outcome, len(self.known), len(self.tasks))

    def stop(self) -> None:
        """Begin nothing more, and keep what was done meanwhile."""
        for future in self.running:
            future.cancel()
        if isinstance(self.executor, Processes | Threads):
            self.executor.stop()
        for future, key in self.running.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                self.known[key] = future.result()
