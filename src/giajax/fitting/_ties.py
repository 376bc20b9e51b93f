"""Parameters that follow from others, by an expression over paths."""

import dataclasses
import graphlib
from collections.abc import Mapping, Sequence
from typing import Self, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool
from ..parameters import check_within_bounds, elements, find, get, replace
from ..quantities import Expression

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

    Arguments:
        model: whose parameters are tied; those that it leaves out must be switched on.
        texts: expressions by the paths that follow from them.

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
    """Refuse tied values beyond the bounds of their parameters.

    Raises:
        InputError: naming the parameter, the value and its bounds.
    """
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
