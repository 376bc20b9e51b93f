"""What may be asked of a fitted model: each parameter that it holds or leaves out."""

import contextlib
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from ..fitting import Direction, FitResult, Response, SuspectKind, in_full, resolved_ties
from ..models import AbstractModel
from ..recordings import Run
from ..runtime.text import InputError
from ..schema.parameters import Parameter, declared, left_out
from ._score import responses_of, white_noise

# A test of a part that is left out begins where it ought to do nothing. Added mass of 0 is none in
# still air; but in a recorded wind that changes, what is on has the pressure of the air that speeds
# up as well, which acts on whatever displaces it.
_REASON = (
    "the neutral value of the parameter also changes the predictions for these runs, so the "
    "parameter cannot be tested: free it in a fit"
)

_NOTICED = 0.05  # of the noise of a channel: what the steps of an integrator change is far less


def is_disturbed(result: FitResult, runs: Sequence[Run], at: Sequence[Response]) -> bool:
    """Whether residuals with all parts on, at neutral values, are not those that the fit had."""
    for run, record, response in zip(runs, result.runs, at, strict=True):
        rest = response.predicted - response.observed
        for place, name in enumerate(response.channels):
            known = record.channels.get(name)
            if known is not None and known.rmse is not None:
                root = run.channels[name].from_si(float(np.sqrt(np.nanmean(rest[:, place] ** 2))))
                if abs(root - known.rmse) > _NOTICED * known.noise:
                    return True
    return False


