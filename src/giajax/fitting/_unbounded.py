"""From the real line to a parameter within its bounds, smoothly: what a sampler moves along."""

from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._maths import on_device
from .._typing import Array, Float

Row = Float[Array, " parameter"]

# In widths: what ended nearer to a bound is seen from here.
_INSIDE = 0.5

# Of the range of a parameter: its width is at most this, so that the two bounds are apart.
_MOST_OF_RANGE = 0.25


class Unbounded(eqx.Module):
    """Increasing map of all numbers onto the interval between two bounds, which it never meets.

    A fit may end on a bound, and so its own map (`Bijector`) does; a sampler that reached the end
    of it would have to turn back. This one is linear as long as a bound is many widths away, and
    bends into an exponential within one width of it: lower + width softplus(u), and with an upper
    bound as well lower + width (softplus(u) - softplus(u - range / width)).

    Attributes:
        lower, upper: bounds, infinite where there is none, shape (parameter,).
        width: how near to a bound is near, the standard error; shape (parameter,).
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    width: Row

    @classmethod
    def of(cls, lower: np.ndarray, upper: np.ndarray, width: np.ndarray) -> Self:
        """The map for bounds and a width each, which the range of the parameter limits."""
        limited = np.isfinite(lower) & np.isfinite(upper)
        ranges = np.where(limited, upper - lower, np.inf)
        narrow = np.minimum(width, _MOST_OF_RANGE * ranges)
        return cls(
            tuple(lower.tolist()), tuple(upper.tolist()), on_device(narrow, jnp.result_type(float))
        )

    def forward(self, u: Row) -> tuple[Row, Row, Row, Row]:
        """Parameters at some coordinates, and what a density becomes by them.

        Arguments:
            u: coordinates, shape (parameter,).

        Returns:
            Parameters; the logarithms of their derivatives by their coordinates; the first and the
            second derivatives of these logarithms, each of shape (parameter,).
        """
        below, above, lower, upper, end = self._kinds()
        plus, minus = jax.nn.softplus, jax.nn.log_sigmoid
        up = lower + self.width * (plus(u) - jnp.where(above, plus(u - end), 0))
        down = upper - self.width * (plus(end - u) - jnp.where(below, plus(-u), 0))
        # The form whose terms do not cancel: that of the nearer bound.
        from_below = below & (~above | (u < end / 2))
        value = jnp.where(from_below, up, jnp.where(above, down, self.width * u))
        # Rounding must not lead beyond a bound.
        value = jnp.clip(value, np.asarray(self.lower), np.asarray(self.upper))
        slope = jnp.log(self.width) + jnp.where(below, minus(u), 0)
        slope = slope + jnp.where(above, minus(end - u), 0)
        slope = slope + jnp.where(below & above, jnp.log1p(-jnp.exp(-end)), 0)
        near_lower, near_upper = jax.nn.sigmoid(-u), jax.nn.sigmoid(u - end)
        first = jnp.where(below, near_lower, 0) - jnp.where(above, near_upper, 0)
        second = -jnp.where(below, near_lower * (1 - near_lower), 0)
        second = second - jnp.where(above, near_upper * (1 - near_upper), 0)
        return value, slope, first, second

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Coordinates of parameters, those at a bound a little inside of it; by NumPy."""
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        width = np.asarray(self.width)
        value = np.clip(value, lower + _INSIDE * width, upper - _INSIDE * width)
        below, above = np.isfinite(lower), np.isfinite(upper)
        with np.errstate(all="ignore"):
            up, down, end = (
                (value - lower) / width,
                (upper - value) / width,
                (upper - lower) / width,
            )
            both = up + np.log(-np.expm1(-up)) - np.log(-np.expm1(up - end))
            up, down = (each + np.log(-np.expm1(-each)) for each in (up, down))
        return np.where(
            below & above, both, np.where(below, up, np.where(above, -down, value / width))
        )

    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Row]:
        """Which bounds there are, with stand-ins for those that are not; where the upper one is."""
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        below, above = np.isfinite(lower), np.isfinite(upper)
        lower, upper = np.where(below, lower, 0.0), np.where(above, upper, 0.0)
        end = jnp.where(below & above, (upper - lower) / self.width, 0)
        return below, above, lower, upper, end
