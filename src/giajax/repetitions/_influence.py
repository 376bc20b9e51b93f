"""What each run, marker, channel and span of time does to each parameter of a fit."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import Any

import numpy as np

from .._errors import InputError
from ..execution import Outcome, Task, run_tasks
from ..fitting import CellEquations, FitResult, Optimum
from ..runs import Run
from ..study import Fitted
from ._influence_records import Influence, LeftOut
from ._parts import Part, parts_of

# Fits of a task, which share a program.
_CHUNK = 16

_MOST_SPANS = 1000


def influence(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    exact: bool = False,
    spans: int = 10,
    executor: Executor | None = None,
    folder: str | Path | None = None,
    progress: Callable[[Outcome, int, int], None] | None = None,
) -> Influence:
    """What each run, marker, channel and span of time does to each parameter.

    Without a part of the cells, one Newton step from the optimum leads to

        x_rest = x - A^-1 b,    A = X^T V^-1 X,    b = X^T V^-1 r

    with the derivatives X and residuals r (predicted less recorded) of the cells that are left, and
    V the covariance of their noise: of correlated noise it is not a part of the inverse of the
    whole, and so it is inverted anew. That is exact for a linear model. Of a robust loss, psi
    and psi' stand for residual and derivative. Noise, and weights of outliers, stay as they are.

    Single runs are left out by fits, if there are several; all other parts by steps alone, unless
    they are to be exact, too. A part may move a parameter by much because it decides it (then the
    error without it is much larger, and the shift is to be expected) or because it is in conflict
    with the others (`LeftOut.surprise`).

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        exact: fit without each marker, channel and span, too.
        spans: into how many each run is cut, of equal time; 1 for none.
        executor: as of `giajax.execution.run_tasks`; by default this process.
        folder: of the files of tasks of 16 fits; what has a file is not done again.
        progress: called after each task, as of `run_tasks`.

    Returns:
        The parts, the largest shift first.

    Raises:
        InputError: other runs than those of the result, a fit that has not converged, or a number
            of spans that is none.

    Example:
        >>> found = giajax.influence(result, runs)  # doctest: +SKIP
        >>> found.of_kind("marker")[0].name  # doctest: +SKIP
        'link20'
    """
    fitted = Fitted.of(result, runs)
    if not 1 <= spans <= _MOST_SPANS:
        raise InputError(f"there are {spans} spans: give a number from 1 to {_MOST_SPANS}")
    if result.status != "converged":
        raise InputError(
            "the fit did not converge, and there is no optimum: fit it to its end first"
        )
    optimum = fitted.optimum()
    parts = parts_of(fitted.runs, spans)
    steps = _steps(optimum, parts)
    fits = [part for part in parts if exact or part.kind == "run"]
    tasks = [
        Task(
            "giajax.repetitions._left_out:left_out",
            {"fitted": fitted, "parts": fits[first : first + _CHUNK]},
        )
        for first in range(0, len(fits), _CHUNK)
    ]
    outcomes = run_tasks(tasks, executor=executor, folder=folder, progress=progress)
    rows: dict[Part, Mapping[str, Any]] = {}
    for number, outcome in enumerate(outcomes):
        those = fits[number * _CHUNK : (number + 1) * _CHUNK]
        failed = [{"converged": False, "reason": outcome.message or "stopped"}] * len(those)
        rows.update(zip(those, outcome.value or failed, strict=True))
    found = [
        _with_fit(step, optimum, rows[part]) if part in rows else step
        for part, step in zip(parts, steps, strict=True)
    ]
    known = optimum.statistics
    return Influence(
        parameters={known.labels[i]: known.standard_errors[i] for i in known.determined},
        parts=tuple(sorted(found, key=lambda part: -part.largest)),
        notes=_notes(optimum, exact=exact),
        fitted={path: float(estimate.value) for path, estimate in result.free.items()},
    )


def _steps(optimum: Optimum, parts: Sequence[Part]) -> list[LeftOut]:
    """Of each part, the step to first order."""
    equations, known = CellEquations.of(optimum), optimum.statistics
    said = {key: equations.said(*key) for key in equations.cells}
    whole = equations.whole(list(said.values()))
    offset, errors = whole.step()
    steps = []
    for part in parts:
        # What is left is summed: of a difference, rounding would be left of what is lost.
        left, cells = [], 0
        for key, each in said.items():
            rows = equations.rows[key]
            gone = part.of(*key, len(rows))
            if gone is None:
                left.append(each)
                continue
            cells += int(np.sum(gone & rows))
            if not np.all(gone):
                left.append(equations.said(*key, ~gone))
        step, wider = equations.whole(left).step()
        own = _own(optimum, part)
        shifts: dict[str, float | None] = {}
        widening: dict[str, float | None] = {}
        for place in known.determined:
            label, error = known.labels[place], known.standard_errors[place]
            if place in own:
                continue
            if place not in equations.positions:  # At its bound, where it is held.
                shifts[label], widening[label] = 0.0, 1.0
                continue
            at = equations.positions.index(place)
            # What the fit has left to go is no part's.
            shifts[label] = _number((step[at] - offset[at]) / error)
            widening[label] = _number(wider[at] / errors[at])
        steps.append(LeftOut(part.kind, part.name, cells, shifts, widening))
    return steps


def _with_fit(step: LeftOut, optimum: Optimum, row: Mapping[str, Any]) -> LeftOut:
    """With what a fit without the part says."""
    if not row["converged"]:
        return dataclasses.replace(step, reason=row["reason"])
    known, values, errors = optimum.statistics, row["values"], row["errors"]
    shifts: dict[str, float | None] = {}
    widening: dict[str, float | None] = {}
    for label in step.steps:
        place = known.labels.index(label)
        error = known.standard_errors[place]
        shifts[label] = widening[label] = None
        if values.get(label) is not None:
            shifts[label] = (values[label] - float(known.values[place])) / error
            widening[label] = errors[label] / error
    return dataclasses.replace(step, exact=shifts, exact_widening=widening)


def _own(optimum: Optimum, part: Part) -> set[int]:
    """Positions of the parameters that only the runs respond to which are left out whole."""
    if part.kind != "run":
        return set()
    mine, others = set[int](), set[int]()
    for group in optimum.state.problem.groups:
        for member, columns in zip(group.members, group.columns().tolist(), strict=True):
            (mine if member in part.runs else others).update(columns)
    return mine - others


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _notes(optimum: Optimum, *, exact: bool) -> tuple[str, ...]:
    notes = ["the noise, and weights of outliers, are held as they were fitted"]
    if not exact:
        notes.append("all but single runs are left out to first order: exact=True (--exact) fits")
    known = optimum.statistics
    held = [known.labels[place] for place in known.bounds]
    if held:
        notes.append(f"at a bound, where a step to first order holds it: {', '.join(held)}")
    return tuple(notes)
