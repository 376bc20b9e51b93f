"""Braided muscles: the statics of Chou and Hannaford, as Tondu and Lopez write them."""

from typing import ClassVar

import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import BRAIDED
from ._muscle import AbstractMuscle


class BraidedMuscle(AbstractMuscle):
    """F = eta (p - p_0) A [a (1 - k epsilon)^2 - b], a = 3 / tan^2(theta), b = 1 / sin^2(theta).

    A is the cross-section and theta the braid angle (from the axis) at rest. The ideal law
    (eta = k = 1, p_0 = 0) is virtual work of the gas in a cylinder of inextensible threads. Thin
    muscles of 18 deg contract by 20 to 25 % where it says 39 %: their ends do not widen, and the
    tube takes part of the pressure. k, the end correction, shortens the contraction (k = 1.6
    gives 24.6 %); p_0 is the dead band in which the tube does not yet press on the braid; eta,
    the effectiveness, covers what is left. Force alone does not separate A from eta.

    Chou, Hannaford, IEEE Trans. Robotics and Automation 12 (1996) 90; Tondu, Lopez, IEEE Control
    Systems 20 (2000) 15.
    """

    name: ClassVar[str] = "braided"
    own_motion: ClassVar[int] = 1
    pushes: ClassVar[bool] = False

    diameter: Scalar = parameter(BRAIDED.diameter)
    braid_angle: Scalar = parameter(BRAIDED.braid_angle)
    end_correction: Scalar = parameter(BRAIDED.end_correction)
    effectiveness: Scalar = parameter(BRAIDED.effectiveness)
    dead_band: Scalar = parameter(BRAIDED.dead_band)
    pressure_limit: Scalar = parameter(BRAIDED.pressure_limit)

    @property
    def limit(self) -> Float[Array, ""]:
        """Highest pressure, Pa."""
        return self.pressure_limit

    @property
    def largest_contraction(self) -> Float[Array, ""]:
        """Contraction at which the force vanishes at any pressure."""
        return (1 - 1 / (jnp.sqrt(3.0) * jnp.cos(self.braid_angle))) / self.end_correction

    def _per_pascal(self, contraction: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        area = jnp.pi / 4 * self.diameter**2
        # A muscle that k has used up does not pull again: the square must not grow on.
        left = jnp.maximum(1 - self.end_correction * contraction, 0)
        shrunk = 3 / jnp.tan(self.braid_angle) ** 2 * left**2
        return self.effectiveness * area * (shrunk - 1 / jnp.sin(self.braid_angle) ** 2)

    def signed_force(
        self,
        pressure: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> Float[Array, "*shape"]:
        """Force by the law, N."""
        return jnp.maximum(pressure - self.dead_band, 0) * self._per_pascal(contraction)

    def pressure_for(
        self,
        force: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Pressure for a force, Pa, and the force per pascal."""
        gain = self._per_pascal(contraction)
        return self.dead_band + force / jnp.where(gain > 0, gain, 1), gain
