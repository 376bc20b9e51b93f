"""Which parameters of a model are free, within which bounds, and which follow from others."""

import dataclasses
import graphlib
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Self, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..models import AbstractModel, capabilities
from ..recordings import FitSettings, Run
from ..runtime.arrays import Array, Bool
from ..runtime.text import InputError
from ..schema import Expression, Prior
from ..schema.parameters import (
    Parameter,
    check_count,
    check_within_bounds,
    declared,
    default_free,
    elements,
    find,
    get,
    replace,
    switched_on,
)
from ._coordinates import members

# Parameters that follow from others, by an expression over paths.

Module = TypeVar("Module", bound=eqx.Module)

_FUNCTIONS = {"sqrt": jnp.sqrt, "exp": jnp.exp, "log": jnp.log}


@dataclasses.dataclass(frozen=True)
class Tie:
    """A parameter that follows from others.

    Attributes:
        path: of the parameter, which may be an array.
        expression: what it follows from.
        elements: paths of its elements that follow; those of an array that the expression itself
            names do not, as in `links.mass = links.mass[0]`.
        lower, upper: its bounds.
    """

    path: str
    expression: Expression
    elements: tuple[str, ...]
    lower: float
    upper: float

    @classmethod
    def of(cls, model: eqx.Module, path: str, text: str) -> Self:
        """The tie of a path to what an expression says.

        Raises:
            InputError: no expression, or an unknown path in it.
        """
        try:
            expression = Expression.parse(text)
        except InputError as error:
            raise InputError(f"the tie of '{path}' is not right, because {error}") from None
        named = {element.path for name in expression.paths for element in elements(model, name)}
        declaration = find(model, path).declaration
        parts = [element.path for element in elements(model, path)]
        apart = path not in expression.paths
        return cls(
            path=path,
            expression=expression,
            elements=tuple(part for part in parts if part not in named or not apart),
            lower=declaration.lower,
            upper=declaration.upper,
        )

    def values(self, model: eqx.Module) -> Array:
        """What the expression comes to, of the shape of the parameter; differentiable."""
        value = jnp.asarray(self.expression.value(lambda path: get(model, path), _FUNCTIONS))
        old = get(model, self.path)
        if value.ndim and value.shape != old.shape:
            raise InputError(
                f"the tie of '{self.path}', which has {old.size} element{'s' * (old.size != 1)}, "
                f"comes to {value.size} values: tie it to one value, or to one for each"
            )
        if not old.ndim:
            return value
        kept = np.asarray([part.path not in self.elements for part in elements(model, self.path)])
        return jnp.where(kept, old, value)


def resolved_ties(model: eqx.Module, texts: Mapping[str, str]) -> tuple[Tie, ...]:
    """The ties of a model, in an order in which each follows from what is known before it.

    What the model leaves out must be switched on.

    Raises:
        InputError: no expression, an unknown path, a parameter that is tied twice or follows from
            itself, or another number of values than elements.
    """
    ties = [Tie.of(model, path, text) for path, text in texts.items()]
    owners: dict[str, int] = {}
    for index, tie in enumerate(ties):
        for element in tie.elements:
            if element in owners:
                other = ties[owners[element]].path
                raise InputError(
                    f"'{element}' is tied by '{other}' and by '{tie.path}': remove one"
                )
            owners[element] = index
    needs = {
        index: {
            owners[element.path]
            for name in tie.expression.paths
            for element in elements(model, name)
            if element.path in owners
        }
        for index, tie in enumerate(ties)
    }
    try:
        order = list(graphlib.TopologicalSorter(needs).static_order())
    except graphlib.CycleError as error:
        names = " and ".join(sorted({f"'{ties[index].path}'" for index in error.args[1]}))
        raise InputError(
            f"the ties of {names} follow from themselves: tie them to other parameters"
        ) from None
    return tuple(ties[index] for index in order)


