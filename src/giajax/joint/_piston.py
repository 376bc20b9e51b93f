"""A pneumatic cylinder: the simplest actuator, and one with a public recording."""

from typing import ClassVar

import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import PISTON
from ._muscle import AbstractMuscle


class Piston(AbstractMuscle):
    """F = p A + offset, A = pi bore^2 / 4.

    Its force pushes outwards, and is of either sign, as a load cell shows it; its recorded position
    grows where it is pressed in.
    """

    name: ClassVar[str] = "piston"
    own_motion: ClassVar[int] = -1
    pushes: ClassVar[bool] = True

    bore: Scalar = parameter(PISTON.bore)
    offset: Scalar = parameter(PISTON.offset)
    pressure_limit: Scalar = parameter(PISTON.pressure_limit)

    @property
    def limit(self) -> Float[Array, ""]:
        """Highest pressure, Pa."""
        return self.pressure_limit

    @property
    def area(self) -> Float[Array, ""]:
        """Cross-section of the bore, m^2."""
        return jnp.pi / 4 * self.bore**2

    def signed_force(
        self,
        pressure: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> Float[Array, "*shape"]:
        """Force by the law, N."""
        return pressure * self.area + self.offset

    def pressure_for(
        self,
        force: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Pressure for a force, Pa, and the force per pascal."""
        return (force - self.offset) / self.area, jnp.broadcast_to(self.area, force.shape)
