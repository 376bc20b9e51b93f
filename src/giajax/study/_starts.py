"""Where the fits of several starts begin."""

from collections.abc import Mapping

import numpy as np

from ..fitting import Setup, between


def start_values(
    setup: Setup, spread: float, random: np.random.Generator | None
) -> dict[str, float]:
    """Start values by path: those of the setup, or near them.

    Arguments:
        setup: what to fit to what.
        spread: relative distance from the values of the setup.
        random: chooses the values; None for those of the setup.

    Returns:
        A value for each free parameter, between its bounds.
    """
    values = {}
    for parameter in setup.parameters:
        declaration, value = parameter.declaration, float(parameter.value(setup.model))
        lower, upper = declaration.lower, declaration.upper
        if random is not None:
            if lower >= 0:
                value *= (1 + spread) ** random.uniform(-1, 1)
            else:
                size = abs(value) or abs(declaration.default) or 1.0
                value += random.uniform(-1, 1) * spread * size
            value = between(value, lower, upper)
        values[parameter.path] = value
    return values


def inside_bounds(setup: Setup, values: Mapping[str, float]) -> dict[str, float]:
    """Values strictly between the bounds, at which a fit may start."""
    return {
        parameter.path: between(
            values[parameter.path], parameter.declaration.lower, parameter.declaration.upper
        )
        for parameter in setup.parameters
    }
