"""Suspects: a test of everything that a fit held, switched off or left out."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Response, Suspect, responses
from ..models import AbstractModel
from ..parameters import declared, replace
from ..runs import Run
from ..study import begun_where_it_ended
from ._axes import IDENTITY, Axes, coordinates, distinct_axes, name_of, seen_as
from ._candidates import Candidate, Inquiry, inquiry
from ._records import Suspects
from ._score import IMITATED, Projected, Score, alike, projected, score
from ._weights import Weighing, matching_runs, own_values, robust_weights, white_noise

# A change by so many times its own size that would still not show makes a parameter not testable.
_NOT_SHOWN = 3.0
_ALIKE = 0.99


def suspects(
    result: FitResult, runs: Run | Sequence[Run], *, each: Sequence[str] = ()
) -> Suspects:
    """What the residuals of a fit ask for.

    At the end of a fit everything that it held, switched off or left out gets a test: how much
    chi-square would fall if it were free, and to which value one step leads. Nothing is fitted.

    - **Parameters**, those that are left out included, by a score test from one more block of
      columns of the Jacobian; vectors also as a whole. What lies at a bound is tested towards
      the inside alone.
    - **Choices of the model**, such as where drag acts, by a blend from 0 to 1 between the
      predictions of both.
    - **Axes of recorded positions**, in each of their 48 orders and signs, without a fit, where
      the fit ended and where it began: a fit of wrong axes may have bent its model to them.

    Missing physics is no noise, so the table is in the order of the drop of chi-square (less what
    as many random columns would take from residuals of this size), with the white noise that the
    runs state, or else that of second differences of the residuals. The p-values are those of the
    noise that is left after the step, which may be larger and correlated along time (AR(1) in the
    samples of each channel), corrected for the number of tests by Holm's method.

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        each: paths of arrays, such as `encoder.offset`, whose elements are tested one by one and
            together; by default all of them change in proportion.

    Returns:
        The tests, the most promising first.

    Raises:
        InputError: other runs than those of the result, a path in `each` that is no array, or a
            fitted model that cannot be evaluated.

    Example:
        >>> result = giajax.load_result("giajax-out/base_step")  # doctest: +SKIP
        >>> giajax.suspects(result, runs).promising[0].path  # doctest: +SKIP
        'camera.delay'
    """
    runs = matching_runs(result, runs)
    asked = inquiry(result.model, list(result.free), each)
    return tested(result, runs, asked, linearised(result, runs, asked))


def linearised(result: FitResult, runs: Sequence[Run], asked: Inquiry) -> list[Response]:
    """The responses of each run where the fit ended, those to the fitted parameters first."""
    directions = [*asked.free, *(candidate.direction for candidate in asked.candidates)]
    return responses(asked.model, runs, directions, own_values(result))


def tested(
    result: FitResult, runs: Sequence[Run], asked: Inquiry, at: Sequence[Response]
) -> Suspects:
    """The tests from the responses where a fit ended."""
    weights = robust_weights(result, runs, at)
    weighing = Weighing.of(at, white_noise(result, runs, at), weights)
    switches = _switches(result, asked, runs, at)
    tables = weighing.tables(at, runs, len(asked.free), list(switches.values()))
    rest = projected(tables)
    chi_square = weighing.chi_square(at, [response.predicted for response in at])
    rows = _parameter_rows(rest, asked)
    first = len(asked.candidates)
    rows += [_switch_row(rest, first + i, name) for i, name in enumerate(switches)]
    axes, ways = _axes_row(result, runs, at, weighing, chi_square, rest)
    rows += axes
    rows += [_impossible(path, reason) for path, reason in asked.impossible.items()]
    rows, number = _corrected(rows, further=max(ways - 1, 0))
    # What a column of random numbers takes from residuals of this size, on the scale of BIC.
    price = np.log(rest.values) * max(1.0, chi_square / rest.values)

    def worth(row: Suspect) -> float:
        if not row.testable or row.chi_square_drop is None:
            return -np.inf
        return float(row.chi_square_drop - price * row.degrees_of_freedom)

    return Suspects(
        rows=tuple(sorted(rows, key=worth, reverse=True)),
        chi_square=chi_square,
        values=rest.values,
        parameters=rest.parameters,
        asked=number,
    )


def _parameter_rows(rest: Projected, asked: Inquiry) -> list[Suspect]:
    candidates = asked.candidates
    notes = [_why_not(rest, index, one) for index, one in enumerate(candidates)]
    members: dict[str, list[int]] = {}
    for index, (one, note) in enumerate(zip(candidates, notes, strict=True)):
        if not note:
            members.setdefault(one.path, []).append(index)
            if one.group:
                members.setdefault(one.group, []).append(index)
    members = {
        path: several
        for path, several in members.items()
        if len(several) > 1 or candidates[several[0]].path == path
    }
    rows = [
        _not_testable(one, note) for one, note in zip(candidates, notes, strict=True) if note
    ]
    for path, indices in members.items():
        among = [candidates[index] for index in indices]
        found = score(
            rest,
            indices,
            [min(one.lower - one.value, 0.0) for one in among],
            [max(one.upper - one.value, 0.0) for one in among],
        )
        others = tuple(
            name
            for name, other in members.items()
            if not set(indices) & set(other)
            and len(other) == len(indices)
            and alike(rest, indices, other) > _ALIKE
        )
        rows.append(_row(path, among, found, others))
    return rows


def _row(path: str, among: Sequence[Candidate], found: Score, others: tuple[str, ...]) -> Suspect:
    value = [one.value for one in among]
    estimate = [one.value + float(step) for one, step in zip(among, found.step, strict=True)]
    error = [float(number) for number in found.error]
    group = len(among) > 1
    note = ""
    if not group and (value[0] <= among[0].lower or value[0] >= among[0].upper):
        note = "held at its bound: tested towards the inside"
        if found.drop == 0:
            note += ", and the data lead outwards"
    return Suspect(
        path=path,
        kind="group" if group else among[0].kind,
        unit=among[0].unit,
        value=value if group else value[0],
        estimate=estimate if group else estimate[0],
        estimate_error=error if group else error[0],
        chi_square_drop=found.drop,
        degrees_of_freedom=len(among),
        p_value=found.p_value,
        testable=True,
        alike=others,
        note=note,
    )


def _why_not(rest: Projected, index: int, one: Candidate) -> str:
    """Why a candidate is not testable; empty where it is."""
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if not np.isfinite(norm):
        return "its derivative is not finite here"
    if norm * one.size < 1e-6:
        return "no channel responds to it"
    if left < IMITATED * norm:
        return "what was fitted imitates it: only a ratio shows"
    if left * one.size * _NOT_SHOWN < 1:
        return f"the data would not show a change by {_NOT_SHOWN:g} times its size"
    return ""


def _not_testable(one: Candidate, note: str) -> Suspect:
    return Suspect(
        one.path, one.kind, one.unit, one.value, None, None, None, 1, None, False, (), note
    )


def _impossible(path: str, reason: str) -> Suspect:
    return Suspect(path, "parameter", "", None, None, None, None, 1, None, False, (), reason)


def _switches(
    result: FitResult, asked: Inquiry, runs: Sequence[Run], at: Sequence[Response]
) -> dict[str, list[np.ndarray]]:
    """By the name of each choice of the model: how it changes the predictions of each run."""
    own = own_values(result)
    paths = [direction.path for direction in asked.free]
    changes: dict[str, list[np.ndarray]] = {}
    base: list[Response] | None = None
    for name, variant in result.model.variants().items():
        if not set(paths) <= set(declared(variant)):
            continue
        if base is None:
            base = responses(_stepped(result.model, asked), runs, (), own)
        try:
            other = responses(_stepped(variant, asked), runs, (), own)
        except InputError:  # It cannot be evaluated with these values.
            continue
        changes[name] = [a.predicted - b.predicted for a, b in zip(other, base, strict=True)]
    return changes


def _stepped(model: AbstractModel, asked: Inquiry) -> AbstractModel:
    """With the steps of the integrator that the columns have."""
    return model.for_derivatives([one.direction.path for one in asked.candidates])


def _switch_row(rest: Projected, index: int, name: str) -> Suspect:
    norm, left = float(rest.norms[index]), float(rest.perpendicular[index])
    if norm < 1 or left < max(1.0, IMITATED * norm):
        note = "what was fitted imitates it" if norm >= 1 else "it changes no prediction"
        return Suspect(name, "switch", "", 0.0, None, None, None, 1, None, False, (), note)
    found = score(rest, [index], [0.0], [1.0])
    return Suspect(
        path=name,
        kind="switch",
        unit="",
        value=0.0,
        estimate=float(found.step[0]),
        estimate_error=float(found.error[0]),
        chi_square_drop=found.drop,
        degrees_of_freedom=1,
        p_value=found.p_value,
        testable=True,
    )


def _axes_row(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    weighing: Weighing,
    chi_square: float,
    rest: Projected,
) -> tuple[list[Suspect], int]:
    """The best of the other orders and signs of the axes, and how many were tried."""
    ways = distinct_axes(runs)
    if not ways:
        return [], 0
    points = [result.model]
    if result.history:
        points.append(replace(result.model, result.history[0].parameters))
    begun = begun_where_it_ended(result, runs)
    best: tuple[float, Axes, bool] | None = None
    for number, model in enumerate(points):
        whole = [coordinates(model, run) for run in begun]
        for way in ways:
            seen = [
                seen_as(way, run, predicted, response.channels)
                for run, predicted, response in zip(runs, whole, at, strict=True)
            ]
            other = weighing.chi_square(at, seen)
            if way != IDENTITY and (best is None or other < best[0]) and np.isfinite(other):
                best = other, way, number > 0
    if best is None:
        return [], len(ways)
    other, way, at_start = best
    drop = max(chi_square - other, 0.0)
    # Of two models without anything free, a likelihood ratio of 1/c has a probability below c.
    scale = max(1.0, other / max(rest.values - rest.parameters, 1))
    row = Suspect(
        path=name_of(way),
        kind="axes",
        unit="",
        value=None,
        estimate=None,
        estimate_error=None,
        chi_square_drop=drop,
        degrees_of_freedom=1,
        p_value=float(min(1.0, np.exp(-drop / scale / 2))),
        testable=True,
        note="with the values that the fit began with" if at_start and drop else "",
    )
    return [row], len(ways)


def _corrected(rows: Sequence[Suspect], further: int) -> tuple[list[Suspect], int]:
    """Rows with p-values corrected by Holm's method, and the number of tests.

    Arguments:
        rows: with p-values of single tests.
        further: tests of which only the best has a row.
    """
    order = sorted(
        (index for index, row in enumerate(rows) if row.p_value is not None),
        key=lambda index: rows[index].p_value or 0.0,
    )
    number = len(order) + further
    corrected = list(rows)
    highest = 0.0
    for rank, index in enumerate(order):
        raw = rows[index].p_value or 0.0
        highest = max(highest, min(1.0, raw * (number - rank)))
        corrected[index] = dataclasses.replace(rows[index], p_value=highest)
    return corrected, number
