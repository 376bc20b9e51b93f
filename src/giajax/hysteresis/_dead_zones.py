"""A memoryless, monotone, piecewise linear curve: a superposition of one-sided dead zones.

Reference: K. Kuhnen, Eur. J. Control 9 (2003) 407-418.
"""

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import is_concrete, parameter
from ..quantities import DEAD_ZONES

# A piece whose slope is less than this part of the largest is level, as far as an inverse goes.
_LEVEL = 1e-6


class DeadZones(eqx.Module):
    """S(x) = slope x between the dead zones nearest to 0, with a slope of its own beyond each.

    In the usual notation the weight of a dead zone is the change of the slope at its threshold.
    Here the slopes are the parameters: S increases where all of them are positive.

    Arguments:
        slope: at 0.
        upper_thresholds: positive, where the slope changes, shape (upper,).
        upper_slopes: slope beyond each of them, shape (upper,).
        lower_thresholds: distances below 0, positive, shape (lower,).
        lower_slopes: slope beyond each of them, shape (lower,).

    Raises:
        InputError: a list of slopes that is not as long as its thresholds, or a threshold that
            is not positive.
    """

    slope: Scalar = parameter(DEAD_ZONES.slope)
    upper_thresholds: Float[Array, " upper"] = parameter(DEAD_ZONES.upper_thresholds)
    upper_slopes: Float[Array, " upper"] = parameter(DEAD_ZONES.upper_slopes)
    lower_thresholds: Float[Array, " lower"] = parameter(DEAD_ZONES.lower_thresholds)
    lower_slopes: Float[Array, " lower"] = parameter(DEAD_ZONES.lower_slopes)

    def __check_init__(self) -> None:
        for name in ("upper", "lower"):
            thresholds = getattr(self, f"{name}_thresholds")
            slopes = getattr(self, f"{name}_slopes")
            if not is_concrete((thresholds, slopes)):
                continue
            if thresholds.shape != slopes.shape or thresholds.ndim != 1:
                raise InputError(
                    f"there are {name} dead zones of shape {thresholds.shape} and slopes of shape "
                    f"{slopes.shape}: give one slope for each dead zone"
                )
            if not bool(jnp.all(thresholds > 0)):
                raise InputError(
                    f"a threshold of the {name} dead zones is not positive: give distances from 0"
                )

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The curve at x."""
        above = _beyond(x, self.slope, self.upper_thresholds, self.upper_slopes)
        below = _beyond(-x, self.slope, self.lower_thresholds, self.lower_slopes)
        return self.slope * x + above - below

    def inverse(self) -> "DeadZones":
        """The curve that undoes this one, of the same form; where this one is level, it jumps.

        Raises:
            InputError: a slope below 0, or none above.
        """
        slopes = jnp.concatenate([self.slope[None], self.upper_slopes, self.lower_slopes])
        if is_concrete(slopes) and not bool(jnp.all(slopes >= 0) & jnp.any(slopes > 0)):
            raise InputError(
                f"a dead zone has the slope {float(jnp.min(slopes)):.3g}, without an "
                "inverse: make no slope negative, and one positive"
            )
        # A jump is a piece that is very steep.
        least = _LEVEL * jnp.max(slopes)
        slope, upper, lower = (
            jnp.maximum(each, least) for each in (self.slope, self.upper_slopes, self.lower_slopes)
        )
        return DeadZones(
            1 / slope,
            *_inverted(slope, self.upper_thresholds, upper),
            *_inverted(slope, self.lower_thresholds, lower),
        )


def per_row(values: Float[Array, " n"], x: Array) -> Array:
    """Values along a new last axis, beside any number of axes of x."""
    return jnp.reshape(values, (1,) * x.ndim + values.shape)


def _sorted(thresholds: Array, slopes: Array) -> tuple[Array, Array]:
    order = jnp.argsort(thresholds)
    return thresholds[order], slopes[order]


def _before(slope: Array, slopes: Array) -> Array:
    """Slope of the piece before each threshold."""
    return jnp.concatenate([slope[None], slopes[:-1]])


def _beyond(x: Array, slope: Array, thresholds: Array, slopes: Array) -> Array:
    thresholds, slopes = _sorted(thresholds, slopes)
    over = jnp.maximum(jnp.expand_dims(x, -1) - per_row(thresholds, x), 0)
    return over @ (slopes - _before(slope, slopes))


def _inverted(slope: Array, thresholds: Array, slopes: Array) -> tuple[Array, Array]:
    thresholds, slopes = _sorted(thresholds, slopes)
    lengths = jnp.diff(thresholds, prepend=jnp.zeros_like(thresholds[:1]))
    return jnp.cumsum(_before(slope, slopes) * lengths), 1 / slopes
