"""Candidates for score tests: the fixed and omitted parameters of a fitted model."""

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

# The test of an omitted part starts at the neutral value of its parameter, at which the part should
# have no effect. For example, an added mass of 0 has no effect in still air. In a recorded wind
# that changes with time, however, switching on the added mass also switches on the pressure of the
# accelerating air, which acts on every body that displaces air.
_REASON = (
    "including the parameter changes the predictions for these runs even at its neutral value, so "
    "the parameter cannot be tested: free it in a fit"
)

# Fraction of the noise of a channel. Changes of the integrator's steps have a much smaller effect.
_NOTICED = 0.05


def is_disturbed(result: FitResult, runs: Sequence[Run], at: Sequence[Response]) -> bool:
    """Return whether switching on all parts at neutral values changes the residuals of the fit."""
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
    """Return the parts whose neutral value changes the predictions, with the reason, by path.

    The parts are found by bisection, because each set of parts requires the compilation of a
    program.
    """
    at = responses_of(result, runs, result.model)
    noise = white_noise(result, runs, at)
    parts = []
    for path, absent in left_out(result.model).items():
        with contextlib.suppress(InputError):  # A part that cannot be set is not tested.
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
        """Return the paths that change the predictions; at least one of the given paths should."""
        if len(paths) < 2:
            # If no part has an effect by itself, the difference is due to the integrator's steps.
            return [path for path in paths if changes([path])]
        first, second = paths[: len(paths) // 2], paths[len(paths) // 2 :]
        in_first = changes(first)
        in_second = changes(second) if in_first else True
        return (within(first) if in_first else []) + (within(second) if in_second else [])

    return dict.fromkeys(within(parts), _REASON)


@dataclasses.dataclass(frozen=True)
class Candidate:
    """Direction in parameter space that can be tested: a parameter, or an element of a parameter.

    A candidate of the kind "factor" has value 1 and scales all elements of an array in proportion.

    Attributes:
        path: path of the parameter, with an index for an element.
        kind: kind of the suspect.
        unit: SI unit of the amount.
        value: current value, SI.
        lower, upper: bounds of the value, SI.
        size: typical size of the value.
        direction: change of the parameter per unit of the amount.
        group: path of the parameter whose elements are tested together; "" for none.
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
    """Model with all omitted parts switched on, and the candidates that can be tested.

    Attributes:
        model: model with all parts.
        free: directions of the fitted parameters, in their order.
        candidates: all other directions, except parameters that follow from others.
        impossible: parts that cannot be switched on in this model, with the reason, by path.
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
    """Switch on all omitted parts of a fitted model and list the directions of its parameters.

    Arguments:
        model: the fitted model.
        free: paths of the fitted parameters.
        each: paths of arrays whose elements are tested one by one and jointly, instead of all in
            proportion. An `InputError` is raised for a path that is not an array of this model.
        ties: expressions of the tied parameters, by path.
        without: paths of parts that are not to be switched on, with the reason.
        beside: paths of arrays whose elements are tested one by one in addition to all in
            proportion.
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
        # Replace one value for all joints by one value for each joint.
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
    """Return the candidates for one parameter, or for its elements that are fixed."""
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
    # A quantity that cannot be negative must not change its sign.
    lower = 0.0 if about.lower >= 0 else -np.inf
    return [Candidate(path, "factor", "", 1.0, lower, np.inf, 1.0, along), *single]
