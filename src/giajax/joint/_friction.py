"""Friction of a muscle or a cylinder: the difference between filling and exhausting."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..hysteresis import stop
from ..parameters import parameter
from ..quantities import FRICTION


class Friction(eqx.Module):
    """Coulomb friction whose half-width depends on the pressure.

    Where the motion is recorded, friction is a stop operator of the displacement: after the
    motion turns back, the force runs linearly from one side of the loop to the other within
    twice `presliding`. A sign of the velocity would jump there with every flicker of noise, and
    would have no derivative.

    Arguments:
        pressures: of the half-widths, increasing, Pa; between them they are
            linear, beyond them constant.
        half_width: half of the force between the two directions, N, shape (node,).
        presliding: displacement from rest to full friction, m.
    """

    half_width: Float[Array, " node"] = parameter(FRICTION.half_width)
    presliding: Scalar = parameter(FRICTION.presliding)
    pressures: tuple[float, ...] = eqx.field(default=(0.0,), static=True)

    def __check_init__(self) -> None:
        if np.any(np.diff(self.pressures) <= 0) or not self.pressures:
            raise InputError("the pressures of friction do not increase: sort them, each once")

    @classmethod
    def at_pressures(cls, pressures: tuple[float, ...]) -> "Friction":
        """The default friction, with one half-width for each pressure (Pa)."""
        default = cls()
        return cls(
            half_width=jnp.full(len(pressures), default.half_width),
            presliding=default.presliding,
            pressures=pressures,
        )

    def width(self, pressure: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """Half-width at pressures (Pa), N."""
        nodes = jnp.asarray(self.pressures, dtype=pressure.dtype)
        return jnp.interp(pressure, nodes, self.half_width)

    def engagement(self, displacement: Float[Array, " sample"]) -> Float[Array, " sample"]:
        """Share of the friction that resists a history of displacements (m), from -1 to 1.

        +1 where the displacement grows; the first sample is at rest.
        """
        thresholds = jnp.atleast_1d(self.presliding)
        return stop(displacement - displacement[0], thresholds)[:, 0] / self.presliding