def tied(model: Module, ties: Sequence[Tie]) -> Module:
    """The model in which each tied parameter follows from the others; differentiable."""
    for tie in ties:
        model = replace(model, {tie.path: tie.values(model)})
    return model


def check_tied(model: eqx.Module, ties: Sequence[Tie]) -> None:
    """Refuse tied values beyond the bounds of their parameters."""
    for tie in ties:
        for path in tie.elements:
            element = find(model, path)
            check_within_bounds(element, float(element.value(model)), free=False)


def within_bounds(model: eqx.Module, ties: Sequence[Tie]) -> Bool[Array, ""]:
    """Whether all tied parameters are within their bounds."""
    inside = [
        jnp.all((tie.lower <= value) & (value <= tie.upper))
        for tie in ties
        for value in [get(model, tie.path)]
    ]
    return jnp.all(jnp.stack(inside)) if inside else jnp.asarray(True)


# Where another fit ended, as the start of this one.


@dataclasses.dataclass(frozen=True)
class WarmStart:
    """What a fit takes from where another one ended.

    Attributes:
        model: the kind of model that was fitted.
        values: of the parameters that were free or fixed there, by path, SI.
        own: of the parameters of single runs, by the run's name and their path, SI.
    """

    model: str
    values: Mapping[str, Any]
    own: Mapping[str, Mapping[str, float]] = dataclasses.field(default_factory=dict)

    def values_for(self, model: AbstractModel) -> Mapping[str, Any]:
        """The values, where this model has all of their parameters.

        Raises:
            InputError: it has no model of that kind, or lacks one.
        """
        if not set(self.model.split("+")) <= set(model.kind.split("+")):
            raise InputError(
                f"the fit to begin from is of the {self.model} model and the runs are of the "
                f"{model.kind} model: give a fit of the same kind"
            )
        try:
            whole = switched_on(model, self.values)
            for path, value in self.values.items():
                check_count(whole, path, value)
        except InputError as error:
            raise InputError(f"the fit to begin from has other parameters: {error}") from None
        return self.values


def inside_bounds(
    model: AbstractModel,
    paths: Mapping[str, Any],
    free: Mapping[str, Parameter],
) -> dict[str, float]:
    """Values strictly between their bounds, for those parameters that have to start there."""
    values = {}
    for element in (element for path in paths for element in elements(model, path)):
        if element.path in free:
            low, high = element.declaration.lower, element.declaration.upper
            values[element.path] = between(float(element.value(model)), low, high)
    return values


def between(value: float, lower: float, upper: float, *, margin: float = 0.0) -> float:
    """The nearest value strictly between two bounds, which may be infinite.

    By a margin at least, which is less than half of the way between two.
    """
    if np.isfinite(lower) and np.isfinite(upper):
        margin = max(margin, 1e-9 * (upper - lower))
        return float(np.clip(value, lower + margin, upper - margin))
    # Next to 0 are numbers that a logarithm does not take.
    margin = max(margin, float(np.finfo(float).tiny))
    if np.isfinite(lower):
        return max(value, lower + margin, float(np.nextafter(lower, np.inf)))
    return min(value, upper - margin, float(np.nextafter(upper, -np.inf)))


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
    settings: FitSettings,
    groups: Mapping[str, Sequence[Sequence[str]]],
    reached: Mapping[str, Any],
) -> Free:
    """What is free in a fit, with the values that another one `reached`; nothing is evaluated.

    Raises:
        InputError: an unknown path, two that contradict each other, or a value outside its bounds.
    """
    free, start, fix, ties = settings.free, settings.start, settings.fix, settings.ties
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
    parameters |= _bounded(model, parameters, settings.bounds)
    known = _element_priors(model, runs, parameters, settings.known)
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
        for path in capabilities.free_inputs(model, run):
            size = get(model.prepare(run), path).size
            paths |= {path, *(f"{path}[{index}]" for index in range(size))}
    return paths
