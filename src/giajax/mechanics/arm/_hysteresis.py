"""Hysteresis of joints: the states beside their springs, and the torques that follow."""

import equinox as eqx
import jax.numpy as jnp

from ...runtime.arrays import Array, Bool, Float, Scalar
from ...runtime.text import InputError
from ...schema import JOINT_MEMORY, JOINT_STOPS
from ...schema.parameters import parameter
from ..hysteresis import bouc_wen_rate

PerJoint = Float[Array, " joint"]
States = Float[Array, "row joint"]

_ROUNDING = 16  # of the angles that a strain is the difference of, in units of their last place


class Stops(eqx.Module):
    """Elastic springs in parallel that slide, each from its own angle on: Iwan's model.

    The state of each is the angle at which it is without strain. It moves with the joint where
    the element slides, which is the play operator of `giajax.mechanics.hysteresis`.

    Reference: W. D. Iwan, J. Appl. Mech. 33 (1966) 893-900.

    Arguments:
        strength: torque at which each slides, N m; None where joints have none.
        yield_angle: strain at which each slides, rad; one for all or one for each.

    Raises:
        InputError: another number of angles than of strengths.
    """

    strength: Float[Array, ""] | Float[Array, " stop"] | None = parameter(JOINT_STOPS.strength)
    yield_angle: Float[Array, ""] | Float[Array, " stop"] = parameter(JOINT_STOPS.yield_angle)

    def __check_init__(self) -> None:
        if self.strength is None:
            return
        shapes = {self.strength.shape, self.yield_angle.shape} - {()}
        if len(shapes) > 1 or any(len(shape) != 1 or not shape[0] for shape in shapes):
            raise InputError(
                f"joints.stops has strengths of shape {self.strength.shape} and yield angles of "
                f"shape {self.yield_angle.shape}: give one of each for every element"
            )

    @property
    def rows(self) -> int:
        """States of each joint."""
        return 0 if self.strength is None else max(self.strength.size, self.yield_angle.size)

    @property
    def stiffness(self) -> Scalar:
        """Stiffness of all together where none slides, N m/rad."""
        return jnp.sum(self._strengths / self._yield_angles)

    def unstrained(self, angles: PerJoint) -> States:
        """The states of a joint that was never moved from these angles (rad), rad."""
        return jnp.broadcast_to(angles, (self.rows, angles.size))

    def strain(self, angles: PerJoint, slipped: States) -> States:
        """Strain of each over its yield angle, between -1 and 1."""
        return jnp.clip((angles[None] - slipped) / self._yield_angles, -1, 1)

    def torque(self, angles: PerJoint, slipped: States) -> PerJoint:
        """Torque against the strain, N m."""
        return jnp.sum(self._strengths * self.strain(angles, slipped), axis=0)

    def tangent(self, angles: PerJoint, rates: PerJoint, slipped: States) -> PerJoint:
        """Stiffness in one state: of those that do not slide on, N m/rad."""
        stiffness = self._strengths / self._yield_angles
        return jnp.sum(jnp.where(self._slides(angles, rates, slipped), 0, stiffness), axis=0)

    def dissipation(self, angles: PerJoint, rates: PerJoint, slipped: States) -> PerJoint:
        """Power that becomes heat where elements slide, W."""
        heat = self._strengths * jnp.abs(rates)[None]
        return jnp.sum(jnp.where(self._slides(angles, rates, slipped), heat, 0), axis=0)

    def return_mapped(self, angles: PerJoint, slipped: States) -> States:
        """The states (rad) after a motion to these angles (rad) in one direction."""
        width = self._yield_angles
        return jnp.clip(slipped, angles[None] - width, angles[None] + width)

    def energy(self, angles: PerJoint, slipped: States) -> PerJoint:
        """Energy of the strain, J."""
        stored = self._strengths * self._yield_angles * self.strain(angles, slipped) ** 2 / 2
        return jnp.sum(stored, axis=0)

    def _slides(self, angles: Array, rates: Array, slipped: Array) -> Bool[Array, "row joint"]:
        strain, width = angles[None] - slipped, self._yield_angles
        # One that slides is at its limit but for rounding.
        rounding = _ROUNDING * jnp.finfo(angles.dtype).eps * (jnp.abs(angles)[None] + width)
        return (jnp.abs(strain) > width - rounding) & (strain * rates[None] > 0)

    @property
    def _strengths(self) -> Float[Array, "row 1"]:
        strength = jnp.zeros(()) if self.strength is None else self.strength
        return jnp.broadcast_to(strength, (self.rows,))[:, None]

    @property
    def _yield_angles(self) -> Float[Array, "row 1"]:
        width = jnp.ones(()) if self.strength is None else self.yield_angle
        return jnp.broadcast_to(width, (self.rows,))[:, None]


