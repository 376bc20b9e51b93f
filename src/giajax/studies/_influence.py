"""Influence of each run, marker, channel and time span on each parameter of a fit."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from typing import Any, Literal, Unpack

import numpy as np

from ..fitting import CellEquations, FitResult, Optimum, Recorded
from ..recordings import Channel, Run
from ..runtime.execution import Execution
from ..runtime.records import finite_or_none
from ..runtime.text import InputError, keywords_listed
from ._refit import Fitted, StudyRecord, end_values


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """Effect of omitting a part of the data, by parameter.

    Attributes:
        kind: kind of the part: "run", "marker", "channel" or "span".
        name: name of the part.
        cells: number of cells in the part.
        steps: first-order shift of each parameter, divided by its standard error; None if the
            remaining data do not determine the parameter. Parameters that belong only to an omitted
            run are not listed.
        widening: standard error without the part divided by the standard error with it; None if the
            remaining data do not determine the parameter.
        exact: shift according to a new fit; None if no fit was requested or the fit did not
            converge. The entry of a parameter that the remaining data do not determine is None.
        exact_widening: widening according to the new fit; if the noise is scaled by the residuals,
            with their new scale.
        reason: reason why a fit did not converge (`FitResult.reason`).
    """

    kind: str
    name: str
    cells: int
    steps: dict[str, float | None]
    widening: dict[str, float | None]
    exact: dict[str, float | None] | None = None
    exact_widening: dict[str, float | None] | None = None
    reason: str = ""

    @property
    def shifts(self) -> dict[str, float | None]:
        """Shifts according to the new fit if there is one, otherwise first-order shifts."""
        return self.steps if self.exact is None else self.exact

    @property
    def largest(self) -> float:
        """Largest shift divided by the standard error; infinite if a parameter is undetermined."""
        return max(
            (float("inf") if shift is None else abs(shift) for shift in self.shifts.values()),
            default=0.0,
        )

    @property
    def surprise(self) -> float | None:
        """Largest ratio of a shift to its expected size; None if no shift is expected.

        If the model is correct, omitting a part shifts an estimate randomly. The variance of the
        shift is the variance of the estimate without the part minus the variance with it (Hausman
        1978). A ratio above 3 is unlikely to be due to chance.
        """
        ratios = []
        for path, shift in self.shifts.items():
            wider = self.widening[path]
            if shift is not None and wider is not None and wider**2 > 1 + 1e-9:
                ratios.append(abs(shift) / (wider**2 - 1) ** 0.5)
        return max(ratios, default=None)


@dataclasses.dataclass(frozen=True)
class Influence(
    StudyRecord,
    file="influence.json",
    head={"schema_version": 1},
    remedy="run 'giajax influence' again",
):
    """Influence of each part of the data on the parameters of a fit.

    Attributes:
        parameters: standard error of each parameter that the data determine, SI.
        parts: omitted parts, in order of decreasing largest shift.
        notes: sentences on the limitations of the numbers.
        fitted: values of the free parameters of the result, which identify the result.
    """

    parameters: dict[str, float]
    parts: tuple[LeftOut, ...]
    notes: tuple[str, ...]
    fitted: dict[str, float]

    def of_kind(self, kind: str) -> tuple[LeftOut, ...]:
        """Return the parts of a kind: "run", "marker", "channel" or "span"."""
        return tuple(part for part in self.parts if part.kind == kind)


Kind = Literal["run", "marker", "channel", "span"]


@dataclasses.dataclass(frozen=True)
class Part:
    """Cells that are omitted together.

    Attributes:
        kind: "run"; "marker": all coordinates of a point in all runs; "channel": one channel in all
            runs; or "span": a time span of one run.
        name: name of the part.
        runs: indices of the runs that contain cells of the part.
        channels: names of its channels; None for all.
        rows: index of its first sample and the index after its last one; None for all.
    """

    kind: Kind
    name: str
    runs: tuple[int, ...]
    channels: tuple[str, ...] | None = None
    rows: tuple[int, int] | None = None

    def of(self, index: int, name: str, samples: int) -> np.ndarray | None:
        """Return a mask of the omitted samples of a channel of a run; None if there are none."""
        if index not in self.runs or (self.channels is not None and name not in self.channels):
            return None
        gone = np.zeros(samples, bool)
        gone[slice(*(self.rows or (None,)))] = True
        return gone


def parts_of(runs: Sequence[Run], spans: int) -> list[Part]:
    """List all parts of some runs that can be omitted, except all runs together.

    A marker that has only one channel is listed as a marker, not as a channel. `spans` have equal
    durations, or equal numbers of samples in a static run.
    """
    everywhere = tuple(range(len(runs)))
    parts = [Part("run", run.name, (i,)) for i, run in enumerate(runs) if len(runs) > 1]
    names = list(dict.fromkeys(name for run in runs for name in run.observations))
    markers: dict[str, list[str]] = {}
    for name in names:
        if Channel.named(name).component is not None:
            markers.setdefault(name[:-2], []).append(name)
    if len(names) > 1:
        several = [(body, tuple(of)) for body, of in markers.items() if len(of) < len(names)]
        parts += [Part("marker", body, everywhere, of) for body, of in several]
        alone = {of[0] for _, of in several if len(of) == 1}
        parts += [Part("channel", n, everywhere, (n,)) for n in names if n not in alone]
    return parts + [span for i, run in enumerate(runs) for span in _spans(i, run, spans)]


def _spans(index: int, run: Run, count: int) -> list[Part]:
    samples = len(next(iter(run.observations.values())))
    over = np.arange(samples, dtype=float) if run.times is None else run.times
    edges = np.linspace(over[0], over[-1], count + 1)
    places = [0, *np.searchsorted(over, edges[1:-1]).tolist(), samples]
    unit = "" if run.times is None else " s"
    names = [
        f"{run.name}, {low:.4g} to {high:.4g}{unit}" for low, high in itertools.pairwise(edges)
    ]
    return [
        Part("span", name, (index,), rows=rows)
        for name, rows in zip(names, itertools.pairwise(places), strict=True)
        if count > 1 and rows[0] < rows[1]
    ]


def left_out(fitted: Fitted, parts: Sequence[Part]) -> list[dict[str, Any]]:
    """Task: repeat a fit without each of some parts.

    Returns, for each part, `converged`, `reason`, and by label the `values` and `errors` of the
    parameters that the remaining data determine.
    """
    optimum = fitted.optimum()
    rows = []
    for part in parts:
        again = optimum.refit(recorded=without(optimum, part))
        row: dict[str, Any] = {"converged": again.converged, "reason": again.reason}
        if again.state.evaluated:
            known = again.statistics
            places = [i for i in known.determined if np.isfinite(known.standard_errors[i])]
            row["values"] = {known.labels[i]: float(known.values[i]) for i in places}
            row["errors"] = {known.labels[i]: known.standard_errors[i] for i in places}
        rows.append(row)
    return rows


def without(optimum: Optimum, part: Part) -> Recorded:
    """Return the recorded values of the runs without one part."""
    left: list[dict[str, np.ndarray]] = []
    for index, run in enumerate(optimum.state.setup.runs):
        left.append(dict(run.observations))
        for name, row in run.observations.items():
            if (gone := part.of(index, name, len(row))) is not None:
                left[-1][name] = np.where(gone, np.nan, row)
    return left


_CHUNK = 16  # fits per task, which share a compiled program
_MOST_SPANS = 1000


@keywords_listed()
def influence(
    result: FitResult,
    runs: Run | Sequence[Run],
    *,
    exact: bool = False,
    spans: int = 10,
    **how: Unpack[Execution],
) -> Influence:
    """Compute the influence of each run, marker, channel and time span on each parameter.

    Without a part of the cells, one Newton step from the optimum leads to

        x_rest = x - A^-1 b,    A = X^T V^-1 X,    b = X^T V^-1 r

    with the derivatives X and residuals r (predicted minus recorded) of the remaining cells, and
    the covariance V of their noise. For correlated noise, the inverse of V is not a part of the
    inverse for all cells, so it is computed again. The step is exact for a linear model. For a
    robust loss, psi and psi' replace the residual and its derivative. The noise and the weights of
    outliers are fixed.

    If there are several runs, the fit is repeated without each of them. The other parts are
    evaluated with the Newton step, unless `exact` is set. A part may shift a parameter strongly for
    two reasons. If the part determines the parameter, the standard error without the part is much
    larger and the shift is expected. Otherwise the part is in conflict with the other data
    (`LeftOut.surprise`).

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        exact: repeat the fit also without each marker, channel and span.
        spans: number of spans of equal duration into which each run is divided; 1 for none.
        how: execution of the tasks, each of 16 fits, as for `giajax.runtime.execution.Execution`.

    Raises:
        InputError: the runs do not match the result; the fit has not converged; or the number
            of spans is invalid.

    Example:
        >>> found = giajax.influence(result, runs)  # doctest: +SKIP
        >>> found.of_kind("marker")[0].name  # doctest: +SKIP
        'link20'
    """
    fitted = Fitted.of(result, runs, converged=True)
    if not 1 <= spans <= _MOST_SPANS:
        raise InputError(f"the number of spans is {spans}: give a number from 1 to {_MOST_SPANS}")
    optimum = fitted.optimum()
    parts = parts_of(fitted.runs, spans)
    steps = _steps(optimum, parts)
    fits = [part for part in parts if exact or part.kind == "run"]
    chunks = [{"parts": fits[first : first + _CHUNK]} for first in range(0, len(fits), _CHUNK)]
    outcomes = fitted.study(left_out, chunks, **how)
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
        fitted=end_values(result),
    )


def _steps(optimum: Optimum, parts: Sequence[Part]) -> list[LeftOut]:
    """Return the first-order effect of omitting each part."""
    equations, known = CellEquations.of(optimum), optimum.statistics
    said = {key: equations.said(*key) for key in equations.cells}
    whole = equations.whole(list(said.values()))
    offset, errors = whole.step()
    steps = []
    for part in parts:
        # The contributions of the remaining cells are summed. Subtracting the omitted cells from
        # the total would leave rounding errors for parameters that become undetermined.
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
        # Parameters at a bound are fixed there.
        shifts: dict[str, float | None] = {
            known.labels[i]: 0.0 for i in known.determined if i not in own
        }
        widening: dict[str, float | None] = dict.fromkeys(shifts, 1.0)
        for at, place in enumerate(equations.positions):
            if place in known.determined and place not in own:
                # The remaining step of the fit to its optimum is subtracted.
                off = (step[at] - offset[at]) / known.standard_errors[place]
                shifts[known.labels[place]] = finite_or_none(off)
                widening[known.labels[place]] = finite_or_none(wider[at] / errors[at])
        steps.append(LeftOut(part.kind, part.name, cells, shifts, widening))
    return steps


def _with_fit(step: LeftOut, optimum: Optimum, row: Mapping[str, Any]) -> LeftOut:
    """Add the shifts according to a fit without the part."""
    if not row["converged"]:
        return dataclasses.replace(step, reason=row["reason"])
    known, values = optimum.statistics, row["values"]
    shifts: dict[str, float | None] = dict.fromkeys(step.steps)
    widening = shifts.copy()
    for label in step.steps.keys() & values.keys():
        place = known.labels.index(label)
        error = known.standard_errors[place]
        shifts[label] = (values[label] - float(known.values[place])) / error
        widening[label] = row["errors"][label] / error
    return dataclasses.replace(step, exact=shifts, exact_widening=widening)


def _own(optimum: Optimum, part: Part) -> set[int]:
    """Return the indices of the parameters that affect only the omitted runs."""
    if part.kind != "run":
        return set()
    mine, others = set[int](), set[int]()
    for group in optimum.state.problem.batches:
        for member, columns in zip(group.members, group.columns().tolist(), strict=True):
            (mine if member in part.runs else others).update(columns)
    return mine - others


def _notes(optimum: Optimum, *, exact: bool) -> tuple[str, ...]:
    notes = ["the noise and the weights of outliers are fixed at their fitted values"]
    if not exact:
        notes.append(
            "the effect of leaving out a part other than a run is computed to first order: "
            "exact=True (--exact) repeats the fit without each part"
        )
    known = optimum.statistics
    if held := [known.labels[place] for place in known.bounds]:
        notes.append(
            f"to first order, these parameters are fixed at their bounds: {', '.join(held)}"
        )
    return tuple(notes)
