"""What is known of the parameters before the experiment, and draws of it."""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from .._errors import InputError
from .._typing import Float
from ..fitting import FitResult
from ..parameters import Parameter

# Standard deviation over the value of what is free, where no fit and no caller says it.
_UNCERTAIN = 0.2

# A normal deviate beyond this is drawn at it: a design need not bear what hardly happens.
_FURTHEST = 2.0

# Logarithmic deviation of what is known badly: twice the value and half of it are as likely.
_MOST = math.log(2)


def draws(
    parameters: Sequence[Parameter],
    values: Float[np.ndarray, " parameter"],
    deviations: Mapping[str, float],
    correlation: Float[np.ndarray, "parameter parameter"],
    count: int,
) -> Float[np.ndarray, "draw parameter"]:
    """Values of the parameters that may be true, the first of which are the present ones.

    What must be positive is log-normal, and within a factor of four. The others are normal; all
    are points of a Sobol sequence.

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
            deviation = min(sizes[column] / values[column], _MOST)
            drawn = values[column] * np.exp(normal[:, column] * deviation)
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


def uncertain(
    stated: float | Mapping[str, float] | None,
    errors: Mapping[str, float],
    result: FitResult | None,
    values: Mapping[str, float],
) -> dict[str, float]:
    """Standard deviations by path, SI: what the caller says, else a fit, else a fifth.

    Arguments:
        stated: over the present value, of all that is free or by path.
        errors: standard errors of a fit, SI, by path.
        result: that fit.
        values: present ones of all that is free, SI, by path.

    Raises:
        InputError: a path that is not free, or a number that is negative or infinite.
    """
    if stated is None and result is not None:
        # What a fit did not find is not known for that.
        return {path: errors.get(path, _UNCERTAIN * abs(value)) for path, value in values.items()}
    if isinstance(stated, Mapping):
        for path in stated:
            if path not in values:
                raise InputError(f"'{path}' is uncertain and not free: free it, or leave it out")
        relative = dict(stated)
    else:
        relative = dict.fromkeys(values, _UNCERTAIN if stated is None else stated)
    for path, size in relative.items():
        if not 0 <= size < math.inf:
            raise InputError(f"the uncertainty of '{path}' is {size:g}: give 0 or a positive one")
    return {path: size * abs(values[path]) for path, size in relative.items()}
