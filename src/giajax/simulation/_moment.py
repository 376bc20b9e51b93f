"""Where an arm is between two decisions."""

import equinox as eqx

from .._typing import Array, Float, Scalar
from ._motion import State


class Moment(eqx.Module):
    """An arm at one time of its motion.

    Attributes:
        time: s.
        state: of the joints: angles (rad), rates (rad/s), and what else the arm remembers.
        command: commanded angles, rad.
        wind: velocity of the air, m/s, of the whole arm or of link after link; None for still air.
    """

    time: Scalar
    state: State
    command: Float[Array, " joint"]
    wind: Float[Array, " width"] | None

    @property
    def angles(self) -> Float[Array, " joint"]:
        """Joint angles, rad."""
        return self.state[0]

    @property
    def rates(self) -> Float[Array, " joint"]:
        """Joint rates, rad/s."""
        return self.state[1]
