"""The classical and the modified Prandtl-Ishlinskii operator, and their exact inverses.

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

# For an inverse, a piece is level if its slope is less than this fraction of the largest slope.
_LEVEL = 1e-6


class DeadZones(eqx.Module):
    """A piecewise linear curve S(x) without memory: a superposition of one-sided dead zones.

    Between the two thresholds nearest to 0, S(x) = slope x. Beyond each threshold, the slope has a
    new value. In the usual notation, the weight of a dead zone is the change in slope at its
    threshold. Here the slopes are the parameters, and S increases if all of them are positive.

    Arguments:
        slope: slope at 0.
        upper_thresholds: positive positions at which the slope changes.
        upper_slopes: slope beyond each upper threshold.
        lower_thresholds: positive distances below 0 at which the slope changes.
        lower_slopes: slope beyond each lower threshold.

    Raises:
        InputError: the number of slopes is not the number of thresholds, or a threshold is not
            positive.
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
                    f"the {name} dead zones have thresholds of shape {thresholds.shape} and slopes "
                    f"of shape {slopes.shape}: give one slope for each dead zone"
                )
            if not bool(jnp.all(thresholds > 0)):
                raise InputError(
                    f"a threshold of the {name} dead zones is not positive: give positive "
                    "distances from 0"
                )

    def __call__(self, x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the value of the curve at x."""
        above = _beyond(x, self.slope, self.upper_thresholds, self.upper_slopes)
        below = _beyond(-x, self.slope, self.lower_thresholds, self.lower_slopes)
        return self.slope * x + above - below

    def inverse(self) -> "DeadZones":
        """Return the inverse curve, which has the same form and jumps where this curve is level.

        Raises:
            InputError: a slope is negative, or no slope is positive.
        """
        slopes = jnp.concatenate([self.slope[None], self.upper_slopes, self.lower_slopes])
        if is_concrete(slopes) and not bool(jnp.all(slopes >= 0) & jnp.any(slopes > 0)):
            raise InputError(
                f"a dead zone has the slope {float(jnp.min(slopes)):.3g}, so it has no "
                "inverse: make at least one slope positive and none negative"
            )
        # A jump is represented by a very steep piece.
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
    """Return the excess of numbers over each threshold (at least 0), along a new last axis."""
    row = jnp.reshape(thresholds, (1,) * x.ndim + thresholds.shape)
    return larger(jnp.expand_dims(x, -1) - row, 0)


def _sorted(thresholds: Array, slopes: Array) -> tuple[Array, Array]:
    order = jnp.argsort(thresholds)
    return thresholds[order], slopes[order]


def _before(slope: Array, slopes: Array) -> Array:
    """Return the slope of the piece before each threshold."""
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
    """The operator y = elastic u + sum of weights times plays (or stops) of the input u.

    Arguments:
        elastic: weight w_0 of the element without memory, output per input.
        weights: weights w_i of the plays or stops, output per input.
        thresholds: thresholds r_i, in the unit of the input.
        elements: "play" or "stop".

    Raises:
        InputError: the lists have different lengths, or a threshold is negative.
    """

    elastic: Scalar = parameter(PRANDTL_ISHLINSKII.elastic)
    weights: PerThreshold = parameter(PRANDTL_ISHLINSKII.weights)
    thresholds: PerThreshold = parameter(PRANDTL_ISHLINSKII.thresholds)
    elements: Elements = eqx.field(default="play", static=True)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds, self.weights)
        if self.elements not in ELEMENTS:
            raise InputError(f"the elements '{self.elements}' are unknown: use play or stop")

    def of_plays(self) -> tuple[Scalar, PerThreshold]:
        """Return the elastic weight and the weights of the same operator expressed by plays.

        A stop is the input minus the play.
        """
        if self.elements == "play":
            return self.elastic, self.weights
        return self.elastic + jnp.sum(self.weights), -self.weights

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return the sum of the elastic part and the weighted plays."""
        elastic, weights = self.of_plays()
        return elastic * inputs + plays @ weights

    def loading(self, amplitude: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """Return the initial loading curve: output of the virgin operator for an increasing input.

        Arguments:
            amplitude: input, which has increased from 0.
        """
        elastic, weights = self.of_plays()
        return elastic * amplitude + _over(amplitude, self.thresholds) @ weights

    def inverse(self) -> Self:
        """Return the inverse operator, which is a Prandtl-Ishlinskii operator of plays.

        Its thresholds are the values of the loading curve at the thresholds of this operator, and
        its slopes are the reciprocals of the slopes. It is exact for any history, including minor
        loops.

        Raises:
            InputError: the loading curve does not increase everywhere, so several inputs have the
                same output.
        """
        elastic, weights = self.of_plays()
        order = jnp.argsort(self.thresholds)
        thresholds, weights = self.thresholds[order], weights[order]
        slopes = jnp.concatenate([elastic[None], elastic + jnp.cumsum(weights)])
        if is_concrete(slopes) and not bool(jnp.all(slopes > 0)):
            raise InputError(
                f"the slope of the loading curve decreases to {float(jnp.min(slopes)):.3g}, so the "
                "curve has no inverse: fit with a positive elastic weight"
            )
        # The loading curve at each threshold follows from the slopes of the pieces before it.
        lengths = jnp.diff(thresholds, prepend=jnp.zeros_like(thresholds[:1]))
        inverse_slopes = 1 / slopes
        return type(self)(
            elastic=inverse_slopes[0],
            weights=jnp.diff(inverse_slopes),
            thresholds=jnp.cumsum(slopes[:-1] * lengths),
            elements="play",
        )

    def inverse_state(self, state: PerThreshold) -> PerThreshold:
        """Return the memory of the inverse that corresponds to a memory of this operator."""
        elastic, weights = self.of_plays()
        order = jnp.argsort(self.thresholds)
        weights, state = weights[order], state[order]
        below = jnp.cumsum(weights)
        above = jnp.sum(weights * state) - jnp.cumsum(weights * state)
        return (elastic + below) * state + above


class ModifiedPrandtlIshlinskii(AbstractPlays):
    """The modified Prandtl-Ishlinskii operator y = S(H[u]).

    H is a Prandtl-Ishlinskii operator of plays, and S a curve without memory. The loops of H alone
    are symmetric and have the same shape at any offset of the input. S permits asymmetric loops and
    a soft region at a fixed angle of the joint.

    H = (u + sum of weights times plays) / (1 + sum of weights) is normalised to the slope 1 in
    large loops, because the scales of H and S cannot be separated.

    Arguments:
        dead_zones: curve S.
        weights: weights of the plays, relative to the weight of the input.
        thresholds: thresholds of the plays, in the unit of the input.

    Raises:
        InputError: the lists have different lengths, or a threshold is negative.
    """

    dead_zones: DeadZones
    weights: PerThreshold = parameter(MODIFIED_PRANDTL_ISHLINSKII.weights)
    thresholds: PerThreshold = parameter(MODIFIED_PRANDTL_ISHLINSKII.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds, self.weights)

    @property
    def hysteresis(self) -> PrandtlIshlinskii:
        """The operator H."""
        total = 1 + jnp.sum(self.weights)
        return PrandtlIshlinskii(1 / total, self.weights / total, self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return S of the outputs of H."""
        return self.dead_zones(self.hysteresis.output(inputs, plays))

    def inverse(self) -> "InverseModified":
        """Return the inverse operator: the inverse of S, followed by the inverse of H.

        Raises:
            InputError: H or S does not increase everywhere.
        """
        return InverseModified(self.dead_zones.inverse(), self.hysteresis.inverse())

    def inverse_state(self, state: PerThreshold) -> PerThreshold:
        """Return the memory of the inverse that corresponds to a memory of this operator."""
        return self.hysteresis.inverse_state(state)


class InverseModified(AbstractExactOperator):
    """The exact inverse u = H^-1[S^-1(y)] of a modified Prandtl-Ishlinskii operator.

    Attributes:
        dead_zones: inverse of S.
        hysteresis: inverse of H.
    """

    dead_zones: DeadZones
    hysteresis: PrandtlIshlinskii

    def reset(self) -> Any:
        """Return the memory of a virgin operator: all plays at 0."""
        return self.hysteresis.reset()

    def step(self, state: Any, value: Scalar) -> tuple[Any, Scalar]:
        """Return plays and output after the input has changed to a value."""
        return self.hysteresis.step(state, self.dead_zones(value))

    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, " sample"], Any]:
        """Return the outputs at all samples and the final plays."""
        return self.hysteresis.history(self.dead_zones(inputs), state)
