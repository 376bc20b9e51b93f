"""Elastic springs in parallel that slide: hysteresis of a joint with sharp corners."""

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import parameter
from ..quantities import JOINT_STOPS

# Of the angles that a strain is the difference of, in units of their last place.
_ROUNDING = 16


class Stops(eqx.Module):
    """Elastic springs in parallel that slide, each from its own angle on: Iwan's model.

    The state of each is the angle at which it is without strain. It moves with the joint where
    the element slides, which is the play operator of `giajax.hysteresis`.

    Reference: W. D. Iwan, J. Appl. Mech. 33 (1966) 893-900.

    Arguments:
        strength: torque at which each slides, N m, shape (stop,) or () for one; None where joints
            have none.
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
        if self.strength is None:
            return 0
        return max(self.strength.size, self.yield_angle.size)

    @property
    def stiffness(self) -> Scalar:
        """Stiffness of all together where none slides, N m/rad."""
        if self.strength is None:
            return jnp.zeros(())
        return jnp.sum(jnp.broadcast_to(self.strength / self.yield_angle, (self.rows,)))

    def unstrained(self, angles: Float[Array, " joint"]) -> Float[Array, "row joint"]:
        """The states of a joint that was never moved from these angles (rad), rad."""
        return jnp.broadcast_to(angles, (self.rows, angles.size))

    def strain(
        self, angles: Float[Array, " joint"], slipped: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """Strain of each over its yield angle, between -1 and 1."""
        return jnp.clip((angles[None] - slipped) / self._yield_angles, -1, 1)

    def torque(
        self, angles: Float[Array, " joint"], slipped: Float[Array, "row joint"]
    ) -> Float[Array, " joint"]:
        """Torque against the strain, N m."""
        if self.strength is None:
            return jnp.zeros_like(angles)
        return jnp.sum(self._strengths * self.strain(angles, slipped), axis=0)

    def tangent(
        self,
        angles: Float[Array, " joint"],
        rates: Float[Array, " joint"],
        slipped: Float[Array, "row joint"],
    ) -> Float[Array, " joint"]:
        """Stiffness in one state: of those that do not slide on, N m/rad."""
        if self.strength is None:
            return jnp.zeros_like(angles)
        stiffness = self._strengths / self._yield_angles
        return jnp.sum(jnp.where(self._slides(angles, rates, slipped), 0, stiffness), axis=0)

    def dissipation(
        self,
        angles: Float[Array, " joint"],
        rates: Float[Array, " joint"],
        slipped: Float[Array, "row joint"],
    ) -> Float[Array, " joint"]:
        """Power that becomes heat where elements slide, W."""
        if self.strength is None:
            return jnp.zeros_like(angles)
        heat = self._strengths * jnp.abs(rates)[None]
        return jnp.sum(jnp.where(self._slides(angles, rates, slipped), heat, 0), axis=0)

    def caught_up(
        self, angles: Float[Array, " joint"], slipped: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """The states (rad) after a motion to these angles (rad) in one direction."""
        width = self._yield_angles
        return jnp.clip(slipped, angles[None] - width, angles[None] + width)

    def energy(
        self, angles: Float[Array, " joint"], slipped: Float[Array, "row joint"]
    ) -> Float[Array, " joint"]:
        """Energy of the strain, J."""
        if self.strength is None:
            return jnp.zeros_like(angles)
        stored = self._strengths * self._yield_angles * self.strain(angles, slipped) ** 2 / 2
        return jnp.sum(stored, axis=0)

    def _slides(self, angles: Array, rates: Array, slipped: Array) -> Bool[Array, "row joint"]:
        strain, width = angles[None] - slipped, self._yield_angles
        # One that slides is at its limit but for rounding.
        rounding = _ROUNDING * jnp.finfo(angles.dtype).eps * (jnp.abs(angles)[None] + width)
        return (jnp.abs(strain) > width - rounding) & (strain * rates[None] > 0)

    @property
    def _strengths(self) -> Float[Array, "row 1"]:
        return jnp.broadcast_to(jnp.asarray(self.strength), (self.rows,))[:, None]

    @property
    def _yield_angles(self) -> Float[Array, "row 1"]:
        return jnp.broadcast_to(self.yield_angle, (self.rows,))[:, None]
