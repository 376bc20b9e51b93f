"""From a coordinate that a fit moves along to a parameter within its bounds, and back."""

from collections.abc import Sequence
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from .._maths import on_device
from .._typing import Array, Float

# Part of the distance between a start and its bound within which the coordinate is linear: so much
# that what was driven to its bound by mistake comes back as it went. With all of it a first step
# may lead to the bound, which costs kinked operators their optimum.
_NEAR = 0.5

# A start that is nearer to its bound than this part of the size of the parameter is at it.
_AT_BOUND = 1e-6


class Bijector(eqx.Module):
    """Smooth, increasing map of an interval of coordinates onto the one between two bounds.

    Far from a bound the coordinate is a logarithm of the distance from it, so that a step is a
    relative change and a poor model of the cost cannot send a parameter far. Near the bound it is
    linear in the parameter and ends there: a logarithm would go on for ever towards an optimum
    that is at the bound, and would bend every valley on the way. A parameter without bounds is
    its own coordinate.

    Arguments:
        lower, upper: bounds, infinite where there is none, shape (parameter,).
        above_lower, below_upper: distances from a bound up to which the coordinate is linear,
            shape (parameter,); not used where there is no bound.
        last: coordinates of the upper bounds, infinite where there is none, shape (parameter,).
    """

    lower: tuple[float, ...] = eqx.field(static=True)
    upper: tuple[float, ...] = eqx.field(static=True)
    above_lower: Float[Array, " parameter"]
    below_upper: Float[Array, " parameter"]
    last: Float[Array, " parameter"]

    @classmethod
    def of(
        cls,
        lower: Sequence[float],
        upper: Sequence[float],
        start: Sequence[float],
        size: npt.ArrayLike = 1.0,
    ) -> Self:
        """The map for a fit from a start.

        Arguments:
            lower, upper: bounds, infinite where there is none, shape (parameter,).
            start: of the parameters, shape (parameter,).
            size: typical size of each, which tells how near is near where the start is at its
                bound; shape (parameter,).
        """
        low, high, begun = (np.asarray(each, dtype=float) for each in (lower, upper, start))
        width = np.where(np.isfinite(low) & np.isfinite(high), high - low, np.inf)
        usual = np.minimum(size, width)

        def near(distance: np.ndarray) -> np.ndarray:
            known = np.isfinite(distance) & (distance > _AT_BOUND * usual)
            return np.asarray(_NEAR * np.where(known, distance, usual))

        linear = near(begun - low), near(high - begun)
        with np.errstate(invalid="ignore"):
            both = np.log1p(width / linear[0]) + np.log1p(width / linear[1])
        last = np.where(np.isfinite(high), np.where(np.isfinite(low), both, 0), np.inf)
        numbers = [on_device(each, jnp.result_type(float)) for each in (*linear, last)]
        return cls(tuple(low.tolist()), tuple(high.tolist()), *numbers)

    def at(self, columns: Sequence[int] | np.ndarray) -> "Bijector":
        """The map of some of the parameters, by their positions."""
        places = np.asarray(columns, dtype=int)
        return Bijector(
            tuple(self.lower[i] for i in places),
            tuple(self.upper[i] for i in places),
            self.above_lower[places],
            self.below_upper[places],
            self.last[places],
        )

    def _kinds(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        lower, upper = np.asarray(self.lower), np.asarray(self.upper)
        below, above = np.isfinite(lower), np.isfinite(upper)
        # Stand-ins that keep the branches which are not taken free of NaN.
        return below, above, np.where(below, lower, 0.0), np.where(above, upper, 1.0)

    def _near(self, maths: Any = np) -> tuple[Any, Any, Any]:
        """The distances, and how soon the upper bound is felt: near / (width + near), or 0."""
        below, above, lower, upper = self._kinds()
        low, high = maths.asarray(self.above_lower), maths.asarray(self.below_upper)
        return low, high, maths.where(below & above, low / (upper - lower + high), 0)

    def forward(self, coordinate: Float[Any, " parameter"]) -> Float[Any, " parameter"]:
        """Parameters at coordinates between those of their bounds; by NumPy for its arrays."""
        maths = np if isinstance(coordinate, np.ndarray) else jnp
        below, above, lower, upper = self._kinds()
        low, high, bend = self._near(maths)
        # Of what has no such bound exp(t) may overflow, in the branch that is not taken.
        t = maths.where(below, coordinate, 0)
        up = lower + low * maths.expm1(t) / (1 + bend * maths.exp(t))
        # Rounding must not lead beyond the bound; the slope there stays that of the map.
        beyond = maths.where(below & above, maths.maximum(up - upper, 0), 0)
        up = up - (beyond if maths is np else jax.lax.stop_gradient(beyond))
        t = maths.where(above & ~below, coordinate, 0)
        down = upper - high * maths.expm1(-t)
        return maths.where(below, up, maths.where(above, down, coordinate))

    def inverse(self, value: np.ndarray) -> np.ndarray:
        """Coordinates of parameters within the bounds."""
        below, above, lower, upper = self._kinds()
        value = np.asarray(value, dtype=float)
        low, high, bend = self._near()
        with np.errstate(all="ignore"):
            part = (value - lower) / low
            up = np.log1p(part) - np.log1p(-bend * part)
            down = -np.log1p((upper - value) / high)
        return np.where(below, up, np.where(above, down, value))

    def slope(self, coordinate: np.ndarray) -> np.ndarray:
        """d(parameter)/d(coordinate), shape (parameter,)."""
        below, above, _, _ = self._kinds()
        coordinate = np.asarray(coordinate, dtype=float)
        low, high, bend = self._near()
        with np.errstate(all="ignore"):
            grown = np.exp(coordinate)
            up = low * grown * (1 + bend) / (1 + bend * grown) ** 2
            down = high / grown
        return np.where(below, up, np.where(above, down, 1.0))

    def ends(self) -> tuple[Float[Any, " parameter"], Float[Any, " parameter"]]:
        """Coordinates of the lower and of the upper bounds, infinite where there is none."""
        first = np.where(np.isfinite(self.lower), 0.0, -np.inf)
        return np.asarray(first, self.last.dtype), self.last
