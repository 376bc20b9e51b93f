"""Commands that move a hysteretic joint to its targets."""

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

_TRAVEL = 1 / 3  # Small compared with the range, large compared with the noise.
# Tolerated excess over the reachable range, due to the rounding of numbers in a file.
_ROUNDING = 1e-6


@dataclasses.dataclass(eq=False)
class Compensator:
    """Mapping from a history of target outputs to a history of inputs, both SI.

    It is made by `compensator_for_model` (the inverse of a fitted operator) or
    `compensator_for_loop` (eq. 12 of the paper).

    Attributes:
        operator: operator that maps an output minus the offset (SI) to an input, from `state`.
        reachable: smallest and largest output that some input produces, SI.
        input_channel: channel of the command.
        output_channel: channel of the measured output; None if unknown.
    """

    operator: AbstractOperator
    state: Any
    offset: float
    reachable: tuple[float, float]
    input_channel: Channel
    output_channel: Channel | None = None

    def commands(self, target: np.ndarray) -> np.ndarray:
        """Return the inputs for a history of target outputs, both SI, shape (sample,)."""
        values = jnp.asarray(target - self.offset, dtype=jnp.result_type(float))
        return np.asarray(self.operator.history(values, self.state)[0])

    def commands_for(self, run: Run) -> np.ndarray:
        """Return the inputs for the output (or angle) of a run.

        Raises:
            InputError: a run without exactly one complete target output, a target of another
                quantity, or a target outside the reachable range (the sample is named).
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
    """Return the only target channel of a run."""
    targets = [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]
    if len(targets) != 1:
        raise InputError(
            f"'{run.name}' has {len(targets)} output or angle columns: give only the target column"
        )
    return targets[0]


def compensator_for_model(model: AbstractModel) -> Compensator:
    """Return the inverse of a fitted model.

    It is exact for the Prandtl-Ishlinskii operator and its modified form. Other operators are
    inverted by bisection within the range of the input that they were fitted to.

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
        # The first move may start from 0, outside the range.
        longest = max(2 * model.settings.reach, *map(abs, model.settings.input_range))
        fine = operator.for_moves_of(longest)
        inverse, memory = InverseByBisection(fine, *model.settings.input_range), state
    channels = model.columns.input_channel, model.columns.output_channel
    return Compensator(inverse, memory, float(get(model, "offset")), model.reachable(), *channels)


def compensator_for_loop(run: Run, travel: float | None = None) -> Compensator:
    """Return eq. (12) of the paper with the branches of a recorded loop over the whole range.

    The transition coefficient changes from 0 to 1 within `travel`, SI. The default is a third of
    the range of the output.

    Raises:
        InputError: a run of another model, or a run that does not contain both branches.
    """
    run.require_observations()
    name, values = next(iter(run.observations.items()))
    channel = input_channel(run, HysteresisModel.kind)
    travel = _TRAVEL * float(np.nanmax(values) - np.nanmin(values)) if travel is None else travel
    operator = branches_from_loop(run.values[channel.name], values, travel)
    if not operator.reachable[0] < operator.reachable[1]:
        raise InputError(
            f"the branches of '{run.name}' do not share a range of {name}: give a loop that "
            "rises and falls over the same range"
        )
    return Compensator(operator, None, 0.0, operator.reachable, channel, run.channels[name])
