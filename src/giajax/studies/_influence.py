"""What each run, marker, channel and span of time does to each parameter of a fit."""

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
    """A fit without a part of its data, by parameter.

    Attributes:
        kind: of the part: "run", "marker", "channel" or "span".
        name: of the part.
        cells: how many it has.
        steps: shift of each parameter to first order, in its standard errors; None of what the
            rest does not determine. What a run that is left out has for itself is not there.
        widening: standard error without the part over that with it, likewise.
        exact: shift by a fit; None where none was asked for, or where it did not converge. A
            parameter that the rest does not determine is None.
        exact_widening: likewise; where the noise is scaled by the residuals, with their scale.
        reason: what ended a fit that did not converge (`FitResult.reason`).
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
        """By a fit where there was one, else to first order."""
        return self.steps if self.exact is None else self.exact

    @property
    def largest(self) -> float:
        """The largest shift of a parameter, in standard errors; infinite where one is lost."""
        return max(
            (float("inf") if shift is None else abs(shift) for shift in self.shifts.values()),
            default=0.0,
        )

    @property
    def surprise(self) -> float | None:
        """The largest shift over that to expect; None where nothing is to be expected.

        Of a right model, a part moves an estimate by a random amount, whose variance is that
        without the part less that with it (Hausman 1978): beyond 3 it is not by chance.
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
    remedy="run giajax influence again",
):
    """Influence of each part of the data on the parameters of a fit.

    Attributes:
        parameters: standard error of each that the data determine, SI.
        parts: without which the fit was asked, the largest shift first.
        notes: sentences on what the numbers leave out.
        fitted: values of the free parameters of the result, by which a reader knows whose it is.
    """

    parameters: dict[str, float]
    parts: tuple[LeftOut, ...]
    notes: tuple[str, ...]
    fitted: dict[str, float]

    def of_kind(self, kind: str) -> tuple[LeftOut, ...]:
        """The parts of a kind: "run", "marker", "channel" or "span"."""
        return tuple(part for part in self.parts if part.kind == kind)


Kind = Literal["run", "marker", "channel", "span"]


@dataclasses.dataclass(frozen=True)
class Part:
    """Cells that are left out together.

    Attributes:
        kind: "run"; "marker": all coordinates of a point in all runs; "channel", in all runs; or
            "span": a stretch of one run.
        runs: positions of the runs that have a part of it.
        channels: names of its channels; None for all.
        rows: its first sample and the one after its last; None for all.
    """

    kind: Kind
    name: str
    runs: tuple[int, ...]
    channels: tuple[str, ...] | None = None
    rows: tuple[int, int] | None = None

    def of(self, index: int, name: str, samples: int) -> np.ndarray | None:
        """Which samples of a channel of a run are left out; None where none is."""
        if index not in self.runs or (self.channels is not None and name not in self.channels):
            return None
        gone = np.zeros(samples, bool)
        gone[slice(*(self.rows or (None,)))] = True
        return gone


def parts_of(runs: Sequence[Run], spans: int) -> list[Part]:
    """Everything that may be left out of some runs, apart from all of them.

    A channel that is a marker by itself is listed as the marker; `spans` are of equal time, or
    number of samples.
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
    """A task: fits without each of some parts.

    Of each: `converged`, `reason`, and by label `values` and `errors` of what the rest determines.
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
    """What the runs recorded, without a part of it."""
    left: list[dict[str, np.ndarray]] = []
    for index, run in enumerate(optimum.state.setup.runs):
        left.append(dict(run.observations))
        for name, row in run.observations.items():
            if (gone := part.of(index, name, len(row))) is not None:
                left[-1][name] = np.where(gone, np.nan, row)
    return left


_CHUNK = 16  # fits of a task, which share a program
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
    """What each run, marker, channel and span of time does to each parameter.

    Without a part of the cells, one Newton step from the optimum leads to

        x_rest = x - A^-1 b,    A = X^T V^-1 X,    b = X^T V^-1 r

    with the derivatives X and residuals r (predicted less recorded) of the cells that are left, and
    V the covariance of their noise: of correlated noise it is not a part of the inverse of the
    whole, and so it is inverted again. That is exact for a linear model. Of a robust loss, psi
    and psi' stand for residual and derivative. Noise, and weights of outliers, stay as they are.

    Single runs are left out by fits, if there are several; all other parts by steps alone, unless
    they are to be exact, too. A part may move a parameter by much because it decides it (then the
    error without it is much larger, and the shift is to be expected) or because it is in conflict
    with the others (`LeftOut.surprise`).

    Arguments:
        result, runs: of `giajax.fit` or `giajax.load_result`, and what was fitted, in their order.
        exact: fit without each marker, channel and span, too.
        spans: into how many each run is cut, of equal time; 1 for none.
        how: who does the tasks of 16 fits, as of `giajax.runtime.execution.Execution`.

    Raises:
        InputError: other runs than those of the result, no converged fit, or no number of spans.

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
        # What is at its bound is held there.
        shifts: dict[str, float | None] = {
            known.labels[i]: 0.0 for i in known.determined if i not in own
        }
        widening: dict[str, float | None] = dict.fromkeys(shifts, 1.0)
        for at, place in enumerate(equations.positions):
            if place in known.determined and place not in own:
                # What the fit has left to go is no part's.
                off = (step[at] - offset[at]) / known.standard_errors[place]
                shifts[known.labels[place]] = finite_or_none(off)
                widening[known.labels[place]] = finite_or_none(wider[at] / errors[at])
        steps.append(LeftOut(part.kind, part.name, cells, shifts, widening))
    return steps


def _with_fit(step: LeftOut, optimum: Optimum, row: Mapping[str, Any]) -> LeftOut:
    """With what a fit without the part says."""
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
    """Positions of the parameters that only the runs respond to which are left out whole."""
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
        notes.append(f"parameters at a bound, fixed there to first order: {', '.join(held)}")
    return tuple(notes)
