"""Where the fits of several starts begin."""

from collections.abc import Mapping

import numpy as np
from scipy.special import ndtri

from .._sobol import sobol_points
from ..fitting import Setup, between, prior_of
from ..parameters import Parameter


def start_values(setup: Setup, spread: float, seed: int, count: int) -> list[dict[str, float]]:
    """Start values by path: those of the setup, and others that fill the room around them.

    The others are a scrambled Sobol sequence, of which more starts have the same first ones. Of a
    parameter with a prior they are its quantiles, between two bounds of the fit they are evenly
    spread (their logarithms, if both are positive), and otherwise they are near those of the setup.

    Arguments:
        setup: what to fit to what.
        spread: relative distance from the values of the setup, where nothing else is stated.
        seed: of the sequence.
        count: how many starts.

    Returns:
        For each start a value for each free parameter, between its bounds.
    """
    first = {each.path: float(each.value(setup.model)) for each in setup.parameters}
    if count < 2 or not first:
        return [dict(first) for _ in range(count)]
    shares = sobol_points(count - 1, len(first), seed)
    others = [
        {
            each.path: _value(setup, each, spread, float(share))
            for each, share in zip(setup.parameters, row, strict=True)
        }
        for row in shares
    ]
    return [first, *others]


def _value(setup: Setup, parameter: Parameter, spread: float, share: float) -> float:
    """The value of a parameter that is above a share of all of its start values."""
    declaration, value = parameter.declaration, float(parameter.value(setup.model))
    lower, upper = declaration.lower, declaration.upper
    path = parameter.path
    prior = prior_of(setup.priors, path)
    stated = setup.config.get("bounds", {})
    if prior is not None:
        # Beyond three deviations there is no start.
        quantile = prior.centre + prior.spread * float(ndtri(np.clip(share, 1e-3, 1 - 1e-3)))
        value = float(np.exp(quantile)) if prior.logarithmic else quantile
    elif (path in stated or path.partition("[")[0] in stated) and np.isfinite(upper - lower):
        # Over decades, where each of them is as likely.
        value = lower * (upper / lower) ** share if lower > 0 else lower + share * (upper - lower)
    elif lower >= 0:
        value *= (1 + spread) ** (2 * share - 1)
    else:
        size = abs(value) or abs(declaration.default) or 1.0
        value += (2 * share - 1) * spread * size
    return between(value, lower, upper)


def inside_bounds(setup: Setup, values: Mapping[str, float]) -> dict[str, float]:
    """Values strictly between the bounds, at which a fit may start."""
    return {
        parameter.path: between(
            values[parameter.path], parameter.declaration.lower, parameter.declaration.upper
        )
        for parameter in setup.parameters
    }
