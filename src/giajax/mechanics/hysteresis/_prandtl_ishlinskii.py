"""The Prandtl-Ishlinskii operator, of either kind, and its exact inverse.

References: K. Kuhnen, "Modeling, identification and compensation of complex hysteretic
nonlinearities: a modified Prandtl-Ishlinskii approach", Eur. J. Control 9 (2003) 407-418;
P. Krejci, K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. 148
(2001) 185-192.
"""

from typing import Any, Literal, Self

import equinox as eqx
import jax.numpy as jnp

from ...runtime.arrays import Array, Float, Scalar, larger
from ...runtime.text import InputError
from ...schema import DEAD_ZONES, MODIFIED_PRANDTL_ISHLINSKII, PRANDTL_ISHLINSKII
from ...schema.parameters import is_concrete, parameter
from ._operator import AbstractExactOperator, AbstractPlays, PerThreshold, check_thresholds

# A piece whose slope is less than this part of the largest is level, as far as an inverse goes.
_LEVEL = 1e-6


class DeadZones(eqx.Module):
    """S(x) = slope x between the dead zones nearest to 0, with a slope of its own beyond each.

    A memoryless, monotone, piecewise linear curve: a superposition of one-sided dead zones. In the
    usual notation the weight of a dead zone is the change of the slope at its threshold. Here the
    slopes are the parameters: S increases where all of them are positive.

    Arguments:
        slope: at 0.
        upper_thresholds, upper_slopes: positive, where the slope changes, and that beyond each.
        lower_thresholds, lower_slopes: distances below 0, positive, and the slopes beyond them.

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
                    f"a threshold of the {name} dead zones is not positive: give positive "
                    f"distances from 0"
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
                f"a dead zone has the slope {float(jnp.min(slopes)):.3g}, so that it has no "
                f"inverse: make at least one slope positive and none negative"
            )
        # A jump is a piece that is very steep.
        least = _LEVEL * jnp.max(slopes)
        slope, upper, lower = (
            larger(each, least) for each in (self.slope, self.upper_slopes, self.lower_slopes)
        )
        return DeadZones(
            1 / slope,
            *_inverted(slope, self.upper_thresholds, upper),
            *_inverted(slope, self.lower_thresholds, lower),
        )


def _over(x: Array, thresholds: Float[Array, " n"]) -> Array:
    """By how much numbers are over each threshold, along a new last axis."""
    row = jnp.reshape(thresholds, (1,) * x.ndim + thresholds.shape)
    return larger(jnp.expand_dims(x, -1) - row, 0)


def _sorted(thresholds: Array, slopes: Array) -> tuple[Array, Array]:
    order = jnp.argsort(thresholds)
    return thresholds[order], slopes[order]


def _before(slope: Array, slopes: Array) -> Array:
    """Slope of the piece before each threshold."""
    return jnp.concatenate([slope[None], slopes[:-1]])


def _beyond(x: Array, slope: Array, thresholds: Array, slopes: Array) -> Array:
    thresholds, slopes = _sorted(thresholds, slopes)
    return _over(x, thresholds) @ (slopes - _before(slope, slopes))


def _inverted(slope: Array, thresholds: Array, slopes: Array) -> tuple[Array, Array]:
    thresholds, slopes = _sorted(thresholds, slopes)
    lengths = jnp.diff(thresholds, prepend=jnp.zeros_like(thresholds[:1]))
    return jnp.cumsum(_before(slope, slopes) * lengths), 1 / slopes


Elements = Literal["play", "stop"]
ELEMENTS = ("play", "stop")


class PrandtlIshlinskii(AbstractPlays):
    """y = elastic u + sum of weights times plays (or stops) of the input.

    Arguments:
        elastic: w_0, output per input of the element without memory.
        weights: w_i, output per input.
        thresholds: r_i, in the unit of the input.
        elements: "play" or "stop".

    Raises:
        InputError: lists of different lengths, or a negative threshold.
    """

    elastic: Scalar = parameter(PRANDTL_ISHLINSKII.elastic)
    weights: PerThreshold = parameter(PRANDTL_ISHLINSKII.weights)
    thresholds: PerThreshold = parameter(PRANDTL_ISHLINSKII.thresholds)
    elements: Elements = eqx.field(default="play", static=True)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds, self.weights)
        if self.elements not in ELEMENTS:
            raise InputError(f"there are no elements '{self.elements}': use play or stop")

    def of_plays(self) -> tuple[Scalar, PerThreshold]:
        """Elastic weight and weights of the same operator written with plays.

        A stop is the input less the play.
        """
        if self.elements == "play":
            return self.elastic, self.weights
        return self.elastic + jnp.sum(self.weights), -self.weights

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """The elastic part, and the weighted plays."""
        elastic, weights = self.of_plays()
        return elastic * inputs + plays @ weights

    def loading(self, amplitude: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The initial loading curve: output of the virgin operator on the way up from 0."""
        elastic, weights = self.of_plays()
        return elastic * amplitude + _over(amplitude, self.thresholds) @ weights

    def inverse(self) -> Self:
        """The operator that undoes this one, a Prandtl-Ishlinskii operator of plays.

        Its thresholds are the loading curve at the thresholds, its slopes the inverse slopes:
        exact for any history, minor loops included.

        Raises:
            InputError: the loading curve does not increase everywhere, so that one output
                belongs to several inputs.
        """
        elastic, weights = self.of_plays()
        order = jnp.argsort(self.thresholds)
        thresholds, weights = self.thresholds[order], weights[order]
        slopes = jnp.concatenate([elastic[None], elastic + jnp.cumsum(weights)])
        if is_concrete(slopes) and not bool(jnp.all(slopes > 0)):
            raise InputError(
                f"the slope of the loading curve decreases to {float(jnp.min(slopes)):.3g}, which "
                f"has "
                "no inverse: fit with a positive elastic weight"
            )
        # The loading curve at each threshold, from the slope of each piece before it.
        lengths = jnp.diff(thresholds, prepend=jnp.zeros_like(thresholds[:1]))
        inverse_slopes = 1 / slopes
        return type(self)(
            elastic=inverse_slopes[0],
            weights=jnp.diff(inverse_slopes),
            thresholds=jnp.cumsum(slopes[:-1] * lengths),
            elements="play",
        )

    def inverse_state(self, state: PerThreshold) -> PerThreshold:
        """Memory of the inverse that belongs to a memory of this operator."""
        elastic, weights = self.of_plays()
        order = jnp.argsort(self.thresholds)
        weights, state = weights[order], state[order]
        below = jnp.cumsum(weights)
        above = jnp.sum(weights * state) - jnp.cumsum(weights * state)
        return (elastic + below) * state + above


