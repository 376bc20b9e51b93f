"""Profiles of a fit: how far each quantity can go until the fit is too bad, however the rest helps.

The interval of a standard error takes the residuals to be straight in the parameters. A profile
does not: it holds a quantity, fits all others, and goes on until the cost says no (Venzon and
Moolgavkar 1988; Bates and Watts, "Nonlinear Regression Analysis", 1988, section 6.1).
"""

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path

from .._errors import InputError
from ..execution import Outcome, Task, run_tasks
from ..fitting import FitResult
from ..runs import Run
from ._fitted import Fitted, fit_key
from ._profile_records import Profiles, load_profiles
from ._profile_task import SIDES, combined, one_side
from ._profiled import profiled_of, quantity_names

LEVEL = 0.95


def profile(
    result: FitResult,
    runs: Run | Sequence[Run],
    paths: Sequence[str] | None = None,
    *,
    level: float = LEVEL,
    known: Profiles | None = None,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
) -> Profiles:
    """Profile parameters and derived quantities of a fit.

    Each is held at values ever farther from its estimate, on both sides, while all other
    parameters are fitted, until the fit is worse than `level` allows, a bound is met, or the data
    give no end. On a problem that is linear the interval is that of the standard error.

    Arguments:
        result: of a fit that converged.
        runs: what it was fitted to, in their order.
        paths: of free parameters (also of what single runs have, such as `initial.angle`), or
            names of `result.derived`; by default all free parameters of the model.
        level: of the intervals.
        known: profiles of this fit and level, which are not made again; those asked for are
            returned with the new ones.
        executor: who does the sides, each a task (`giajax.execution.run_tasks`); by default this
            process.
        folder: of a file for each task, by which the same call goes on after it was stopped.
        progress: as of `run_tasks`.

    Returns:
        The profiles. After Ctrl-C, those sides that were not done are "stopped".

    Raises:
        InputError: a path that was not free, a level that is none, a fit that did not converge, or
            other runs than those of the result.

    Example:
        >>> profiles = giajax.profile(result, run, ["air.drag_coefficient"])  # doctest: +SKIP
        >>> profiles["air.drag_coefficient"].interval  # doctest: +SKIP
    """
    if not 0 < level < 1:
        raise InputError(f"the level is {level:g}: give one between 0 and 1, such as 0.95")
    if result.status != "converged":
        raise InputError("the fit did not converge, so it has no optimum to profile: fit it first")
    fitted = Fitted.of(result, runs)
    if known is not None and (known.fit, known.level) != (fit_key(result), level):
        raise InputError("the known profiles are of another fit or level: leave them out")
    optimum = fitted.optimum()
    asked = quantity_names(result, optimum, paths)
    there = {} if known is None else known.profiles
    names = [name for name in asked if name not in there]
    tasks = [
        Task(one_side, {"fitted": fitted, "name": name, "side": side, "level": level})
        for name in names
        for side in SIDES
    ]
    outcomes = run_tasks(tasks, executor=executor, folder=folder, progress=progress)
    profiles = {}
    for index, name in enumerate(names):
        profiled = profiled_of(result, optimum, name)
        pair = outcomes[2 * index], outcomes[2 * index + 1]
        profiles[name] = combined(optimum, profiled, level, pair)
    return Profiles(
        fit=fit_key(result),
        level=level,
        labels=optimum.labels[: optimum.state.problem.shared],
        profiles={name: there[name] if name in there else profiles[name] for name in asked},
    )


def profiles_beside(result: FitResult, folder: str | Path) -> Profiles | None:
    """The profiles of a result that are in a folder; None if there are none of it.

    Arguments:
        result: of a fit.
        folder: that `result.json` is in.
    """
    try:
        found = load_profiles(folder)
    except InputError:
        return None
    return found if found.fit == fit_key(result) else None
