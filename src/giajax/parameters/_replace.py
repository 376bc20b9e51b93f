"""A model with other values of its parameters."""

from collections.abc import Iterable, Mapping
from typing import Any

import jax
import numpy as np

from .._errors import InputError
from ._find import elements, find
from ._walk import Module, Parameter, checked, left_out


def replace(model: Module, values: Mapping[str, Any]) -> Module:
    """The model with the parameters at some paths replaced; the model itself is unchanged.

    An optional parameter that the model leaves out is switched on.

    Example:
        >>> import giajax
        >>> arm = giajax.takeichi_20m()
        >>> heavier = giajax.replace(arm, {"links.mass": 0.06, "air.drag_coefficient": 1.0})
    """
    counted = False
    for path, value in values.items():
        absent = left_out(model)
        parameter = absent[path] if path in absent else find(model, path)
        counted |= parameter.any_number
        model = parameter.set(model, value)
    # Numbers of elements must suit each other once all of them are replaced.
    return checked(model) if counted else model


def switched_on(model: Module, paths: Iterable[str]) -> Module:
    """The model in which none of the paths is left out; those that were have their defaults."""
    for path in paths:
        name = path.partition("[")[0]
        absent = left_out(model)
        if name in absent:
            model = absent[name].set(model, absent[name].declaration.default)
    return model


def check_count(model: Module, path: str, value: Any) -> None:
    """Refuse values for a parameter that are neither one nor one for each of its elements.

    Raises:
        InputError: naming the parameter and both numbers.
    """
    size, count = np.size(value), len(elements(model, path))
    if size not in (1, count) and not find(model, path).any_number:
        raise InputError(
            f"{path} is set to {size} values and has {count} element{'s' * (count != 1)}: give one "
            "value, or one for each"
        )


def check_within_bounds(parameter: Parameter, value: float, *, free: bool) -> None:
    """Refuse a value outside the bounds; a free parameter must lie strictly inside.

    Raises:
        InputError: naming the parameter, the value and its bounds.
    """
    declaration = parameter.declaration
    lower, upper = declaration.lower, declaration.upper
    inside = lower < value < upper if free else lower <= value <= upper
    if np.isfinite(value) and inside:
        return
    unit = f" {declaration.unit}" if declaration.unit else ""
    between = "strictly between" if free else "between"
    raise InputError(
        f"{parameter.path} = {value:g}{unit} is outside its bounds: "
        f"choose a value {between} {lower:g} and {upper:g}{unit}"
    )


def is_concrete(value: Any) -> bool:
    """Whether a value is known now, not while a program is being traced."""
    return not any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(value))
