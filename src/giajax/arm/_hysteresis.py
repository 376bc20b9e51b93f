"""What joints remember of their way: the states of their hysteresis, in one table."""

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Float
from ._memory import Memory
from ._stops import Stops


class JointHysteresis(eqx.Module):
    """Hysteresis of the joints, beside their springs; by default there is none.

    Its states are a table of shape (row, joint): those of `memory`, and then those of `stops`.

    Arguments:
        memory: a Bouc-Wen element in each joint.
        stops: elastic springs in parallel that slide.
    """

    memory: Memory = eqx.field(default_factory=Memory)
    stops: Stops = eqx.field(default_factory=Stops)

    @property
    def rows(self) -> int:
        """States of each joint beside its angle and rate."""
        return self.memory.rows + self.stops.rows

    def unstrained(self, angles: Float[Array, " joint"]) -> Float[Array, "row joint"]:
        """The states of joints that were never moved from these angles (rad)."""
        parts = [self.memory.unstrained(angles), self.stops.unstrained(angles)]
        return jnp.concatenate(parts)

    def _split(self, states: Array) -> tuple[Array, Array]:
        return states[: self.memory.rows], states[self.memory.rows :]

    def torque(
        self, angles: Float[Array, " joint"], states: Float[Array, "row joint"]
    ) -> Float[Array, " joint"]:
        """Torque against the motion of each joint, N m."""
        z, slipped = self._split(states)
        return self.memory.torque(z) + self.stops.torque(angles, slipped)

    def rate(
        self, rates: Float[Array, " joint"], states: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """How fast the states change, 1/s; those of stops change by `caught_up`."""
        z, slipped = self._split(states)
        return jnp.concatenate([self.memory.rate(rates, z), jnp.zeros_like(slipped)])

    def tangent(
        self,
        angles: Float[Array, " joint"],
        rates: Float[Array, " joint"],
        states: Float[Array, "row joint"],
    ) -> Float[Array, " joint"]:
        """Stiffness at constant states, N m/rad."""
        return self.stops.tangent(angles, rates, self._split(states)[1])

    def pull(self, states: Float[Array, "row joint"]) -> Float[Array, "row joint"]:
        """Torque of a unit of each state at constant angles, against the motion, N m.

        The state of a stop changes where it slides, and its torque does not.
        """
        z, slipped = self._split(states)
        return jnp.concatenate([self.memory.pull(z), jnp.zeros_like(slipped)])

    def caught_up(
        self, angles: Float[Array, " joint"], states: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """The states after a motion to these angles (rad) in which no joint turned round."""
        z, slipped = self._split(states)
        return jnp.concatenate([z, self.stops.caught_up(angles, slipped)])

    def energy(
        self, angles: Float[Array, " joint"], states: Float[Array, "row joint"]
    ) -> Float[Array, " joint"]:
        """Energy that is stored and given back, J."""
        z, slipped = self._split(states)
        return self.memory.energy(z) + self.stops.energy(angles, slipped)

    def dissipation(
        self,
        angles: Float[Array, " joint"],
        rates: Float[Array, " joint"],
        states: Float[Array, "row joint"],
    ) -> Float[Array, " joint"]:
        """Power that becomes heat, W."""
        z, slipped = self._split(states)
        return self.memory.dissipation(rates, z) + self.stops.dissipation(angles, rates, slipped)

    @property
    def stiffness(self) -> Float[Array, ""] | Float[Array, " joint"]:
        """Largest stiffness, N m/rad."""
        return self.memory.stiffness + self.stops.stiffness
