"""Systematic errors: what a held number that is a little wrong does to the fitted ones."""

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
"""Of a held number, where its uncertainty is not stated."""


@dataclasses.dataclass(frozen=True)
class Doubt:
    """One held number, or several that move together, and by how much it may be wrong."""

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
    """Refuse uncertainties that `systematic_errors` would refuse, before anything is fitted."""
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
                f"{len(parts)}: give one value, or one for each element"
            )
        if not np.all(np.isfinite(numbers)) or not np.all(numbers > 0):
            raise InputError(f"the uncertainty of {path} is not positive: give a positive number")
        fitted = [part.path for part in parts if part.path in free]
        if fitted:
            raise InputError(
                f"{fitted[0]} is fitted, so the fit estimates its uncertainty: fix it, or omit "
                "its uncertainty"
            )
        if asked.following.issuperset(part.path for part in parts):
            raise InputError(
                f"{path} is tied to other parameters: state the uncertainty of those parameters"
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
    """With the direction of a candidate, where one is the same."""
    for one in asked.candidates:
        same = one.direction.path == doubt.direction.path
        if same and np.array_equal(one.direction.step, doubt.direction.step):
            return dataclasses.replace(doubt, direction=one.direction)
    return doubt


_NOTHING = 1e-6  # standard errors; what is moved by less is not moved


def systematic_errors(
    result: FitResult,
    runs: Run | Sequence[Run],
    uncertainty: Mapping[str, npt.ArrayLike] | None = None,
) -> tuple[SystematicError, ...]:
    """What the held numbers of a fit do to the fitted ones, to first order.

    Where residuals are stationary in the fitted parameters theta, a change of a constant c moves
    them by d(theta)/dc = -(J^T J)^-1 J^T z, with the columns J of theta and z of c (the implicit
    function theorem with the Gauss-Newton form of the Hessian), all whitened by the noise that the
    fit used.

    Arguments:
        result, runs: of `giajax.fit` or `giajax.load_result`, and what was fitted, in their order.
        uncertainty: standard deviations of held numbers, SI, by path; by default those that the
            fit was given. One number for a whole array moves its elements together; those of a
            vector, such as the wind, are independent, and so are `links.mass[0]`,
            `links.mass[1]`.

    Returns:
        Those that were stated, then what 1 % of each other held number that is not zero does, the
        largest shift in standard errors first; what moves nothing is left out.
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
    # Beside the columns of all candidates, so that the program is the one that tests them.
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
    # The stated ones first, then what decides most; what moves nothing is not worth a row.
    kept.sort(key=lambda each: (not each[0].stated, -each[1]))
    return tuple(error for error, weight in kept if error.stated or weight > _NOTHING)


def deciding_conditions(errors: Sequence[SystematicError]) -> list[str]:
    """A sentence on each held number that decides: 1 % of it is more than a standard error."""
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
    """The paths, of which not more than a few by name."""
    if len(paths) <= _NAMED:
        return ", ".join(paths)
    return f"{', '.join(paths[: _NAMED - 1])} and {len(paths) - _NAMED + 1} others"


def together(errors: Sequence[SystematicError]) -> dict[str, float]:
    """The systematic error of each fitted parameter: the stated ones, in quadrature."""
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
    """The largest shift, in standard errors; of a parameter without one, relative to it."""
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
    """The result with its suspects, as of `giajax.suspects`, and its verdict with them.

    Where not parameters alone are asked, with its systematic errors, too.
    """
    found = suspects(result, runs, parameters_alone=parameters_alone)
    asked = dataclasses.replace(result, suspects=found.rows, verdict=found.judge(result))
    return asked if parameters_alone else with_systematic_errors(asked, runs)


def with_systematic_errors(
    result: FitResult, runs: Run | Sequence[Run], uncertainty: Mapping[str, Any] | None = None
) -> FitResult:
    """The result with its systematic errors, and a condition for each held number that decides.

    As of `giajax.systematic_errors`; an uncertainty that is stated here is kept in `config`.
    """
    errors = systematic_errors(result, runs, uncertainty)
    # By how they begin: an earlier version ended them otherwise.
    before = tuple(f"{error.path}{_DECIDES}" for error in result.systematic)
    conditions = [each for each in result.conditions if not each.startswith(before)]
    stated = {} if uncertainty is None else {"uncertainty": dict(uncertainty)}
    return dataclasses.replace(
        result,
        systematic=errors,
        conditions=(*conditions, *deciding_conditions(errors)),
        config={**result.config, **stated},
    )
