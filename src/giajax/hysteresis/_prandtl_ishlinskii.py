"""The Prandtl-Ishlinskii operator, of either kind, and its exact inverse.

References: K. Kuhnen, "Modeling, identification and compensation of complex hysteretic
nonlinearities: a modified Prandtl-Ishlinskii approach", Eur. J. Control 9 (2003) 407-418;
P. Krejci, K. Kuhnen, "Inverse control of systems with hysteresis and creep", IEE Proc. 148
(2001) 185-192.
"""

from typing import Literal, Self

import equinox as eqx
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import is_concrete, parameter
from ..quantities import PRANDTL_ISHLINSKII
from ._dead_zones import per_row
from ._operator import AbstractExactOperator
from ._play import check_thresholds, clip, play

Elements = Literal["play", "stop"]
ELEMENTS = ("play", "stop")


class PrandtlIshlinskii(AbstractExactOperator):
    """y = elastic u + sum of weights times plays (or stops) of the input.

    Arguments:
        elastic: w_0, output per input of the element without memory.
        weights: w_i, output per input, shape (threshold,).
        thresholds: r_i, in the unit of the input, shape (threshold,).
        elements: "play" or "stop".

    Raises:
        InputError: lists of different lengths, or a negative threshold.
    """

    elastic: Scalar = parameter(PRANDTL_ISHLINSKII.elastic)
    weights: Float[Array, " threshold"] = parameter(PRANDTL_ISHLINSKII.weights)
    thresholds: Float[Array, " threshold"] = parameter(PRANDTL_ISHLINSKII.thresholds)
    elements: Elements = eqx.field(default="play", static=True)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)
        if self.elements not in ELEMENTS:
            raise InputError(f"there are no elements '{self.elements}': use play or stop")
        if is_concrete(self.weights) and self.weights.shape != self.thresholds.shape:
            raise InputError(
                f"there are weights of shape {self.weights.shape} and thresholds of shape "
                f"{self.thresholds.shape}: give one weight for each threshold"
            )

    def of_plays(self) -> tuple[Scalar, Float[Array, " threshold"]]:
        """Elastic weight and weights of the same operator written with plays.

        A stop is the input less the play.
        """
        if self.elements == "play":
            return self.elastic, self.weights
        return self.elastic + jnp.sum(self.weights), -self.weights

    def reset(self) -> Float[Array, " threshold"]:
        """All plays at 0."""
        return jnp.zeros_like(self.thresholds)

    def step(
        self, state: Float[Array, " threshold"], value: Scalar
    ) -> tuple[Float[Array, " threshold"], Scalar]:
        """Plays and output after the input has moved."""
        elastic, weights = self.of_plays()
        state = clip(state, value - self.thresholds, value + self.thresholds)
        return state, elastic * value + weights @ state

    def history(
        self, inputs: Float[Array, " sample"], state: Float[Array, " threshold"] | None = None
    ) -> tuple[Float[Array, " sample"], Float[Array, " threshold"]]:
        """Outputs at all samples."""
        elastic, weights = self.of_plays()
        plays = play(inputs, self.thresholds, state)
        return elastic * inputs + plays @ weights, plays[-1]

    def loading(self, amplitude: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
        """The initial loading curve: output of the virgin operator on the way up from 0."""
        elastic, weights = self.of_plays()
        over = jnp.maximum(jnp.expand_dims(amplitude, -1) - per_row(self.thresholds, amplitude), 0)
        return elastic * amplitude + over @ weights

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
                f"the slope of the loading curve falls to {float(jnp.min(slopes)):.3g}, which has "
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

    def inverse_state(self, state: Float[Array, " threshold"]) -> Float[Array, " threshold"]:
        """Memory of the inverse that belongs to a memory of this operator."""
        elastic, weights = self.of_plays()
        order = jnp.argsort(self.thresholds)
        weights, state = weights[order], state[order]
        below = jnp.cumsum(weights)
        above = jnp.sum(weights * state) - jnp.cumsum(weights * state)
        return (elastic + below) * state + above
