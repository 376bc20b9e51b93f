"""How far the uncertainty of the parameters moves a prediction, without another fit."""

from collections.abc import Mapping

import numpy as np

from ...fitting import FitResult, predict
from ...parameters import replace
from ...runs import Run

# Each parameter costs a prediction; the program for it is compiled already.
_MOST_PARAMETERS = 12


def can_have_bands(result: FitResult) -> bool:
    """Whether a band costs little and is what the result knows: few parameters, without ties."""
    paths = result.correlation.parameters
    return (
        0 < len(paths) <= _MOST_PARAMETERS
        and set(paths) <= set(result.parameters)
        and not result.config.get("ties")
        and all(result.parameters[path].standard_error for path in paths)
        and all(
            value is not None and np.isfinite(value)
            for row in result.correlation.matrix
            for value in row
        )
        and not any(run.parameters.keys() & result.free.keys() for run in result.runs)
    )


def prediction_errors_of_parameters(
    result: FitResult, run: Run, predicted: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Standard deviation of each predicted channel by the covariance of the shared parameters.

    To first order: each parameter is moved by its standard error, and the changes are added up
    with the correlations. What a run has for itself, such as its initial state, is not in it.

    Arguments:
        result: of which `can_have_bands`.
        run: to be predicted.
        predicted: by the fitted model, SI, by channel.

    Returns:
        SI, by channel, each of shape (sample,); empty where a moved model cannot be predicted.
    """
    model = result.model_of(run)
    changes: dict[str, list[np.ndarray]] = {name: [] for name in predicted}
    for path in result.correlation.parameters:
        estimate = result.parameters[path]
        moved = estimate.value + estimate.standard_error
        if estimate.upper is not None and moved >= estimate.upper:
            moved = estimate.value - estimate.standard_error
        there = predict(replace(model, {path: moved}), run, list(predicted))
        sign = np.sign(moved - estimate.value)
        for name, values in there.items():
            changes[name].append(sign * (values - predicted[name]))
    matrix = np.array(result.correlation.matrix, dtype=float)
    bands = {}
    for name, rows in changes.items():
        table = np.stack(rows)
        variance = np.einsum("is,ij,js->s", table, matrix, table)
        if not np.all(np.isfinite(variance)):
            return {}
        bands[name] = np.sqrt(np.maximum(variance, 0.0))
    return bands
