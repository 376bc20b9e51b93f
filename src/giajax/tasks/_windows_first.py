"""Whole runs that begin where a fit of their windows ends.

The cost of a long recording of something that swings has many local minima: with a frequency that
is off, the model is out of step soon, and stays so. In a window of a few periods, which begins in
a state of its own, it has no time for that.
"""

import dataclasses
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from ._stored import reached_by

if TYPE_CHECKING:
    from ..fitting import FitResult, Iteration, Setup
    from ._fit_task import FitTask

    Watch = Callable[[Setup], Callable[[Iteration], None]]

# What `runs.windows` calls the first window of a run.
_FIRST = " 0 s"


def begun(
    task: "FitTask",
    watch: "Watch | None" = None,
    told: "Callable[[FitResult], object] | None" = None,
) -> "FitTask":
    """The task with the start that `windows_first_s` of its `[fit]` asks for.

    Parameters begin where the fit of the windows ends, and states of runs with those of their
    first windows. What is held out of the runs is held out of the windows, too.

    Arguments:
        task: what to fit to what. One that asks for nothing, or begins somewhere, is returned.
        watch: from the fit in windows to what is called after each of its steps.
        told: called with its result.

    Raises:
        InputError: as `FitTask.run`.
        KeyboardInterrupt: also where the fit in windows has something to show for itself.
    """
    settings = task.definition.fit
    if settings.windows_first_s is None or task.begin is not None:
        return task
    inside = settings.model_copy(
        update={"windows_first_s": None, "window_s": settings.windows_first_s, "starts": None}
    )
    definition = task.definition.model_copy(update={"fit": inside})
    ready = dataclasses.replace(task, definition=definition, validation=()).prepare()
    result = ready.run(None if watch is None else watch(ready.setup), check=False)
    if result.status == "interrupted":
        raise KeyboardInterrupt
    if told is not None:
        told(result)
    return dataclasses.replace(task, begin=_of_whole_runs(reached_by(result)))


def _of_whole_runs(reached: dict[str, Any]) -> dict[str, Any]:
    """Where a fit of windows ended, by the names of the runs that they were cut of."""
    own = {
        name.removesuffix(_FIRST): values
        for name, values in reached["own"].items()
        if name.endswith(_FIRST)
    }
    return {**reached, "own": own}