def not_neutral(result: FitResult, runs: Sequence[Run]) -> dict[str, str]:
    """What of a disturbed model cannot be tested at its neutral value, with the reason, by path.

    Found by halving, because each set of parts is a program of its own.
    """
    at = responses_of(result, runs, result.model)
    noise = white_noise(result, runs, at)
    parts = []
    for path, absent in left_out(result.model).items():
        with contextlib.suppress(InputError):  # It is not asked for.
            if not absent.declaration.has_states:
                absent.set(result.model, absent.declaration.neutral)
                parts.append(path)

    def changes(paths: Sequence[str]) -> bool:
        model = result.model
        for path in paths:
            absent = left_out(model)[path]
            model = absent.set(model, absent.declaration.neutral)
        return any(
            np.nanmax(np.abs(two.predicted - one.predicted) / [sigma[n] for n in one.channels])
            > _NOTICED
            for one, two, sigma in zip(at, responses_of(result, runs, model), noise, strict=True)
        )

    def within(paths: Sequence[str]) -> list[str]:
        """Those of some paths of which at least one ought to change something."""
        if len(paths) < 2:
            # If none does by itself, it is the integrator's steps that do.
            return [path for path in paths if changes([path])]
        first, second = paths[: len(paths) // 2], paths[len(paths) // 2 :]
        in_first = changes(first)
        in_second = changes(second) if in_first else True
        return (within(first) if in_first else []) + (within(second) if in_second else [])

    return dict.fromkeys(within(parts), _REASON)


@dataclasses.dataclass(frozen=True)
class Candidate:
    """One direction of the parameters that may be asked for: a parameter, or an element of it.

    A factor, of value 1, is of an array whose elements change in proportion.

    Attributes:
        unit: SI unit of the amount.
        size: typical size of the value.
        direction: what a unit of the amount changes.
        group: path of the parameter whose elements are asked for together; "" for none.
    """

    path: str
    kind: SuspectKind
    unit: str
    value: float
    lower: float
    upper: float
    size: float
    direction: Direction
    group: str = ""


@dataclasses.dataclass(frozen=True)
class Inquiry:
    """A model with all parts on that it leaves out, and what may be asked of it.

    Attributes:
        free: directions of the parameters that were fitted, in their order.
        candidates: all others, apart from what follows from others.
        impossible: what cannot be switched on in this model, with the reason, by path.
        following: paths of the elements that follow from others.
    """

    model: AbstractModel
    free: tuple[Direction, ...]
    candidates: tuple[Candidate, ...]
    impossible: dict[str, str]
    following: frozenset[str]


def inquiry(
    model: AbstractModel,
    free: Sequence[str],
    each: Sequence[str] = (),
    ties: Mapping[str, str] | None = None,
    without: Mapping[str, str] | None = None,
    *,
    beside: Sequence[str] = (),
) -> Inquiry:
    """The fitted model with everything on, and the directions of its parameters.

    Arguments:
        model: the fitted model.
        free: paths of the parameters that were fitted.
        each: paths of arrays whose elements are asked for one by one, and together, in place of
            all in proportion. An InputError where one is not an array of this model.
        ties: expressions by the paths of what follows from them.
        without: paths of what is not to be switched on, and why.
        beside: paths of arrays whose elements are asked for one by one, beside all in proportion.
    """
    impossible = dict(without or {})
    for path, absent in left_out(model).items():
        if absent.declaration.has_states or path in impossible:
            continue
        try:
            model = absent.set(model, absent.declaration.neutral)
        except InputError as error:
            impossible[path] = str(error)
    known = declared(model)
    for path in each:
        if path not in known or not (known[path].declaration.per or known[path].declaration.shape):
            raise InputError(
                f"'{path}' has no elements that can be tested one by one: name a parameter with "
                "one value per link, joint or axis"
            )
    for path in {*each, *beside}.intersection(known):
        # One number for all joints becomes one for each.
        model = in_full(model, known[path])
    known = declared(model)
    tied = resolved_ties(model, ties or {})
    following = frozenset(path for tie in tied for path in tie.elements)
    return Inquiry(
        model=model,
        free=tuple(_free_direction(model, known, path) for path in free),
        candidates=tuple(
            candidate
            for parameter in known.values()
            for candidate in _candidates(model, parameter, following.union(free), each, beside)
        ),
        impossible=impossible,
        following=following,
    )


def _free_direction(model: AbstractModel, known: dict[str, Parameter], path: str) -> Direction:
    name, _, index = path.partition("[")
    if name not in known:
        raise InputError(
            f"the fitted parameter '{path}' is not a parameter of the model: give a result whose "
            "free parameters belong to its model"
        )
    step = np.zeros(np.shape(known[name].value(model)))
    step[int(index[:-1]) if index else ...] = 1.0
    return Direction(name, step)


def _candidates(
    model: AbstractModel,
    parameter: Parameter,
    moved: frozenset[str],
    each: Sequence[str],
    beside: Sequence[str],
) -> list[Candidate]:
    """The directions of one parameter that is held, or of what is held of it."""
    path, about = parameter.path, parameter.declaration
    value = np.asarray(parameter.value(model), dtype=float)
    held = np.asarray([f"{path}[{i}]" not in moved for i in range(value.size)])
    if path in moved or not np.any(held):
        return []

    def made(name: str, number: float, step: np.ndarray, group: str = "") -> Candidate:
        size = max(abs(number), abs(about.default)) or 1.0
        bounds = about.lower, about.upper
        return Candidate(
            name, "parameter", about.unit, number, *bounds, size, Direction(path, step), group
        )

    if value.ndim == 0:
        return [made(path, float(value), np.asarray(1.0))]
    whole = bool(about.shape) or path in each or (np.sum(held) == 1 and value.size > 1)
    single = [
        made(f"{path}[{i}]", float(value[i]), np.eye(value.size)[i], group=path if whole else "")
        for i in np.flatnonzero(held)
        if whole or path in beside
    ]
    if whole:
        return single
    numbers = value[held]
    if np.all(numbers == numbers[0]):
        return [made(path, float(numbers[0]), held.astype(float)), *single]
    along = Direction(path, np.where(held, value, 0.0))
    # Values that have a sign keep it.
    lower = 0.0 if about.lower >= 0 else -np.inf
    return [Candidate(path, "factor", "", 1.0, lower, np.inf, 1.0, along), *single]
