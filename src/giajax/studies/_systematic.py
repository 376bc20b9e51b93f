"""Systematic errors of fitted parameters due to errors of fixed parameters."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..fitting import Direction, FitResult, SystematicError, matching_runs
from ..models import AbstractModel
from ..recordings import Run
from ..runtime.text import InputError
from ..schema.parameters import elements, get, switched_on
from ._candidates import Inquiry, inquiry
from ._score import Coordinates, responses_of, slopes_of
from ._suspects import suspects

FRACTION = 0.01
"""Relative uncertainty assumed for a fixed value whose uncertainty is not given."""


@dataclasses.dataclass(frozen=True)
class Doubt:
    """Uncertainty of one fixed value, or of several values that change together."""

    path: str
    unit: str
    value: float | list[float]
    uncertainty: float
    stated: bool
    direction: Direction


def check_uncertainty(
    model: AbstractModel,
    free: Sequence[str],
    uncertainty: Mapping[str, npt.ArrayLike],
    ties: Mapping[str, str] | None = None,
) -> None:
    """Reject uncertainties that `systematic_errors` would reject, before a fit starts."""
    stated_doubts(free, inquiry(model, free, ties=ties), uncertainty)


def stated_doubts(
    paths: Sequence[str], asked: Inquiry, uncertainty: Mapping[str, npt.ArrayLike]
) -> list[Doubt]:
    doubts = []
    free = set(paths)
    for path, deviation in uncertainty.items():
        model = switched_on(asked.model, [path])
        parts = elements(model, path)
        about = parts[0].declaration
        numbers = np.asarray(deviation, dtype=float)
        if numbers.size not in (1, len(parts)):
            raise InputError(
                f"the uncertainty of {path} has {numbers.size} values, but the parameter has "
                f"{len(parts)} element{'s' * (len(parts) != 1)}: give one value, or one for each "
                "element"
            )
        if not np.all(np.isfinite(numbers)) or not np.all(numbers > 0):
            raise InputError(f"the uncertainty of {path} is not positive: give a positive number")
        fitted = [part.path for part in parts if part.path in free]
        if fitted:
            raise InputError(
                f"{fitted[0]} is fitted, so the fit estimates its uncertainty: hold "
                f"{fitted[0]} fixed, or omit the uncertainty given for it"
            )
        if asked.following.issuperset(part.path for part in parts):
            raise InputError(
                f"{path} is tied to other parameters: give the uncertainty of those parameters"
            )
        name = path.partition("[")[0]
        whole = np.asarray(get(model, name), dtype=float)
        each = np.broadcast_to(numbers, (len(parts),))
        alone = bool(about.shape) or len(parts) == 1
        for index, part in enumerate(parts):
            step = np.zeros(whole.shape)
            if alone:
                step[... if part.index is None else part.index] = 1.0
                value, size = float(part.value(model)), float(each[index])
                along = Direction(name, step)
                doubts.append(Doubt(part.path, about.unit, value, size, True, along))
        if not alone:
            size = float(np.max(each))
            same = np.all(whole == whole[0])
            shown = float(whole[0]) if same else [float(number) for number in whole]
            step = each / size
            doubts.append(Doubt(name, about.unit, shown, size, True, Direction(name, step)))
    return [_shared(doubt, asked) for doubt in doubts]


def _shared(doubt: Doubt, asked: Inquiry) -> Doubt:
    """Use the direction of a candidate if it is the same."""
    for one in asked.candidates:
        same = one.direction.path == doubt.direction.path
        if same and np.array_equal(one.direction.step, doubt.direction.step):
            return dataclasses.replace(doubt, direction=one.direction)
    return doubt


# Shifts below this fraction of a standard error are treated as zero.
_NOTHING = 1e-6


def systematic_errors(
    result: FitResult,
    runs: Run | Sequence[Run],
    uncertainty: Mapping[str, npt.ArrayLike] | None = None,
) -> tuple[SystematicError, ...]:
    """Return the first-order effect of errors of fixed parameters on the fitted ones.

    If the sum of squares is stationary with respect to the fitted parameters theta, a change of a
    constant c shifts them by d(theta)/dc = -(J^T J)^-1 J^T z, with the columns J of theta and z of
    c (the implicit function theorem with the Gauss-Newton approximation of the Hessian). All
    columns are whitened by the noise that the fit used.

    Arguments:
        result, runs: result of `giajax.fit` or `giajax.load_result`, and the fitted runs in the
            same order.
        uncertainty: standard deviations of fixed values, SI, by path; defaults to those that were
            given to the fit. One value for a whole array shifts its elements together. The elements
            of a vector, such as the wind, are independent, and so are `links.mass[0]` and
            `links.mass[1]`.

    Returns:
        The effects of the given uncertainties, followed by the effect of 1 % of each other fixed
        value that is not zero, in order of decreasing largest shift relative to the standard error.
        Values without an effect are omitted.
    """
    several = matching_runs(result.runs, runs)
    if uncertainty is None:
        uncertainty = result.config.get("uncertainty") or {}
    asked = inquiry(result.model, list(result.free), ties=result.config.get("ties"))
    stated = stated_doubts(list(result.free), asked, uncertainty)
    known = {doubt.path.partition("[")[0] for doubt in stated}
    others = [
        Doubt(one.path, one.unit, one.value, FRACTION * abs(one.value), False, one.direction)
        for one in asked.candidates
        if one.value != 0 and one.direction.path not in known
    ]
    doubts = [*stated, *others]
    # The columns of all candidates are included, so that the program is the one that tests them.
    directions = [*asked.free, *(one.direction for one in asked.candidates)]
    places = {id(direction): place for place, direction in enumerate(directions)}
    for doubt in doubts:
        if places.setdefault(id(doubt.direction), len(directions)) == len(directions):
            directions.append(doubt.direction)
    at = responses_of(result, several, asked.model, directions)
    columns = [places[id(doubt.direction)] for doubt in doubts]
    slopes = slopes_of(result, several, at, columns, Coordinates.of(result))
    errors = [_error(result, doubt, slopes[:, index]) for index, doubt in enumerate(doubts)]
    kept = [(error, _weight(result, error)) for error in errors]
    # Given uncertainties come first, then the largest effects. Values without an effect have no
    # row.
    kept.sort(key=lambda each: (not each[0].stated, -each[1]))
    return tuple(error for error, weight in kept if error.stated or weight > _NOTHING)


def deciding_conditions(errors: Sequence[SystematicError]) -> list[str]:
    """Return a sentence for each fixed value whose uncertainty shifts a parameter noticeably.

    The uncertainty is as given, or 1 % of the value. The shift must exceed one standard error.
    """
    sentences = []
    for error in errors:
        change = f"{error.uncertainty:.3g} {error.unit}".rstrip() if error.stated else "1 %"
        if error.decides:
            sentences.append(
                f"{error.path}{_DECIDES} fixed, and a change of this value by {change} shifts "
                f"{_named(error.decides)} by more than one standard error"
            )
    return sentences


_DECIDES = ": is held"
_NAMED = 4


def _named(paths: Sequence[str]) -> str:
    """List the paths; only the first few are named."""
    if len(paths) <= _NAMED:
        return ", ".join(paths)
    return f"{', '.join(paths[: _NAMED - 1])} and {len(paths) - _NAMED + 1} others"


def together(errors: Sequence[SystematicError]) -> dict[str, float]:
    """Return the systematic error of each fitted parameter: the given ones, in quadrature."""
    stated = [error.shifts for error in errors if error.stated]
    paths = dict.fromkeys(path for shifts in stated for path in shifts)
    squares = {path: sum(shifts.get(path, 0.0) ** 2 for shifts in stated) for path in paths}
    return {path: float(np.sqrt(square)) for path, square in squares.items()}


def _error(result: FitResult, doubt: Doubt, slopes: np.ndarray) -> SystematicError:
    free = result.free
    shifts = {
        path: float(slope) * doubt.uncertainty for path, slope in zip(free, slopes, strict=True)
    }
    return SystematicError(
        path=doubt.path,
        unit=doubt.unit,
        value=doubt.value,
        uncertainty=doubt.uncertainty,
        stated=doubt.stated,
        shifts=shifts,
        decides=tuple(
            path
            for path in result.asked
            if abs(shifts[path]) > (free[path].standard_error or np.inf)
        ),
    )


def _weight(result: FitResult, error: SystematicError) -> float:
    """Return the largest shift divided by the standard error, or by the value if there is none."""
    return max(
        (
            abs(error.shifts[path]) / (one.standard_error or abs(float(one.value)) or 1.0)
            for path, one in result.free.items()
        ),
        default=0.0,
    )


def with_suspects(
    result: FitResult, runs: Run | Sequence[Run], *, parameters_alone: bool = False
) -> FitResult:
    """Return the result with its suspects, as from `giajax.suspects`, and an updated verdict.

    Unless `parameters_alone` is set, systematic errors are added as well.
    """
    found = suspects(result, runs, parameters_alone=parameters_alone)
    asked = dataclasses.replace(result, suspects=found.rows, verdict=found.judge(result))
    return asked if parameters_alone else with_systematic_errors(asked, runs)


def with_systematic_errors(
    result: FitResult, runs: Run | Sequence[Run], uncertainty: Mapping[str, Any] | None = None
) -> FitResult:
    """Return the result with its systematic errors, and a condition for each influential value.

    The errors are computed by `giajax.systematic_errors`. Uncertainties given here are stored in
    `config`.
    """
    errors = systematic_errors(result, runs, uncertainty)
    # Conditions are recognised by their beginning, because an earlier version ended them
    # differently.
    before = tuple(f"{error.path}{_DECIDES}" for error in result.systematic)
    conditions = [each for each in result.conditions if not each.startswith(before)]
    stated = {} if uncertainty is None else {"uncertainty": dict(uncertainty)}
    return dataclasses.replace(
        result,
        systematic=errors,
        conditions=(*conditions, *deciding_conditions(errors)),
        config={**result.config, **stated},
    )
