"""Commands that undo the hysteresis of joints while an arm is driven."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float
from ..control import Compensator
from ..hysteresis import AbstractOperator


class Compensation:
    """The inverse of one joint's hysteresis, in every joint, one sample after the other.

    Arguments:
        compensator: of a joint whose command and angle were measured.
        joints: number of joints.

    Raises:
        InputError: what is inverted is not from angle to angle.
    """

    def __init__(self, compensator: Compensator, joints: int) -> None:
        channels = [compensator.input_channel, compensator.output_channel]
        if any(channel is not None and channel.quantity != "angle" for channel in channels):
            raise InputError(
                f"what is compensated is commanded by {compensator.input_channel.column}, and the "
                "joints of an arm by angles: give a fit from commanded to measured angles"
            )
        self._compensator = compensator
        self._joints = joints
        self._state: Any = None
        self._begun = False

    def __call__(self, wanted: Float[np.ndarray, " joint"]) -> Float[np.ndarray, " joint"]:
        """Commands for wanted angles, both rad, shape (joint,); what cannot be reached is cut."""
        low, high = self._compensator.reachable
        values = jnp.asarray(np.clip(wanted, low, high) - self._compensator.offset)
        if not self._begun:
            self._state, self._begun = self._of_each(), True
        inputs, self._state = _step(self._compensator.operator, values, self._state)
        return np.asarray(inputs)

    def _of_each(self) -> Any:
        def wide(leaf: Any) -> Array:
            leaf = jnp.asarray(leaf)
            return jnp.broadcast_to(leaf, (self._joints, *leaf.shape))

        state = self._compensator.state
        return None if state is None else jax.tree.map(wide, state)


@eqx.filter_jit
def _step(operator: AbstractOperator, values: Array, state: Any) -> tuple[Array, Any]:
    def of_one(value: Array, memory: Any) -> tuple[Array, Any]:
        inputs, after = operator.history(value[None], memory)
        return inputs[0], after

    return jax.vmap(of_one)(values, state)
