"""Runs made by a model instead of an experiment, with noise and gaps."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._program import program
from .._typing import Array, Bool
from ..models import AbstractModel, Channels
from ..runs import Definition, Run
from ..simulation import SimulationError


def synthesise(
    model: AbstractModel,
    times: npt.ArrayLike | None,
    inputs: Mapping[str, npt.ArrayLike],
    channels: Sequence[str],
    *,
    noise: Mapping[str, float] | None = None,
    missing: float = 0.0,
    seed: int = 0,
    definition: Definition | Mapping[str, Any] | None = None,
    constants: AbstractModel | None = None,
    name: str = "synthetic",
) -> Run:
    """A run as an experiment would record it: what the model predicts, with noise and gaps.

    The model gets the inputs as the run would give them, between whose rows they are linear
    or held as `definition` says: predicting the returned run with the same model gives the same
    channels without noise.

    The noise is white and normal. Each channel has a random stream of its own, made from the
    seed and its name, so that recording more channels does not change the others.

    Arguments:
        model: the truth.
        times: increasing, s, shape (sample,); None for a static run.
        inputs: what drives the model, by channel (`joint01_command`, `wind_x`), SI, each of
            shape (sample,). Without any the definition must allow a free motion.
        channels: names of the channels to record (`link06_z`, `tip_x`).
        noise: standard deviations, SI, by quantity (`position`, `angle`, `rate`) or channel;
            beside those that the definition states.
        missing: fraction of the samples of each channel that are left empty, in [0, 1).
        seed: of the noise and the gaps.
        definition: what a sidecar would say of the run; the model's constants are added.
        constants: the model whose constants are added instead, such as one that knows nothing of a
            turned camera.
        name: of the run.

    Returns:
        The run, SI, NaN where a cell is empty.

    Raises:
        InputError: a channel that the model cannot predict, or `missing` outside [0, 1).
        SimulationError: the model cannot be evaluated.

    Example:
        >>> import giajax, numpy as np
        >>> from giajax.synthetic import synthesise
        >>> times = np.linspace(0.0, 10.0, 101)
        >>> command = np.interp(times, [0.5, 1.5], [0.0, 0.5])
        >>> model = giajax.ArmModel(giajax.takeichi_20m())
        >>> run = synthesise(
        ...     model, times, {"joint01_command": command}, ["link20_z"], noise={"position": 0.02}
        ... )
        >>> sorted(run.observations)
        ['link20_z']
    """
    if not 0 <= missing < 1:
        raise InputError(f"the missing fraction is {missing:g}: give at least 0 and less than 1")
    times = None if times is None else np.asarray(times, dtype=float)
    if not isinstance(definition, Definition):
        definition = Definition.parse(definition or {}, f"{name}: definition")
    # The model is prepared by a run that has the channels, as yet without values.
    samples = len(np.asarray(next(iter(inputs.values()))) if times is None else times)
    blank = {channel: np.zeros(samples) for channel in channels}
    plan = Run.from_arrays(
        times,
        {**inputs, **blank},
        name=name,
        noise=noise,
        definition=definition.merged_with(_constants(constants or model)),
    )
    unknown = [channel for channel in channels if channel not in plan.observations]
    if unknown:
        raise InputError(
            f"'{unknown[0]}' drives the model, which does not predict it: record another channel"
        )
    prepared = model.prepare(plan)
    predicted, successful = predict_prepared(model, prepared, tuple(channels))
    if not successful:
        raise SimulationError(model.failure(prepared))
    hidden = model.unseen(prepared, tuple(channels))
    recorded = {
        channel: _record(
            blanked(predicted[channel], hidden.get(channel)),
            plan.noise(channel),
            missing,
            seed,
            channel,
        )
        for channel in channels
    }
    return Run.from_arrays(times, {**inputs, **recorded}, name=name, definition=plan.definition)


def _constants(model: AbstractModel) -> Definition:
    """What the model knows of itself that a sidecar can state."""
    constants = model.definition()
    known = {key: constants[key] for key in constants if key in Definition.model_fields}
    return Definition.parse({"model": model.kind, **known}, "model")


@program
def predict_prepared(
    model: AbstractModel, inputs: Any, channels: tuple[str, ...]
) -> tuple[Channels, Bool[Array, ""]]:
    """What a model predicts for a prepared run, compiled, and whether that succeeded."""
    return model.predict(inputs, channels)


def blanked(values: npt.ArrayLike, hidden: npt.NDArray[np.bool_] | None) -> npt.NDArray[np.float64]:
    """What a model predicts of a channel, NaN where no experiment could record it."""
    shown = np.array(values, dtype=float)
    if hidden is not None:
        shown[hidden] = np.nan
    return shown


def _record(
    values: np.ndarray, deviation: float | None, missing: float, seed: int, channel: str
) -> np.ndarray:
    random = np.random.default_rng([seed, *channel.encode()])
    recorded = values + (deviation or 0.0) * random.standard_normal(len(values))
    # An exact number, rounded down: a channel is never left without a value.
    recorded[random.permutation(len(values))[: int(missing * len(values))]] = np.nan
    return recorded
