"""From an unbounded coordinate to a parameter within its bounds, and back."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._typing import Array, Float


class Bijector(eqx.Module):
    """Smooth, increasing map of the real line onto the open interval between two bounds.

    Two bounds: a logistic curve. One bound: an exponential, so that a step of the coordinate is
    a relative change of the parameter. None: the identity.

    Arguments:
        lower, upper: bounds, infinite where there is none, shape (parameter,).
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)

    def at(self, columns: Sequence[int] | np.ndarray) -> "Bijector":
        """The map of some of the parameters, by their positions."""
        return Bijector(
            tuple(self.lower[i] for i in columns), tuple(self.upper[i] for i in columns)
        )

    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        below, above = np.isfinite(lower), np.isfinite(upper)
        # Stand-ins that keep the branches which are not taken free of NaN.
        return below, above, np.where(below, lower, 0.0), np.where(above, upper, 1.0)

    def forward(self, coordinate: Float[Array, " parameter"]) -> Float[Array, " parameter"]:
        """Parameters at unbounded coordinates."""
        below, above, lower, upper = self._kinds()
        two = lower + (upper - lower) * jax.nn.sigmoid(coordinate)
        one = jnp.where(below, lower + jnp.exp(coordinate), upper - jnp.exp(-coordinate))
        return jnp.where(below & above, two, jnp.where(below | above, one, coordinate))

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Coordinates of parameters strictly within the bounds."""
        below, above, lower, upper = self._kinds()
        value = np.asarray(value, dtype=float)
        with np.errstate(all="ignore"):
            two = np.log(value - lower) - np.log(upper - value)
            one = np.where(below, np.log(value - lower), -np.log(upper - value))
        return np.where(below & above, two, np.where(below | above, one, value))

    def slope(self, coordinate: np.ndarray) -> np.ndarray:
        """d(parameter)/d(coordinate), shape (parameter,)."""
        below, above, lower, upper = self._kinds()
        coordinate = np.asarray(coordinate, dtype=float)
        with np.errstate(all="ignore"):
            logistic = 1 / (1 + np.exp(-coordinate))
            two = (upper - lower) * logistic * (1 - logistic)
            one = np.where(below, np.exp(coordinate), np.exp(-coordinate))
        return np.where(below & above, two, np.where(below | above, one, 1.0))
