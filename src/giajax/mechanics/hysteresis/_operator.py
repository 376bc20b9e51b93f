"""Base classes of hysteresis operators, play and stop operators, and an inverse by bisection."""

import abc
from typing import Any, Literal, Self

import equinox as eqx
import jax
import jax.numpy as jnp

from ...runtime.arrays import Array, Float, Scalar, larger, smaller
from ...runtime.text import InputError
from ...schema import PLAY, STOP
from ...schema.parameters import is_concrete, parameter

PerThreshold = Float[Array, " threshold"]


class AbstractOperator(eqx.Module):
    """An operator whose output depends on the current input and on a memory of earlier inputs.

    The operators are rate-independent: the input changes monotonically between two samples, and its
    rate has no effect.
    """

    @abc.abstractmethod
    def reset(self) -> Any:
        """Return the memory of a virgin operator, whose input has always been 0."""

    @abc.abstractmethod
    def step(self, state: Any, value: Scalar) -> tuple[Any, Array]:
        """Return memory and output after the input has changed to a value.

        Arguments:
            state: memory before the change.
            value: new input.
        """

    @abc.abstractmethod
    def refined(self, factor: float) -> Self:
        """Return the operator with its numerical error multiplied by approximately `factor`."""

    @abc.abstractmethod
    def for_moves_of(self, width: float) -> Self:
        """Return an operator that is also accurate for single changes of the input by a width.

        The parameters must be concrete (not traced).

        Arguments:
            width: largest change of the input in one step, in the unit of the input.
        """

    @abc.abstractmethod
    def travelled(self, state: Any, value: Scalar) -> Any:
        """Return the memory after a change of the input that may be much larger than usual.

        Arguments:
            state: memory before the change.
            value: new input.
        """

    @abc.abstractmethod
    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, "sample *output"], Any]:
        """Return the outputs for an input history, one row per sample, and the final memory.

        Arguments:
            inputs: input at each sample.
            state: memory before the first sample; by default that of a virgin operator.

        Example:
            >>> import jax.numpy as jnp
            >>> from giajax.mechanics.hysteresis import PrandtlIshlinskii
            >>> operator = PrandtlIshlinskii(weights=[0.5], thresholds=[1.0])
            >>> outputs, memory = operator.history(jnp.asarray([0.0, 2.0, 0.0]))
            >>> outputs.tolist()
            [0.0, 2.5, 0.5]
        """


class AbstractExactOperator(AbstractOperator):
    """An operator without numerical error, whatever the size of a step."""

    def refined(self, factor: float) -> Self:
        """Return the operator unchanged, because it is exact."""
        return self

    def for_moves_of(self, width: float) -> Self:
        """Return the operator unchanged, because it is exact."""
        return self

    def travelled(self, state: Any, value: Scalar) -> Any:
        """Return the memory after a change of the input, computed in one step."""
        return self.step(state, value)[0]


def history_by_steps(
    operator: AbstractOperator, inputs: Float[Array, " sample"], state: Any
) -> tuple[Float[Array, "sample *output"], Any]:
    """Compute the history of an operator sample by sample, if there is no faster method."""
    state = operator.reset() if state is None else state

    def one(state: Any, value: Scalar) -> tuple[Any, Array]:
        return operator.step(state, value)

    state, outputs = jax.lax.scan(one, state, inputs)
    return outputs, state


# Play and stop: the elements of the other operators.
#
# Reference: M. Brokate, J. Sprekels, "Hysteresis and Phase Transitions", Springer 1996, ch. 2.

Method = Literal["scan", "associative"]
METHODS = ("scan", "associative")

_UNROLL = 4  # time steps per iteration of the loop, which makes the overhead of the loop small


def clip(value: Array, lower: Array, upper: Array) -> Array:
    """Limit a value to bounds, with a non-zero derivative if the value is equal to a bound.

    The derivative of `lax.clamp` is 0 there. A play is in this state after every clipped step that
    is followed by a constant input.
    """
    return smaller(larger(value, lower), upper)


