"""What is known of the parameters before the experiment, and draws of it."""

from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..fitting import FitResult
from ..parameters import Parameter

# A normal deviate beyond this is drawn at it: a design need not bear what hardly happens.
_FURTHEST = 2.0


def draws(
    parameters: Sequence[Parameter],
    values: Float[np.ndarray, " parameter"],
    deviations: Mapping[str, float],
    correlation: Float[np.ndarray, "parameter parameter"],
    count: int,
) -> Float[np.ndarray, "draw parameter"]:
    """Values of the parameters that may be true, the first of which are the present ones.

    What must be positive is log-normal. The others are points of a Sobol sequence.

    Arguments:
        parameters: each declares its bounds.
        values: present ones, SI.
        deviations: standard deviations by path, SI; others are known.
        correlation: between them.
        count: how many.
    """
    if count < 1:
        raise InputError(f"the number of draws is {count}: give at least 1")
    found = np.tile(values, (count, 1))
    sizes = np.asarray([deviations.get(one.path, 0.0) for one in parameters])
    if count == 1 or not np.any(sizes):
        return found[:1]
    # Slow to import, and only needed here.
    from scipy.stats import norm, qmc

    # The first two points of the sequence are a corner and the middle.
    places = qmc.Sobol(len(parameters), scramble=False).fast_forward(2).random(count - 1)
    roots, turns = np.linalg.eigh(correlation)
    normal = norm.ppf(np.clip(places, 1e-6, 1 - 1e-6)) @ (turns * np.sqrt(np.maximum(roots, 0))).T
    normal = np.clip(normal, -_FURTHEST, _FURTHEST)
    for column, one in enumerate(parameters):
        lower, upper = one.declaration.lower, one.declaration.upper
        if lower >= 0 < values[column]:
            drawn = values[column] * np.exp(normal[:, column] * sizes[column] / values[column])
        else:
            drawn = values[column] + normal[:, column] * sizes[column]
        found[1:, column] = np.clip(drawn, lower, upper)
    return found


def known_before(
    result: FitResult, paths: Sequence[str]
) -> tuple[dict[str, float], Float[np.ndarray, "parameter parameter"]]:
    """Standard errors of a result, SI, by path, and the correlation of some parameters."""
    errors = {
        path: float(error)
        for path in paths
        if path in result.parameters
        and (error := result.parameters[path].standard_error) is not None
        and np.isfinite(error)
    }
    correlation = np.eye(len(paths))
    known = [path for path in result.correlation.parameters if path in errors]
    at = [list(result.correlation.parameters).index(path) for path in known]
    to = [list(paths).index(path) for path in known]
    matrix = np.asarray(result.correlation.matrix, dtype=float)
    if len(known) and np.all(np.isfinite(matrix)):
        correlation[np.ix_(to, to)] = matrix[np.ix_(at, at)]
    return errors, correlation
