"""The tasks of a study, from the first to the last: none is lost, and none is there twice."""

from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import (
    FIRST_COMPLETED,
    BrokenExecutor,
    CancelledError,
    Executor,
    Future,
    wait,
)
from pathlib import Path
from typing import Any

from .._errors import InputError
from .._files import check_path
from .._process import is_own_process
from .._text import abridged
from ._executors import InProcess, Processes, check_scheduler
from ._outcome import Outcome, read_outcome, write_outcome
from ._task import Task
from ._worker import identity, perform

ATTEMPTS = 3
"""So often is a task begun whose worker ends under it, but for those of a cluster."""

# Tasks that wait at the workers of an executor that somebody else has made.
_AHEAD = 256

# Between two looks at whether the scheduler of a cluster is there, s.
_BETWEEN_S = 2.0


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
        `open_executor` began, those that were not done are "stopped".

    Raises:
        InputError: a folder that cannot be or be written, an executor that takes no tasks, or a
            cluster whose scheduler is gone. The same call goes on.

    Example:
        >>> from giajax.execution import Task, run_tasks
        >>> tasks = [Task("math:pow", {}), Task("os:getcwd")]
        >>> [outcome.status for outcome in run_tasks(tasks)]
        ['failed', 'done']
    """
    tasks = list(tasks)
    if folder is not None:
        folder = Path(folder).absolute()
        check_path(folder)
    study = _Study(executor or InProcess(), folder, progress, {task.key: task for task in tasks})
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
        elif isinstance(executor, Processes):
            self.ahead = 2 * executor.workers

    def run(self) -> None:
        while self.waiting or self.running or self.doubtful:
            while self.waiting and not self.doubtful and len(self.running) < self.ahead:
                self._begin(self.waiting.popleft())
            if self.doubtful and not self.running:
                self._begin(self.doubtful.popleft())
            done = wait(self.running, _BETWEEN_S, FIRST_COMPLETED).done
            check_scheduler(self.executor)
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
                f"the executor takes no tasks ({why}): begin a new one, and make the same call"
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
                    f"its worker ended {ATTEMPTS} times while it ran: see whether it has the "
                    "memory, and run it again"
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
        if isinstance(self.executor, Processes):
            self.executor.stop()
        for future, key in self.running.items():
            if future.done() and not future.cancelled() and future.exception() is None:
                self.known[key] = future.result()
