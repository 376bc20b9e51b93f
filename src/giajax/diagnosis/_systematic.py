"""Systematic errors: what a held number that is a little wrong does to the fitted ones."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..fitting import Direction, FitResult, Response, SystematicError, influence, responses
from ..parameters import elements, get, switched_on
from ..runs import Run
from ._candidates import Candidate, Inquiry, inquiry
from ._weights import Weighing, fitted_noise, matching_runs, own_values

FRACTION = 0.01
"""Of a held number, where its uncertainty is not stated."""

_RANK = 1e-9


@dataclasses.dataclass(frozen=True)
class _Doubt:
    """One held number, or several that move together, and by how much it may be wrong."""

    path: str
    unit: str
    value: float | list[float]
    uncertainty: float
    stated: bool
    direction: Direction


def systematic_errors(
    result: FitResult,
    runs: Run | Sequence[Run],
    uncertainty: Mapping[str, npt.ArrayLike] | None = None,
) -> tuple[SystematicError, ...]:
    """What the held numbers of a fit do to the fitted ones, to first order.

    Where residuals are stationary in the fitted parameters theta, a change of a constant c moves
    them by d(theta)/dc = -(J^T J)^-1 J^T z, with the columns J of theta and z of c (the implicit
    function theorem with the Gauss-Newton form of the Hessian).

    Arguments:
        result: of `giajax.fit` or `giajax.load_result`.
        runs: the runs that were fitted, in their order.
        uncertainty: standard deviations of held numbers, SI, by path; by default those that the
            fit was given. One number for a whole array moves its elements together; those of a
            vector, such as the wind, are independent, and so are `links.mass[0]`,
            `links.mass[1]`.

    Returns:
        Those that were stated, then what 1 % of each other held number that is not zero does.

    Raises:
        InputError: other runs, an unknown path, one that was fitted, or an uncertainty that is
            not positive.
    """
    several = matching_runs(result, runs)
    if uncertainty is None:
        uncertainty = result.config.get("uncertainty") or {}
    asked = inquiry(result.model, list(result.free))
    stated = _stated(result, asked, uncertainty)
    known = {doubt.path.partition("[")[0] for doubt in stated}
    doubts = [*stated, *(_one_percent(one) for one in asked.candidates if _counts(one, known))]
    # Beside the columns of all candidates, so that the program is the one that tests them.
    directions = [*asked.free, *(one.direction for one in asked.candidates)]
    places = {id(direction): place for place, direction in enumerate(directions)}
    for doubt in doubts:
        if id(doubt.direction) not in places:
            places[id(doubt.direction)] = len(directions)
            directions.append(doubt.direction)
    at = responses(asked.model, several, directions, own_values(result))
    columns = [places[id(doubt.direction)] for doubt in doubts]
    slopes = _slopes(result, several, at, len(asked.free), columns)
    return tuple(
        _error(result, doubt, slopes[:, index]) for index, doubt in enumerate(doubts)
    )


def deciding_conditions(errors: Sequence[SystematicError]) -> list[str]:
    """A sentence on each held number that decides: 1 % of it is more than a standard error."""
    sentences = []
    for error in errors:
        if error.decides:
            by = f"{error.uncertainty:.3g}{f' {error.unit}' if error.unit else ''}"
            change = by if error.stated else "1 %"
            sentences.append(
                f"{error.path}: is held and decides, because a change of it by {change} moves "
                f"{', '.join(error.decides)} by more than a standard error"
            )
    return sentences


def together(errors: Sequence[SystematicError]) -> dict[str, float]:
    """The systematic error of each fitted parameter: the stated ones, in quadrature."""
    squares: dict[str, float] = {}
    for error in errors:
        if error.stated:
            for path, shift in error.shifts.items():
                squares[path] = squares.get(path, 0.0) + shift**2
    return {path: float(np.sqrt(square)) for path, square in squares.items()}


def _error(result: FitResult, doubt: _Doubt, slopes: np.ndarray) -> SystematicError:
    shifts = {
        path: float(slope) * doubt.uncertainty
        for path, slope in zip(result.free, slopes, strict=True)
    }
    errors = {path: estimate.standard_error for path, estimate in result.free.items()}
    decides = tuple(
        path for path, shift in shifts.items() if abs(shift) > (errors[path] or np.inf)
    )
    return SystematicError(
        path=doubt.path,
        unit=doubt.unit,
        value=doubt.value,
        uncertainty=doubt.uncertainty,
        stated=doubt.stated,
        shifts=shifts,
        decides=decides,
    )


def _counts(one: Candidate, known: set[str]) -> bool:
    return one.value != 0 and one.direction.path not in known


def _one_percent(one: Candidate) -> _Doubt:
    size = FRACTION * abs(one.value)
    return _Doubt(one.path, one.unit, one.value, size, False, one.direction)


def _stated(
    result: FitResult, asked: Inquiry, uncertainty: Mapping[str, npt.ArrayLike]
) -> list[_Doubt]:
    doubts = []
    free = set(result.free)
    for path, deviation in uncertainty.items():
        model = switched_on(asked.model, [path])
        parts = elements(model, path)
        about = parts[0].declaration
        numbers = np.asarray(deviation, dtype=float)
        if numbers.size not in (1, len(parts)):
            raise InputError(
                f"the uncertainty of {path} has {numbers.size} values, and it has {len(parts)}: "
                "give one, or one for each"
            )
        if not np.all(np.isfinite(numbers)) or not np.all(numbers > 0):
            raise InputError(f"the uncertainty of {path} is not positive: give a positive number")
        fitted = [part.path for part in parts if part.path in free]
        if fitted:
            raise InputError(
                f"{fitted[0]} is fitted, and its uncertainty is what the fit finds: hold it, or "
                "leave its uncertainty out"
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
                doubts.append(_Doubt(part.path, about.unit, value, size, True, Direction(name, step)))
        if not alone:
            size = float(np.max(each))
            same = np.all(whole == whole[0])
            shown = float(whole[0]) if same else [float(number) for number in whole]
            step = each / size
            doubts.append(_Doubt(name, about.unit, shown, size, True, Direction(name, step)))
    return [_shared(doubt, asked) for doubt in doubts]


def _shared(doubt: _Doubt, asked: Inquiry) -> _Doubt:
    """With the direction of a candidate, where one is the same."""
    for one in asked.candidates:
        same = one.direction.path == doubt.direction.path
        if same and np.array_equal(one.direction.step, doubt.direction.step):
            return dataclasses.replace(doubt, direction=one.direction)
    return doubt


def _slopes(
    result: FitResult,
    runs: Sequence[Run],
    at: Sequence[Response],
    fitted: int,
    columns: Sequence[int],
) -> Any:
    """d(fitted)/d(held), shape (fitted, held)."""
    loss = result.config.get("loss", "linear")
    noise = fitted_noise(result, runs)
    weights = []
    for response, deviations in zip(at, noise, strict=True):
        sigma = np.asarray([deviations[name] for name in response.channels])
        rest = np.nan_to_num((response.predicted - response.observed) / sigma)
        # The second derivative of the loss: a residual beyond its corner does not pull harder.
        weights.append(np.sqrt(np.maximum(influence(loss, rest)[1], 0.0)))
    factors = Weighing.of(at, noise, weights).factors
    rows = []
    for response, factor in zip(at, factors, strict=True):
        measured = ~np.isnan(response.observed)
        each = factor[measured][:, None]
        own = response.own[measured] * each
        cells = response.columns[measured] * each
        if own.shape[1]:
            cells = cells - own @ np.linalg.lstsq(own, cells, rcond=_RANK)[0]
        rows.append(cells)
    whole = np.concatenate(rows)
    jacobian, held = whole[:, :fitted], whole[:, list(columns)]
    norms = np.linalg.norm(jacobian, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    return -np.linalg.lstsq(jacobian / norms, held, rcond=_RANK)[0] / norms[:, None]
