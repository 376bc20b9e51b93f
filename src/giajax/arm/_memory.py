"""Hysteresis of a joint beside its spring, as a differential equation.

It depends on the way of the joint and not on its rate: after a motion to and fro the joint does
not come back to where it was, however slowly it moves.
"""

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..hysteresis import bouc_wen_rate
from ..parameters import parameter
from ..quantities import JOINT_MEMORY

Each = Float[Array, ""] | Float[Array, " joint"]


class Memory(eqx.Module):
    """A Bouc-Wen element in each joint: it resists with strength z, where z is its state.

        dz/dt = (v - (1 - delta) |v| |z|^(nu - 1) z - delta v |z|^nu) / yield_angle

    of the joint's rate v, so that |z| never passes 1. With nu = 1 and delta = 0, the defaults, it
    is Dahl's model of friction; with a large nu and delta = 1/2 an elastic spring that slides.

    References: Y.-K. Wen, J. Eng. Mech. Div. 102 (1976) 249-263; P. R. Dahl, AIAA J. 14 (1976)
    1675-1682; M. Ismail et al., Arch. Comput. Methods Eng. 16 (2009) 161-188.

    Arguments:
        strength: largest torque, N m; None where joints have no such element.
        yield_angle: strength over the stiffness at the beginning of a motion, rad.
        nu: sharpness of the knee.
        delta: shape of the loop; at most 1/2, where unloading is elastic: an element with more
            would give energy away.
    """

    strength: Each | None = parameter(JOINT_MEMORY.strength)
    yield_angle: Each = parameter(JOINT_MEMORY.yield_angle)
    nu: Scalar = parameter(JOINT_MEMORY.nu)
    delta: Scalar = parameter(JOINT_MEMORY.delta)

    @property
    def rows(self) -> int:
        """States of each joint."""
        return 0 if self.strength is None else 1

    @property
    def stiffness(self) -> Each:
        """Largest stiffness, N m/rad: that of an element which slid, at the turn."""
        if self.strength is None:
            return jnp.zeros(())
        return 2 * (1 - self.delta) * self.strength / self.yield_angle

    def unstrained(self, angles: Float[Array, " joint"]) -> Float[Array, "row joint"]:
        """The states of a joint that was never moved."""
        return jnp.zeros((self.rows, angles.size), angles.dtype)

    def torque(self, z: Float[Array, "row joint"]) -> Float[Array, " joint"]:
        """Torque against the strain, N m."""
        return jnp.zeros(z.shape[1:], z.dtype) if self.strength is None else self.strength * z[0]

    def rate(
        self, rates: Float[Array, " joint"], z: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """How fast the states change, 1/s."""
        if self.strength is None:
            return z
        one, gamma = jnp.ones(()), 1 - self.delta
        rate = bouc_wen_rate(rates, z[0], one, one, gamma, self.delta, self.nu)
        return (rate / self.yield_angle)[None]

    def pull(self, z: Float[Array, "row joint"]) -> Float[Array, "row joint"]:
        """Torque of a unit of each state, N m."""
        return z if self.strength is None else jnp.broadcast_to(self.strength, z.shape)

    def energy(self, z: Float[Array, "row joint"]) -> Float[Array, " joint"]:
        """Energy of the strain, J."""
        if self.strength is None:
            return jnp.zeros(z.shape[1:], z.dtype)
        return self.strength * self.yield_angle * z[0] ** 2 / 2

    def dissipation(
        self, rates: Float[Array, " joint"], z: Float[Array, "row joint"]
    ) -> Float[Array, " joint"]:
        """Power that becomes heat, W: what of the torque's power is not stored."""
        if self.strength is None:
            return jnp.zeros_like(rates)
        kept = self.yield_angle * self.rate(rates, z)[0]
        return self.strength * z[0] * (rates - kept)
