"""An empirical law for muscles of any length: a largest force times one normalised shape."""

from typing import ClassVar

import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import EMPIRICAL
from ._muscle import AbstractMuscle


class EmpiricalMuscle(AbstractMuscle):
    """F = F_max(L) f(e, q), e = epsilon / contraction_limit, q = p / pressure_limit.

    F_max(L) = force_limit (2 / pi) atan((L - end_length) / length_scale) grows with the length L
    of the muscle at rest, because the ends do not pull, and saturates. The shape

        f(e, q) = q exp(-(bell e)^2) - exp(-bell^2) (1 - exp(-decay e)) / (1 - exp(-decay))

    is a passive part that does not depend on the pressure and an active part that is
    proportional to it. By construction f(0, 1) = 1 and f(1, 1) = 0: at the pressure limit the
    muscle pulls with F_max at rest and contracts by contraction_limit without a load.

    After Hunt, Graber-Tilton, Quinn, "Modeling length effects of braided pneumatic actuators",
    ASME IDETC 2017, with the coefficients of the shape tied by f(1, 1) = 0.
    """

    name: ClassVar[str] = "empirical"
    own_motion: ClassVar[int] = 1
    pushes: ClassVar[bool] = False

    force_limit: Scalar = parameter(EMPIRICAL.force_limit)
    contraction_limit: Scalar = parameter(EMPIRICAL.contraction_limit)
    bell: Scalar = parameter(EMPIRICAL.bell)
    decay: Scalar = parameter(EMPIRICAL.decay)
    end_length: Scalar = parameter(EMPIRICAL.end_length)
    length_scale: Scalar = parameter(EMPIRICAL.length_scale)
    pressure_limit: Scalar = parameter(EMPIRICAL.pressure_limit)

    @property
    def limit(self) -> Float[Array, ""]:
        """Highest pressure, Pa."""
        return self.pressure_limit

    def largest_force(self, length: Float[Array, ""]) -> Float[Array, ""]:
        """F_max of a muscle of this length at rest (m), N."""
        reach = jnp.maximum(length - self.end_length, 0) / self.length_scale
        return self.force_limit * (2 / jnp.pi) * jnp.arctan(reach)

    def _passive(self, strain: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        rise = jnp.expm1(-self.decay * strain) / jnp.expm1(-self.decay)
        return jnp.exp(-(self.bell**2)) * rise

    def signed_force(
        self,
        pressure: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> Float[Array, "*shape"]:
        """Force by the law, N; 0 or less without pressure."""
        strain = contraction / self.contraction_limit
        active = pressure / self.pressure_limit * jnp.exp(-((self.bell * strain) ** 2))
        return self.largest_force(length) * (active - self._passive(strain))

    def pressure_for(
        self,
        force: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Pressure for a force, Pa, and the force per pascal."""
        strain = contraction / self.contraction_limit
        largest = self.largest_force(length)
        gain = largest * jnp.exp(-((self.bell * strain) ** 2)) / self.pressure_limit
        lacking = force + largest * self._passive(strain)
        return lacking / jnp.where(gain > 0, gain, 1), gain