Each = Float[Array, ""] | PerJoint


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

    def unstrained(self, angles: PerJoint) -> States:
        """The states of a joint that was never moved."""
        return jnp.zeros((self.rows, angles.size), angles.dtype)

    def torque(self, z: States) -> PerJoint:
        """Torque against the strain, N m."""
        return jnp.zeros(z.shape[1:], z.dtype) if self.strength is None else self.strength * z[0]

    def rate(self, rates: PerJoint, z: States) -> States:
        """How fast the states change, 1/s."""
        if self.strength is None:
            return z
        one, gamma = jnp.ones(()), 1 - self.delta
        rate = bouc_wen_rate(rates, z[0], one, one, gamma, self.delta, self.nu)
        return (rate / self.yield_angle)[None]

    def pull(self, z: States) -> States:
        """Torque of a unit of each state, N m."""
        return z if self.strength is None else jnp.broadcast_to(self.strength, z.shape)

    def energy(self, z: States) -> PerJoint:
        """Energy of the strain, J."""
        if self.strength is None:
            return jnp.zeros(z.shape[1:], z.dtype)
        return self.strength * self.yield_angle * z[0] ** 2 / 2

    def dissipation(self, rates: PerJoint, z: States) -> PerJoint:
        """Power that becomes heat, W: what of the torque's power is not stored."""
        if self.strength is None:
            return jnp.zeros_like(rates)
        kept = self.yield_angle * self.rate(rates, z)[0]
        return self.strength * z[0] * (rates - kept)


class JointHysteresis(eqx.Module):
    """Hysteresis of the joints, beside their springs; by default there is none.

    It depends on the way of a joint and not on its rate: after a motion to and fro the joint does
    not come back to where it was, however slowly it moves. Its states are a table of shape (row,
    joint): those of `memory`, and then those of `stops`.
    """

    memory: Memory = eqx.field(default_factory=Memory)
    stops: Stops = eqx.field(default_factory=Stops)

    @property
    def rows(self) -> int:
        """States of each joint beside its angle and rate."""
        return self.memory.rows + self.stops.rows

    def unstrained(self, angles: PerJoint) -> States:
        """The states of joints that were never moved from these angles (rad)."""
        return jnp.concatenate([self.memory.unstrained(angles), self.stops.unstrained(angles)])

    def _split(self, states: Array) -> tuple[Array, Array]:
        return states[: self.memory.rows], states[self.memory.rows :]

    def torque(self, angles: PerJoint, states: States) -> PerJoint:
        """Torque against the motion of each joint, N m."""
        z, slipped = self._split(states)
        return self.memory.torque(z) + self.stops.torque(angles, slipped)

    def rate(self, rates: PerJoint, states: States) -> States:
        """How fast the states change, 1/s; those of stops change by `return_mapped`."""
        z, slipped = self._split(states)
        return jnp.concatenate([self.memory.rate(rates, z), jnp.zeros_like(slipped)])

    def tangent(self, angles: PerJoint, rates: PerJoint, states: States) -> PerJoint:
        """Stiffness at constant states, N m/rad."""
        return self.stops.tangent(angles, rates, self._split(states)[1])

    def pull(self, states: States) -> States:
        """Torque of a unit of each state at constant angles, against the motion, N m.

        The state of a stop changes where it slides, and its torque does not.
        """
        z, slipped = self._split(states)
        return jnp.concatenate([self.memory.pull(z), jnp.zeros_like(slipped)])

    def return_mapped(self, angles: PerJoint, states: States) -> States:
        """The states after a motion to these angles (rad) in which no joint turned round."""
        z, slipped = self._split(states)
        return jnp.concatenate([z, self.stops.return_mapped(angles, slipped)])

    def energy(self, angles: PerJoint, states: States) -> PerJoint:
        """Energy that is stored and given back, J."""
        z, slipped = self._split(states)
        return self.memory.energy(z) + self.stops.energy(angles, slipped)

    def dissipation(self, angles: PerJoint, rates: PerJoint, states: States) -> PerJoint:
        """Power that becomes heat, W."""
        z, slipped = self._split(states)
        return self.memory.dissipation(rates, z) + self.stops.dissipation(angles, rates, slipped)

    @property
    def stiffness(self) -> Float[Array, ""] | PerJoint:
        """Largest stiffness, N m/rad."""
        return self.memory.stiffness + self.stops.stiffness
