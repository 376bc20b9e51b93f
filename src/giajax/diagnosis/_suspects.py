"""Suspects: a test of everything that a fit held, switched off or left out."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from .._errors import InputError
from ..fitting import FitResult, Response, Suspect, matching_runs
from ..models import AbstractModel
from ..parameters import declared
from ..runs import Run
from ._axes_test import axes_row
from ._candidates import Inquiry, inquiry
from ._ended import Moved, responses_of
from ._neutral import is_disturbed, not_neutral
from ._projection import projected
from ._records import Suspects
from ._rows import impossible_row, parameter_rows, switch_row
from ._weights import Weighing, robust_weights, white_noise


def suspects(result: FitResult, runs: Run | Sequence[Run], *, each: Sequence[str] = ()) -> Suspects:
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
    runs = matching_runs(result.runs, runs)
    of_this_fit = result.model, list(result.free), each, result.config.get("ties")
    asked = inquiry(*of_this_fit)
    at = linearised(result, runs, asked)
    if is_disturbed(result, runs, at):
        asked = inquiry(*of_this_fit, not_neutral(result, runs))
        at = linearised(result, runs, asked)
    return tested(result, runs, asked, at)


def linearised(result: FitResult, runs: Sequence[Run], asked: Inquiry) -> list[Response]:
    """The responses of each run where the fit ended, those to the fitted parameters first."""
    directions = [*asked.free, *(candidate.direction for candidate in asked.candidates)]
    return responses_of(result, runs, asked.model, directions)


def tested(
    result: FitResult, runs: Sequence[Run], asked: Inquiry, at: Sequence[Response]
) -> Suspects:
    """The tests from the responses where a fit ended."""
    weights = robust_weights(result, runs, at)
    weighing = Weighing.of(at, white_noise(result, runs, at), weights)
    switches = _switches(result, asked, runs, at)
    moved = Moved.of(result)
    tables = weighing.tables(at, runs, moved, list(switches.values()))
    rest = projected(tables, moved.known)
    cells = weighing.chi_square(at, [response.predicted for response in at])
    chi_square = cells + moved.squares
    rows = parameter_rows(rest, asked)
    first = len(asked.candidates)
    rows += [switch_row(rest, first + i, name) for i, name in enumerate(switches)]
    axes, ways = axes_row(result, runs, at, weighing, cells, rest)
    rows += axes
    rows += [impossible_row(path, reason) for path, reason in asked.impossible.items()]
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


def _switches(
    result: FitResult, asked: Inquiry, runs: Sequence[Run], at: Sequence[Response]
) -> dict[str, list[np.ndarray]]:
    """By the name of each choice of the model: how it changes the predictions of each run."""
    paths = [direction.path for direction in asked.free]
    changes: dict[str, list[np.ndarray]] = {}
    base: list[Response] | None = None
    for name, variant in result.model.variants().items():
        if not set(paths) <= set(declared(variant)):
            continue
        if base is None:
            base = responses_of(result, runs, _stepped(result.model, asked))
        try:
            other = responses_of(result, runs, _stepped(variant, asked), variant=name)
        except InputError:  # It cannot be evaluated with these values.
            continue
        changes[name] = [a.predicted - b.predicted for a, b in zip(other, base, strict=True)]
    return changes


def _stepped(model: AbstractModel, asked: Inquiry) -> AbstractModel:
    """With the steps of the integrator that the columns have."""
    return model.for_derivatives([one.direction.path for one in asked.candidates])


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
