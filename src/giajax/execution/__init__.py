"""Many tasks on many workers: each by a key of its content, with a file of its own, resumable.

    tasks = [Task("giajax.study:refit", {"path": path}, seed=0) for path in paths]
    with open_executor(workers=2) as executor:
        outcomes = run_tasks(tasks, executor=executor, folder="refits")

It knows nothing of fits. What a function prepares for several tasks it has kept by `prepared`.
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
