"""Play and stop: the elements of which the other operators are made.

Reference: M. Brokate, J. Sprekels, "Hysteresis and Phase Transitions", Springer 1996, ch. 2.
"""

from typing import Literal

import equinox as eqx
import jax
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import is_concrete, parameter
from ..quantities import PLAY, STOP
from ._operator import AbstractExactOperator

Method = Literal["scan", "associative"]
METHODS = ("scan", "associative")

# So many time steps are one turn of the loop: its own cost is then small beside theirs.
_UNROLL = 4


def clip(value: Array, lower: Array, upper: Array) -> Array:
    """Value within bounds; where it is at one of them the derivative is not lost.

    `lax.clamp` differentiates to 0 there, which is where a play is after every clipped step
    that is followed by a rest.
    """
    return jnp.minimum(jnp.maximum(value, lower), upper)


def play(
    inputs: Float[Array, " sample"],
    thresholds: Float[Array, " threshold"],
    state: Float[Array, " threshold"] | None = None,
    method: Method | None = None,
) -> Float[Array, "sample threshold"]:
    """Play operators of many thresholds: w_k = clip(w_{k-1}, u_k - r, u_k + r).

    Clips of clips are clips, so that the whole history can also be one associative scan. Both
    methods give the same bits; on a CPU the scan over time is many times faster.

    Arguments:
        inputs: shape (sample,).
        thresholds: r, not negative, in the unit of the input, shape (threshold,).
        state: w before the first sample, shape (threshold,); 0 by default.
        method: "scan" or "associative"; by default the first on a CPU.

    Returns:
        w after each sample, shape (sample, threshold).

    Raises:
        InputError: an unknown method.

    Example:
        >>> import jax.numpy as jnp
        >>> from giajax.hysteresis import play
        >>> play(jnp.asarray([0.0, 2.0, 1.0, -2.0]), jnp.asarray([0.5]))[:, 0].tolist()
        [0.0, 1.5, 1.5, -1.5]
    """
    if method is None:
        method = "scan" if jax.default_backend() == "cpu" else "associative"
    if method not in METHODS:
        raise InputError(f"there is no method '{method}': use one of {', '.join(METHODS)}")
    state = jnp.zeros_like(thresholds) if state is None else state
    if method == "scan":
        return _scan(inputs, thresholds, state)
    return _associative(inputs, thresholds, state)


def _scan(inputs: Array, thresholds: Array, state: Array) -> Array:
    def one(w: Array, u: Scalar) -> tuple[Array, Array]:
        w = clip(w, u - thresholds, u + thresholds)
        return w, w

    return jax.lax.scan(one, state, inputs, unroll=_UNROLL)[1]


def _associative(inputs: Array, thresholds: Array, state: Array) -> Array:
    lower = inputs[:, None] - thresholds[None]
    upper = inputs[:, None] + thresholds[None]

    def then(first: tuple[Array, Array], second: tuple[Array, Array]) -> tuple[Array, Array]:
        return clip(first[0], *second), clip(first[1], *second)

    lower, upper = jax.lax.associative_scan(then, (lower, upper))
    return clip(jnp.broadcast_to(state[None], lower.shape), lower, upper)


def stop(
    inputs: Float[Array, " sample"],
    thresholds: Float[Array, " threshold"],
    state: Float[Array, " threshold"] | None = None,
    method: Method | None = None,
) -> Float[Array, "sample threshold"]:
    """Stop operators of many thresholds, e = u - w: what the play of the same threshold leaves.

    Arguments:
        inputs, thresholds, method: as of `play`.
        state: that of the play, w, before the first sample; 0 by default.

    Returns:
        e after each sample, shape (sample, threshold).
    """
    return inputs[:, None] - play(inputs, thresholds, state, method)


class Play(AbstractExactOperator):
    """Play operators side by side: backlash of half-widths `thresholds`.

    Arguments:
        thresholds: half-widths, not negative, in the unit of the input, shape (threshold,).
    """

    thresholds: Float[Array, " threshold"] = parameter(PLAY.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def reset(self) -> Float[Array, " threshold"]:
        """All plays at 0."""
        return jnp.zeros_like(self.thresholds)

    def step(
        self, state: Float[Array, " threshold"], value: Scalar
    ) -> tuple[Float[Array, " threshold"], Float[Array, " threshold"]]:
        """Plays after the input has moved."""
        state = clip(state, value - self.thresholds, value + self.thresholds)
        return state, state

    def history(
        self, inputs: Float[Array, " sample"], state: Float[Array, " threshold"] | None = None
    ) -> tuple[Float[Array, "sample threshold"], Float[Array, " threshold"]]:
        """Plays at all samples."""
        outputs = play(inputs, self.thresholds, state)
        return outputs, outputs[-1]


class Stop(AbstractExactOperator):
    """Stop operators side by side: elastic up to `thresholds`, then sliding. Remembers plays.

    Arguments:
        thresholds: not negative, in the unit of the input, shape (threshold,).
    """

    thresholds: Float[Array, " threshold"] = parameter(STOP.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def reset(self) -> Float[Array, " threshold"]:
        """All elements unstrained."""
        return jnp.zeros_like(self.thresholds)

    def step(
        self, state: Float[Array, " threshold"], value: Scalar
    ) -> tuple[Float[Array, " threshold"], Float[Array, " threshold"]]:
        """Stops after the input has moved."""
        state = clip(state, value - self.thresholds, value + self.thresholds)
        return state, value - state

    def history(
        self, inputs: Float[Array, " sample"], state: Float[Array, " threshold"] | None = None
    ) -> tuple[Float[Array, "sample threshold"], Float[Array, " threshold"]]:
        """Stops at all samples."""
        plays = play(inputs, self.thresholds, state)
        return inputs[:, None] - plays, plays[-1]


def check_thresholds(thresholds: Array) -> None:
    """Refuse thresholds that are no list of numbers of at least 0.

    Raises:
        InputError: where the values are known, not while a program is traced.
    """
    if not eqx.is_array(thresholds) or not is_concrete(thresholds):
        return
    if thresholds.ndim != 1 or thresholds.shape[0] == 0:
        raise InputError(
            f"thresholds have the shape {thresholds.shape}: give a list of at least one number"
        )
    if not bool(jnp.all(jnp.isfinite(thresholds) & (thresholds >= 0))):
        raise InputError("a threshold is negative or not finite: give finite numbers of at least 0")