def play(
    inputs: Float[Array, " sample"],
    thresholds: PerThreshold,
    state: PerThreshold | None = None,
    method: Method | None = None,
) -> Float[Array, "sample threshold"]:
    """Return play operators of several thresholds: w_k = clip(w_{k-1}, u_k - r, u_k + r).

    The composition of two clips is a clip, so the whole history can also be computed by an
    associative scan. Both methods give identical results. On a CPU, the scan over time is many
    times faster.

    Arguments:
        inputs: input u at each sample.
        thresholds: thresholds r >= 0, in the unit of the input.
        state: w before the first sample; 0 by default.
        method: "scan" or "associative"; by default "scan" on a CPU, otherwise "associative".

    Returns:
        w after each sample.

    Raises:
        InputError: an unknown method.

    Example:
        >>> import jax.numpy as jnp
        >>> from giajax.mechanics.hysteresis import play
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
    thresholds: PerThreshold,
    state: PerThreshold | None = None,
    method: Method | None = None,
) -> Float[Array, "sample threshold"]:
    """Return stop operators of several thresholds: e = u - w, with the play w of each threshold.

    The arguments are those of `play`. The state is the state w of the plays.
    """
    return inputs[:, None] - play(inputs, thresholds, state, method)


class AbstractPlays(AbstractExactOperator):
    """An operator whose memory consists of the plays of its thresholds."""

    @property
    @abc.abstractmethod
    def thresholds(self) -> PerThreshold:
        """Thresholds of the plays, in the unit of the input."""

    @abc.abstractmethod
    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return the outputs at one or more samples, from inputs and plays."""

    def reset(self) -> PerThreshold:
        """Return the memory of a virgin operator: all plays at 0."""
        return jnp.zeros_like(self.thresholds)

    def step(self, state: PerThreshold, value: Scalar) -> tuple[PerThreshold, Array]:
        """Return plays and output after the input has changed to a value."""
        state = clip(state, value - self.thresholds, value + self.thresholds)
        return state, self.output(value, state)

    def history(
        self, inputs: Float[Array, " sample"], state: PerThreshold | None = None
    ) -> tuple[Float[Array, "sample *output"], PerThreshold]:
        """Return the outputs at all samples and the final plays."""
        plays = play(inputs, self.thresholds, state)
        return self.output(inputs, plays), plays[-1]


class Play(AbstractPlays):
    """Parallel play operators: backlash of half-widths `thresholds`, in the unit of the input."""

    thresholds: PerThreshold = parameter(PLAY.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return the plays."""
        return plays


class Stop(AbstractPlays):
    """Parallel stop operators: elastic up to `thresholds`, then sliding.

    The memory consists of the plays.
    """

    thresholds: PerThreshold = parameter(STOP.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Return the inputs minus the plays."""
        return jnp.asarray(inputs)[..., None] - plays


def check_thresholds(thresholds: Array, weights: Array | None = None) -> None:
    """Check that thresholds are a list of numbers of at least 0, with one weight for each.

    Traced values are not checked.

    Raises:
        InputError: the thresholds or weights are not valid.
    """
    if eqx.is_array(thresholds) and is_concrete(thresholds):
        if thresholds.ndim != 1 or thresholds.shape[0] == 0:
            raise InputError(
                f"thresholds have the shape {thresholds.shape}: give a list of at least one number"
            )
        if not bool(jnp.all(jnp.isfinite(thresholds) & (thresholds >= 0))):
            raise InputError(
                "a threshold is negative or not finite: give finite numbers of at least 0"
            )
    if weights is not None and is_concrete(weights) and weights.shape != thresholds.shape:
        raise InputError(
            f"there are weights of shape {weights.shape} and thresholds of shape "
            f"{thresholds.shape}: give one weight for each threshold"
        )


_HALVINGS = 60  # bisection steps, after which the bracket is smaller than the rounding error
_EDGE = 1e-12  # distance from an end, relative to the bracket, within which the end is the answer


class InverseByBisection(AbstractExactOperator):
    """Inverse operator: at each step, the input in a bracket whose output is nearest to a value.

    The output of the operator must not decrease when its input increases, as for the Preisach
    operator with a positive density. If no input in the bracket gives the desired output, the
    result is the nearest end of the bracket.

    The result is differentiable by the implicit function theorem, if the output of the operator
    increases there and the result is not an end of the bracket.

    Attributes:
        operator: operator to be inverted.
        lower, upper: ends of the bracket, in the unit of the input of the operator.
    """

    operator: AbstractOperator
    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)

    def reset(self) -> Any:
        """Return the memory of the virgin operator."""
        return self.operator.reset()

    def step(self, state: Any, value: Scalar) -> tuple[Any, Scalar]:
        """Return the memory of the operator and its input at which the output is the value."""
        fixed, memory, goal = jax.lax.stop_gradient((self.operator, state, value))

        def halve(_: int, bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = bracket
            middle = (low + high) / 2
            above = fixed.step(memory, middle)[1] > goal
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        ends = jnp.full_like(goal, self.lower), jnp.full_like(goal, self.upper)
        low, high = jax.lax.fori_loop(0, _HALVINGS, halve, ends)
        root = self._differentiable(state, value, (low + high) / 2)
        return self.operator.step(state, root)[0], root

    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, " sample"], Any]:
        """Return the inputs of the operator at all samples, and the final memory."""
        return history_by_steps(self, inputs, state)

    def _differentiable(self, state: Any, value: Scalar, root: Scalar) -> Scalar:
        """Return the root with its derivative, from one Newton step whose value is 0."""

        def output(at: Scalar) -> Scalar:
            return self.operator.step(state, at)[1]

        miss = output(root) - value
        _, slope = jax.jvp(output, (root,), (jnp.ones_like(root),))
        slope = jax.lax.stop_gradient(slope)
        room = _EDGE * (self.upper - self.lower)
        inside = (root > self.lower + room) & (root < self.upper - room) & (slope > 0)
        step = (miss - jax.lax.stop_gradient(miss)) / jnp.where(inside, slope, 1)
        return root - jnp.where(inside, step, 0)
