"""Predictions of a model for a run, as plain arrays."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from .._program import program
from ..models import AbstractModel, Channels
from ..runs import Run


@program
def _predict(model: AbstractModel, inputs: object, channels: tuple[str, ...]) -> Channels:
    return model.predict(inputs, channels)[0]


def predict(
    model: AbstractModel, run: Run, channels: Sequence[str] | None = None
) -> dict[str, np.ndarray]:
    """Channels that a model predicts for a run.

    Arguments:
        model: the model.
        run: gives times, commands and wind; its recorded channels are not used.
        channels: names without unit (`link06_z`); those that the run recorded by default.

    Returns:
        Arrays in SI units of shape (sample,) by channel name; infinite or NaN where the
        simulation did not get.

    Raises:
        InputError: an unknown channel, or a run of another model.
    """
    names = tuple(run.observations if channels is None else channels)
    predicted = _predict(model, model.prepare(run), names)
    return {name: np.asarray(predicted[name]) for name in names}


def prediction_errors(
    model: AbstractModel, run: Run, channels: Sequence[str] | None = None
) -> dict[str, Any]:
    """How far a prediction is from what a run recorded.

    Arguments:
        model: the model.
        run: a recorded run; its initial state is as its definition says.
        channels: names without unit; those that the run recorded by default.

    Returns:
        {"name", "path", "channels": {name: {"unit", "rmse", "largest", "n"}}}, in the unit of
        the recording; infinite where the simulation failed.

    Raises:
        InputError: as `predict`.
    """
    names = list(run.observations if channels is None else channels)
    predicted = predict(model, run, names)
    found = {}
    for name in names:
        channel, recorded = run.channels[name], run.observations[name]
        difference = (predicted[name] - recorded)[~np.isnan(recorded)]
        difference = np.where(np.isnan(difference), np.inf, difference)
        found[name] = {
            "unit": channel.unit,
            "rmse": float(channel.from_si(np.sqrt(np.mean(difference**2)))),
            "largest": float(channel.from_si(np.max(np.abs(difference)))),
            "n": len(difference),
        }
    path = None if run.path is None else str(run.path)
    return {"name": run.name, "path": path, "channels": found}
