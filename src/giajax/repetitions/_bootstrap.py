"""A fit repeated with data that might have been recorded instead: the bootstrap."""

from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any, get_args

from .._errors import InputError
from ..execution import Outcome, Task, run_tasks
from ..fitting import FitResult, Optimum
from ..runs import Run
from ..study import Fitted
from ._records import Bootstrap, Method, Repeated
from ._replicates import block_lengths
from ._summary import repeated

# Repetitions of a task, which share a program; and numbers that are the same whoever does them.
CHUNK = 16

_LARGEST = 1_000_000


def bootstrap(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    size: int = 200,
    method: Method = "parametric",
    whole: bool = False,
    seed: int = 0,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
) -> Bootstrap:
    """Repeat a fit with data that might have been recorded instead (Efron 1979).

    The standard errors of a result are those of a linear model with the noise that it found. The
    repetitions know nothing of that: they say what bias curvature makes, how far estimates really
    spread, how often the 95 % interval holds the truth, and how many fits come back at all.

    - **parametric**: what the fitted model predicts, with noise of the fitted noise model, white
      and correlated, at the times and in the cells that were measured. The truth is known here,
      but model and noise are taken for right.
    - **block**: with blocks of the residuals in place of that noise. They have the memory and the
      sizes that the residuals really have; the intervals of the result are not judged.

    What priors know is drawn anew, too, as one more measurement.

    Each repetition begins where the fit ended, and so cannot tell whether others start to end
    elsewhere (`giajax.multi_start` does). Its noise is held as fitted, weights of outliers too,
    unless it is fitted whole, which takes about ten times as long.

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        size: repetitions, 2 at least.
        method: "parametric" or "block".
        whole: fit each as the data were, with the noise to be found again.
        seed: of all repetitions; repetition n has random numbers of its own, of the seed and n.
        executor: as of `giajax.execution.run_tasks`; by default this process.
        folder: of the files of tasks of 16 repetitions; what has a file is not done again.
        progress: called after each task, as of `run_tasks`.

    Returns:
        What the repetitions say; after Ctrl-C, those that were done.

    Raises:
        InputError: other runs than those of the result, which has not converged; a size or method
            that is none; a whole fit with priors; or not two repetitions that could be done.

    Example:
        >>> found = giajax.bootstrap(result, runs, size=400)  # doctest: +SKIP
        >>> found.parameters["air.drag_coefficient"].ratio  # doctest: +SKIP
        1.02
    """
    fitted = Fitted.of(result, runs)
    if not 2 <= size <= _LARGEST:
        raise InputError(f"the size of a bootstrap is {size}: give 2 repetitions at least")
    if method not in get_args(Method):
        raise InputError(f"there is no bootstrap '{method}': use one of: parametric, block")
    if seed < 0:
        raise InputError(f"the seed is {seed}: give 0 or a positive number")
    if result.status != "converged":
        raise InputError(
            "the fit did not converge, and there is no optimum to repeat: fit it to its end first"
        )
    if whole and result.config.get("priors"):
        raise InputError(
            "a fit with priors cannot be repeated whole, because what they know is not drawn anew "
            "there: leave whole (--whole) out"
        )
    optimum = fitted.optimum()
    common = {"fitted": fitted, "method": method, "whole": whole, "seed": seed}
    tasks = [
        Task(
            "giajax.repetitions._replicates:replicates",
            {**common, "first": first, "count": min(CHUNK, size - first)},
        )
        for first in range(0, size, CHUNK)
    ]
    outcomes = run_tasks(tasks, executor=executor, folder=folder, progress=progress)
    rows = [row for outcome in outcomes if outcome.status == "done" for row in outcome.value]
    failures = tuple(dict.fromkeys(each.message for each in outcomes if each.message))
    if len(rows) < 2:
        why = failures[0] if failures else "it was stopped"
        raise InputError(f"no two repetitions of the fit could be done: {why}")
    back = [row for row in rows if row["converged"]]
    scale = optimum.statistics.scale if method == "parametric" else 1.0
    return Bootstrap(
        method=method,
        seed=seed,
        size=len(rows),
        asked=size,
        whole=whole,
        came_back=len(back),
        reasons=dict(Counter(row["reason"] for row in rows if not row["converged"])),
        failures=failures,
        at_bounds=dict(Counter(label for row in back for label in row["bounds"])),
        parameters=_parameters(result, optimum, back, judged=method == "parametric"),
        block_lengths=block_lengths(optimum) if method == "block" else {},
        noise_factor=float(scale) ** 0.5,
        notes=_notes(result, method, whole=whole),
        fitted={path: float(estimate.value) for path, estimate in result.free.items()},
    )


def _parameters(
    result: FitResult, optimum: Optimum, back: Sequence[dict[str, Any]], *, judged: bool
) -> dict[str, Repeated]:
    """What the fits that came back say, by name."""
    known = optimum.statistics
    found = {}
    for place in known.determined:
        label = known.labels[place]
        estimate = result.parameters.get(label.partition(" of ")[0])
        found[label] = repeated(
            float(known.values[place]),
            known.standard_errors[place],
            "" if estimate is None else estimate.unit,
            [row["values"][place] for row in back],
            [row["reach"][place] for row in back] if judged else None,
        )
    for name, estimate in result.derived.items():
        found[name] = repeated(
            float(estimate.value),
            estimate.standard_error,
            estimate.unit,
            [row["derived"][name] for row in back],
            None,
        )
    return found


def _notes(result: FitResult, method: Method, *, whole: bool) -> tuple[str, ...]:
    """What the repetitions leave out."""
    notes = ["each repetition begins where the fit ended, so that other optima are not looked for"]
    if not whole:
        notes.append(
            "the noise is held as it was fitted, so that what its estimation adds is left out: "
            "whole=True (--whole) repeats that, too"
        )
    if method == "parametric":
        notes.append("the data are those of the fitted model and noise, which are taken for right")
        if result.config.get("loss", "linear") != "linear":
            notes.append(
                "noise is normal, and larger where a cell counts for little: such outliers as the "
                "loss is robust against are made in no other cells"
            )
    else:
        notes.append(
            "the mean of each channel's residuals is left out, and residuals between runs are not "
            "exchanged"
        )
    return tuple(notes)
