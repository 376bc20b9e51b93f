"""Commands that make a hysteretic joint go where it is wanted."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..hysteresis import (
    AbstractOperator,
    InverseByBisection,
    ModifiedPrandtlIshlinskii,
    PrandtlIshlinskii,
    branches_from_loop,
)
from ..parameters import get
from ..runs import Channel, Run
from ._hysteresis import HysteresisModel
from ._response import comparable, input_channel

# A third of the range: short against the range, long against the noise.
_TRAVEL = 1 / 3

# An excess over the reachable range that is rounding of a file.
_ROUNDING = 1e-6


class Compensator:
    """From a history of wanted outputs to one of inputs, both SI.

    Made by `compensator_for_model` (the inverse of a fitted operator) or
    `compensator_for_loop` (eq. 12 of the paper).

    Attributes:
        reachable: outputs that can be had.
        input_channel: what is commanded.
        output_channel: what was measured; None where that is not known.
    """

    def __init__(
        self,
        operator: AbstractOperator,
        state: Any,
        offset: float,
        reachable: tuple[float, float],
        channel: Channel,
        output: Channel | None = None,
    ) -> None:
        self.operator = operator
        self.state = state
        self.offset = offset
        self.reachable = reachable
        self.input_channel = channel
        self.output_channel = output

    def commands(self, wanted: np.ndarray) -> np.ndarray:
        """Inputs for a history of wanted outputs, SI, shape (sample,)."""
        values = jnp.asarray(wanted - self.offset, dtype=jnp.result_type(float))
        return np.asarray(self.operator.history(values, self.state)[0])

    def commands_for(self, run: Run) -> np.ndarray:
        """Inputs for the output (or angle) of a run.

        Raises:
            InputError: a run without one wanted output at every sample, of another quantity, or
                one beyond what can be reached: the sample is named.
        """
        channel = wanted_channel(run)
        if self.output_channel is not None and not comparable(channel, self.output_channel):
            raise InputError(
                f"'{run.name}' wants {channel.column}, but what is inverted gives "
                f"{self.output_channel.column}; want the same quantity"
            )
        values = run.values[channel.name]
        if np.any(np.isnan(values)):
            row = int(np.flatnonzero(np.isnan(values))[0])
            raise InputError(
                f"'{run.name}' has no wanted {channel.name} in sample {row + 1}; fill the gap"
            )
        low, high = self.reachable
        slack = _ROUNDING * (high - low)
        beyond = np.flatnonzero((values < low - slack) | (values > high + slack))
        if beyond.size:
            at = int(beyond[0])
            ends = f"{channel.from_si(low):.4g} to {channel.from_si(high):.4g} {channel.unit}"
            raise InputError(
                f"'{run.name}' wants {channel.from_si(values[at]):.4g} {channel.unit} in sample "
                f"{at + 1}, beyond the reachable range from {ends}; want less, or fit a run that "
                "goes further"
            )
        commands = self.commands(np.clip(values, low, high))
        if not np.all(np.isfinite(commands)):
            at = int(np.flatnonzero(~np.isfinite(commands))[0])
            raise InputError(
                f"no command gives what '{run.name}' wants in sample {at + 1}; fit another "
                "operator, or want less"
            )
        return commands


def wanted_channel(run: Run) -> Channel:
    """The one channel of a run that is wanted.

    Raises:
        InputError: a run without one, or with several.
    """
    found = [channel for channel in run.channels.values() if channel.kind in run.kind.outputs]
    if len(found) != 1:
        raise InputError(
            f"'{run.name}' must have one column of wanted output or angle, and has "
            f"{len(found)}; correct the file"
        )
    return found[0]


def compensator_for_model(model: HysteresisModel) -> Compensator:
    """The inverse of a fitted model: exact for Prandtl-Ishlinskii and its modified form.

    Other operators are inverted by bisection within the range of the input that they were fitted
    to.

    Raises:
        InputError: a fitted operator that has no inverse.
    """
    operator = model.operator
    state = model.memory()
    inverse: AbstractOperator
    if isinstance(operator, PrandtlIshlinskii | ModifiedPrandtlIshlinskii):
        inverse, memory = operator.inverse(), operator.inverse_state(state)
    else:
        # The first move may come from 0, outside the range.
        longest = max(2 * model.settings.reach, *map(abs, model.settings.input_range))
        fine = operator.for_moves_of(longest)
        inverse, memory = InverseByBisection(fine, *model.settings.input_range), state
    return Compensator(
        inverse,
        memory,
        float(get(model, "offset")),
        model.reachable(),
        model.columns.input_channel,
        model.columns.output_channel,
    )


def compensator_for_loop(run: Run, travel: float | None = None) -> Compensator:
    """Eq. (12) of the paper with the branches of a recorded loop.

    Arguments:
        run: a hysteresis run that goes up and down over the whole range.
        travel: within which the transition coefficient goes from 0 to 1, SI; a third of the
            range of the output by default.

    Raises:
        InputError: a run that is none, or does not have both branches.
    """
    run.require_observations()
    name, values = next(iter(run.observations.items()))
    channel = input_channel(run, HysteresisModel.kind)
    travel = _TRAVEL * float(np.nanmax(values) - np.nanmin(values)) if travel is None else travel
    operator = branches_from_loop(run.values[channel.name], values, travel)
    if not operator.reachable[0] < operator.reachable[1]:
        raise InputError(
            f"the branches of '{run.name}' have no {name} in common; give a loop that goes up and "
            "down over the same range"
        )
    return Compensator(operator, None, 0.0, operator.reachable, channel, run.channels[name])
