"""Predictions of a model for a run, as plain arrays."""

from collections.abc import Sequence

import equinox as eqx
import numpy as np

from ..models import AbstractModel, Channels
from ..runs import Run


@eqx.filter_jit
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
