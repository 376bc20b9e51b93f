"""Predictions of a model for a run, as plain arrays."""

from collections.abc import Mapping, Sequence

import numpy as np

from .._program import program
from ..models import AbstractModel, Channels
from ..runs import Run
from ._run_records import ChannelErrors, PredictionErrors


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
        simulation did not arrive.

    Raises:
        InputError: an unknown channel, or a run of another model.
    """
    names = tuple(run.observations if channels is None else channels)
    predicted = _predict(model, model.prepare(run), names)
    return {name: np.asarray(predicted[name]) for name in names}


def prediction_errors(
    model: AbstractModel, run: Run, channels: Sequence[str] | None = None
) -> PredictionErrors:
    """How far a prediction is from what a run recorded.

    Arguments:
        model: the model.
        run: a recorded run; its initial state is as its definition says.
        channels: names without unit; those that the run recorded by default.

    Returns:
        Errors by channel, in the unit of the recording; infinite where the simulation failed.

    Raises:
        InputError: as `predict`.
    """
    names = list(run.observations if channels is None else channels)
    return errors_of(run, predict(model, run, names))


def errors_of(run: Run, predicted: Mapping[str, np.ndarray]) -> PredictionErrors:
    """How far predicted channels (SI, by name) are from what a run recorded of them.

    Arguments:
        run: what was recorded.
        predicted: SI, by channel, each of shape (sample,).

    Returns:
        Errors by channel, in the unit of the recording.
    """
    errors = {}
    for name, values in predicted.items():
        channel, recorded = run.channels[name], run.observations[name]
        difference = (values - recorded)[~np.isnan(recorded)]
        difference = np.where(np.isnan(difference), np.inf, difference)
        errors[name] = ChannelErrors(
            unit=channel.unit,
            rmse=float(channel.from_si(np.sqrt(np.mean(difference**2)))),
            largest=float(channel.from_si(np.max(np.abs(difference)))),
            n=len(difference),
        )
    return PredictionErrors(run.name, None if run.path is None else str(run.path), errors)
