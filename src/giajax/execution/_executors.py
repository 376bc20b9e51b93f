"""Who does tasks: this process, processes of this machine, or a cluster that is there."""

import contextlib
import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor
from typing import Any

from .._errors import InputError
from .._process import is_own_process
from ._worker import begin_process, worker_environment

# With a scheduler that does not answer.
_PATIENCE = "10s"


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


class Processes(Executor):
    """Spawned processes of this machine, one thread each; new ones where one has died.

    JAX does not survive a fork. The processes end with this one, however it ends.

    Arguments:
        workers: how many.

    Raises:
        InputError: there is not one.
    """

    def __init__(self, workers: int) -> None:
        if workers < 1:
            raise InputError(f"there are {workers} workers: give at least 1")
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
            initargs=(is_own_process(), alive),
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
    """The executor that `--workers` and `--scheduler` ask for, until the block ends.

    Arguments:
        workers: processes of this machine; None or 1 for this process alone.
        scheduler: address of that of a cluster of dask.distributed (`tcp://host:8786`), whose
            workers have this version of giajax and see the same files.

    Yields:
        What `run_tasks` takes.

    Raises:
        InputError: both were asked for, a number that is none, no such scheduler, or
            `distributed` is not installed.
    """
    if scheduler is not None:
        if workers is not None:
            raise InputError(
                "there are both workers of this machine and a scheduler: give one of them"
            )
        with _connected(scheduler) as client:
            yield client.get_executor(pure=False)
    elif workers in (None, 1):
        yield InProcess()
    else:
        with Processes(workers) as executor:
            yield executor


def check_scheduler(executor: Executor) -> None:
    """Refuse to wait for a cluster of dask.distributed that is gone.

    Raises:
        InputError: the client has given up.
    """
    client = getattr(executor, "_client", None)
    if client is not None and getattr(client, "status", "") in ("closing", "closed"):
        raise InputError(
            "the scheduler is gone: start it again, and give the same command with its address"
        )


@contextlib.contextmanager
def _connected(address: str) -> Iterator[Any]:
    try:
        from distributed import Client
    except ImportError:
        raise InputError(
            "a scheduler needs the package distributed, which is not installed: "
            'pip install "giajax[cluster]"'
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
