"""Many tasks on many workers: each by a key of its content, with a file of its own, resumable.

A `Task` is a call of a function; `run_tasks` does many of them by the executor of `open_executor`,
or any other, and keeps what is done in a folder. What a function prepares for several tasks it has
kept by `prepared`. Nothing here knows of fits.
"""

from ._executors import (
    InProcess as InProcess,
    Processes as Processes,
    open_executor as open_executor,
)
from ._outcome import Outcome as Outcome, read_outcome as read_outcome
from ._run import run_tasks as run_tasks
from ._task import Task as Task
from ._worker import prepared as prepared
