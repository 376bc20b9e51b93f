"""Commands that take a hysteretic joint to its targets."""

import dataclasses
from typing import Any, cast

import jax.numpy as jnp
import numpy as np

from ..mechanics.hysteresis import (
    AbstractOperator,
    InverseByBisection,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    branches_from_loop,
)
from ..models import AbstractModel, HysteresisModel, comparable, input_channel
from ..recordings import Channel, Run
from ..runtime.text import InputError
from ..schema.parameters import get

_TRAVEL = 1 / 3  # a third of the range: short against the range, long against the noise
_ROUNDING = 1e-6  # an excess over the reachable range that is rounding of a file


@dataclasses.dataclass(eq=False)
class Compensator:
    """From a history of target outputs to one of inputs, both SI.

    Made by `compensator_for_model` (the inverse of a fitted operator) or
    `compensator_for_loop` (eq. 12 of the paper).

    Attributes:
        operator: that takes an output less the offset (SI) to an input, from its state.
        reachable: least and greatest output that some input gives, SI.
        input_channel: what is commanded.
        output_channel: what was measured; None where that is not known.
    """

    operator: AbstractOperator
    state: Any
    offset: float
    reachable: tuple[float, float]
    input_channel: Channel
    output_channel: Channel | None = None

    def commands(self, target: np.ndarray) -> np.ndarray:
        """Inputs for a history of target outputs, both SI, shape (sample,)."""
        values = jnp.asarray(target - self.offset, dtype=jnp.result_type(float))
        return np.asarray(self.operator.history(values, self.state)[0])

    def commands_for(self, run: Run) -> np.ndarray:
        """Inputs for the output (or angle) of a run.

        Raises:
            InputError: a run without one target output at every sample, of another quantity, or
                one beyond what can be reached: the sample is named.
        """
        channel = target_channel(run)
        if self.output_channel is not None and not comparable(channel, self.output_channel):
            raise InputError(
                f"the target of '{run.name}' is {channel.column}, but the output of the inverted "
                f"model is {self.output_channel.column}: give a target of the same quantity"
            )
        values = run.values[channel.name]
        if np.any(np.isnan(values)):
            row = int(np.flatnonzero(np.isnan(values))[0])
            raise InputError(
                f"sample {row + 1} of '{run.name}' has no target value for {channel.name}: fill "
                "the gap"
            )
        low, high = self.reachable
        slack = _ROUNDING * (high - low)
        beyond = np.flatnonzero((values < low - slack) | (values > high + slack))
        if beyond.size:
            at = int(beyond[0])
            goal, *ends = (f"{channel.from_si(si):.4g}" for si in (values[at], low, high))
            raise InputError(
                f"the target of '{run.name}' is {goal} {channel.unit} in sample {at + 1}, outside "
                f"the reachable range of {' to '.join(ends)} {channel.unit}: change the target, or "
                "fit a run that covers a wider range"
            )
        commands = self.commands(np.clip(values, low, high))
        if not np.all(np.isfinite(commands)):
            at = int(np.flatnonzero(~np.isfinite(commands))[0])
            raise InputError(
                f"no command reaches the target of '{run.name}' in sample {at + 1}: fit a "
                "different operator, or reduce the target"
            )
        return commands


def target_channel(run: Run) -> Channel:
    """The one channel of a run that is a target."""
    targets = [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]
    if len(targets) != 1:
        raise InputError(
            f"'{run.name}' has {len(targets)} output or angle columns: give only one, the target"
        )
    return targets[0]


def compensator_for_model(model: AbstractModel) -> Compensator:
    """The inverse of a fitted model: exact for Prandtl-Ishlinskii and its modified form.

    Other operators are inverted by bisection within the range of the input that they were fitted
    to.

    Raises:
        InputError: a model of another kind, or an operator that has no inverse.
    """
    if model.kind != HysteresisModel.kind:
        raise InputError(
            f"the fit uses the {model.kind} model, which cannot be inverted: give a fit of the "
            "hysteresis model"
        )
    model = cast(HysteresisModel, model)
    operator, state = model.operator, model.memory()
    inverse: AbstractOperator
    if isinstance(operator, PrandtlIshlinskii | ModifiedPrandtlIshlinskii):
        inverse, memory = operator.inverse(), operator.inverse_state(state)
    else:
        # The first move may come from 0, outside the range.
        longest = max(2 * model.settings.reach, *map(abs, model.settings.input_range))
        fine = operator.for_moves_of(longest)
        inverse, memory = InverseByBisection(fine, *model.settings.input_range), state
    channels = model.columns.input_channel, model.columns.output_channel
    return Compensator(inverse, memory, float(get(model, "offset")), model.reachable(), *channels)


def compensator_for_loop(run: Run, travel: float | None = None) -> Compensator:
    """Eq. (12) of the paper with the branches of a recorded loop over the whole range.

    The transition coefficient goes from 0 to 1 within the travel, SI; a third of the range of the
    output by default.

    Raises:
        InputError: a run of another model, or one that does not have both branches.
    """
    run.require_observations()
    name, values = next(iter(run.observations.items()))
    channel = input_channel(run, HysteresisModel.kind)
    travel = _TRAVEL * float(np.nanmax(values) - np.nanmin(values)) if travel is None else travel
    operator = branches_from_loop(run.values[channel.name], values, travel)
    if not operator.reachable[0] < operator.reachable[1]:
        raise InputError(
            f"the branches of '{run.name}' share no range of {name}: give a loop that rises and "
            "falls over the same range"
        )
    return Compensator(operator, None, 0.0, operator.reachable, channel, run.channels[name])
