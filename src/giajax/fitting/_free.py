"""Which parameters of a model are free, within which bounds, and which follow from others."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ..models import AbstractModel
from ..parameters import (
    Parameter,
    check_count,
    check_within_bounds,
    declared,
    default_free,
    elements,
    get,
    replace,
    switched_on,
)
from ..quantities import Prior
from ..runs import Run
from ._beginning import inside_bounds
from ._layout import members
from ._ties import Tie, check_tied, resolved_ties, tied

Start = Mapping[str, npt.ArrayLike]


class Free(NamedTuple):
    """What a fit may move.

    Attributes:
        model: with starts and fixed values, and with what follows from them.
        parameters: the scalar ones that are free, within the bounds of this fit.
        priors: of free parameters, by the path of an element; of those of single runs as written.
        ties: what follows from others, in their order.
        groups: by path of an element, the runs (by position) that share a value, where not all do.
        begun: paths of the elements that have a start of the caller's.
    """

    model: AbstractModel
    parameters: tuple[Parameter, ...]
    priors: dict[str, Prior]
    ties: tuple[Tie, ...]
    groups: dict[str, tuple[tuple[int, ...], ...]]
    begun: frozenset[str]


def resolve(
    model: AbstractModel,
    runs: Sequence[Run],
    free: Sequence[str] | None,
    start: Start,
    fix: Start,
    *,
    reached: Mapping[str, Any],
    priors: Mapping[str, Prior],
    bounds: Mapping[str, Sequence[float]],
    ties: Mapping[str, str],
    groups: Mapping[str, Sequence[Sequence[str]]],
) -> Free:
    """What is free, from the arguments of `fit`; nothing is evaluated.

    Raises:
        InputError: an unknown path, two of them that contradict each other, or a value outside
            its bounds.
    """
    asked = [*(free or ()), *groups]
    model = switched_on(model, (*reached, *start, *fix, *asked, *ties))
    for path, value in (*start.items(), *fix.items()):
        check_count(model, path, value)
    for path in set(start) & set(fix):
        raise InputError(f"'{path}' has a start and a fixed value: give one of them")
    chosen = [*(default_free(model, start) if free is None else free), *groups]
    fixed = {element.path for path in fix for element in elements(model, path)}
    for values in (start, reached, fix):
        model = replace(model, values)
    order = resolved_ties(model, ties)
    following = {path for tie in order for path in tie.elements}
    for path in (*asked, *fix, *start):
        if following.issuperset(element.path for element in elements(model, path)):
            how = "free" if path in asked else "fixed" if path in fix else "given a start"
            raise InputError(f"'{path}' is tied to others and {how}: leave one of the two out")
    parameters: dict[str, Parameter] = {}
    for path in chosen:
        for element in elements(model, path):
            if element.path in fixed:
                if path in asked:
                    raise InputError(f"'{element.path}' is both free and fixed: give one of them")
            elif element.path not in following:
                parameters[element.path] = element
    parameters |= _bounded(model, parameters, bounds)
    known = _element_priors(model, runs, parameters, priors)
    begun = {element.path for path in (*reached, *start) for element in elements(model, path)}
    # What is known of a parameter is the best place to begin.
    expected = {path: p.value for path, p in known.items() if path in parameters}
    expected = {path: value for path, value in expected.items() if path not in begun}
    model = replace(model, expected)
    for path in fix:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    if reached:
        # A fit may end on a bound, where none can start.
        model = replace(model, inside_bounds(model, reached, parameters))
    for element in parameters.values():
        check_within_bounds(element, float(element.value(model)), free=True)
    for path in start:
        for element in elements(model, path):
            check_within_bounds(element, float(element.value(model)), free=False)
    model = tied(model, order)
    check_tied(model, order)
    return Free(
        model=model,
        parameters=tuple(parameters.values()),
        priors=known,
        ties=order,
        groups={
            element.path: members(path, runs, names)
            for path, names in groups.items()
            for element in _free_elements(model, path, parameters, "groups of runs")
        },
        begun=frozenset({*begun, *expected}),
    )


def _bounded(
    model: AbstractModel, parameters: Mapping[str, Parameter], bounds: Mapping[str, Sequence[float]]
) -> dict[str, Parameter]:
    """The free parameters that have bounds in this fit, with these."""
    bounded: dict[str, Parameter] = {}
    for path, pair in bounds.items():
        if np.shape(pair) != (2,) or not np.all(np.isfinite(pair)) or not pair[0] < pair[1]:
            raise InputError(
                f"the bounds of '{path}' must be two numbers, the lower one first: give them like "
                "0.01,1.0"
            )
        low, high = map(float, pair)
        for element in _free_elements(model, path, parameters, "bounds"):
            declaration = element.declaration
            if low < declaration.lower or high > declaration.upper:
                raise InputError(
                    f"the bounds {low:g} and {high:g} of '{path}' are not within those that it "
                    f"has: stay between {declaration.lower:g} and {declaration.upper:g}"
                )
            narrow = dataclasses.replace(declaration, lower=low, upper=high)
            bounded[element.path] = dataclasses.replace(element, declaration=narrow)
    return bounded


def _element_priors(
    model: AbstractModel,
    runs: Sequence[Run],
    parameters: Mapping[str, Parameter],
    priors: Mapping[str, Prior],
) -> dict[str, Prior]:
    """The priors by element; those of single runs' parameters as they are."""
    known: dict[str, Prior] = {}
    # What is said of one element goes before what is said of all.
    for path, prior in sorted(priors.items(), key=lambda item: "[" in item[0]):
        if path.partition("[")[0] not in declared(model) and path in _own_paths(model, runs):
            known[path] = prior
            continue
        for element in _free_elements(model, path, parameters, "a prior"):
            declaration = element.declaration
            if prior.logarithmic and declaration.lower < 0:
                raise InputError(
                    f"'{path}' may be negative, and its prior has a factor: give a deviation"
                )
            if not declaration.lower < prior.value < declaration.upper:
                raise InputError(
                    f"the prior of '{path}' has the value {prior.value:g}, which is outside its "
                    f"bounds: choose one between {declaration.lower:g} and {declaration.upper:g}"
                )
            known[element.path] = prior
    return known


def _free_elements(
    model: AbstractModel, path: str, parameters: Mapping[str, Parameter], what: str
) -> list[Parameter]:
    """The free ones among the elements of a path, of which there must be one."""
    parts = elements(model, path)
    free = [parameters[part.path] for part in parts if part.path in parameters]
    if not free:
        raise InputError(f"'{path}' has {what} and is not free: free it, or leave {what} out")
    return free


def _own_paths(model: AbstractModel, runs: Sequence[Run]) -> set[str]:
    """Paths of what is free in single runs, with and without an index."""
    paths: set[str] = set()
    for run in runs:
        for path in model.free_inputs(run):
            size = get(model.prepare(run), path).size
            paths |= {path, *(f"{path}[{index}]" for index in range(size))}
    return paths