class ModifiedPrandtlIshlinskii(AbstractPlays):
    """y = S(H[u]): a memoryless curve of the output of a Prandtl-Ishlinskii operator of plays.

    H alone is odd and does not know where 0 is; S is neither: it gives loops without symmetry,
    and a region that is soft at an angle fixed on the joint.

    H = (u + sum of weights times plays) / (1 + sum of weights) has the slope 1 in large loops,
    because its scale and that of S cannot be separated.

    Arguments:
        dead_zones: S.
        weights: of the plays, relative to that of the input.
        thresholds: of the plays, in the unit of the input.

    Raises:
        InputError: lists of different lengths, or a negative threshold.
    """

    dead_zones: DeadZones
    weights: PerThreshold = parameter(MODIFIED_PRANDTL_ISHLINSKII.weights)
    thresholds: PerThreshold = parameter(MODIFIED_PRANDTL_ISHLINSKII.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds, self.weights)

    @property
    def hysteresis(self) -> PrandtlIshlinskii:
        """H."""
        total = 1 + jnp.sum(self.weights)
        return PrandtlIshlinskii(1 / total, self.weights / total, self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """The curve of the outputs of H."""
        return self.dead_zones(self.hysteresis.output(inputs, plays))

    def inverse(self) -> "InverseModified":
        """The operator that undoes this one: first the inverse curve, then the inverse of H.

        Raises:
            InputError: H or S does not increase everywhere.
        """
        return InverseModified(self.dead_zones.inverse(), self.hysteresis.inverse())

    def inverse_state(self, state: PerThreshold) -> PerThreshold:
        """Memory of the inverse that belongs to a memory of this operator."""
        return self.hysteresis.inverse_state(state)


class InverseModified(AbstractExactOperator):
    """u = H^-1[S^-1(y)]: the exact inverse of a modified operator, of inverses of S and H."""

    dead_zones: DeadZones
    hysteresis: PrandtlIshlinskii

    def reset(self) -> Any:
        """All plays at 0."""
        return self.hysteresis.reset()

    def step(self, state: Any, value: Scalar) -> tuple[Any, Scalar]:
        """Plays and output after the input has moved."""
        return self.hysteresis.step(state, self.dead_zones(value))

    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, " sample"], Any]:
        """Outputs at all samples."""
        return self.hysteresis.history(self.dead_zones(inputs), state)
