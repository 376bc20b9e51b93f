"""What all hysteresis operators share: memory, one step, a whole history, and forgetting."""

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
    """An operator whose output depends on the input now and on what it remembers.

    The operators are rate-independent: between two samples the input goes monotonically from one
    to the other, and nothing depends on how fast.
    """

    @abc.abstractmethod
    def reset(self) -> Any:
        """The memory of a virgin operator, whose input has always been 0."""

    @abc.abstractmethod
    def step(self, state: Any, value: Scalar) -> tuple[Any, Array]:
        """Memory and output after the input has moved to a value, from an earlier memory."""

    @abc.abstractmethod
    def refined(self, factor: float) -> Self:
        """The same operator with its numerical error multiplied by about a factor."""

    @abc.abstractmethod
    def for_moves_of(self, width: float) -> Self:
        """The same operator, accurate also for single moves of a width, in the unit of the input.

        The parameters must be known (no tracers).
        """

    @abc.abstractmethod
    def travelled(self, state: Any, value: Scalar) -> Any:
        """Memory after a move to a value that may be much longer than those between samples."""

    @abc.abstractmethod
    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, "sample *output"], Any]:
        """Outputs of a whole input history, one row a sample, and the memory at its end.

        `state` is the memory before the first sample; virgin by default.

        Example:
            >>> import jax.numpy as jnp
            >>> from giajax.mechanics.hysteresis import PrandtlIshlinskii
            >>> operator = PrandtlIshlinskii(weights=[0.5], thresholds=[1.0])
            >>> outputs, memory = operator.history(jnp.asarray([0.0, 2.0, 0.0]))
            >>> outputs.tolist()
            [0.0, 2.5, 0.5]
        """


class AbstractExactOperator(AbstractOperator):
    """An operator without numerical error, however long a move is."""

    def refined(self, factor: float) -> Self:
        """The same."""
        return self

    def for_moves_of(self, width: float) -> Self:
        """The same."""
        return self

    def travelled(self, state: Any, value: Scalar) -> Any:
        """Memory after the move, in one step."""
        return self.step(state, value)[0]


def history_by_steps(
    operator: AbstractOperator, inputs: Float[Array, " sample"], state: Any
) -> tuple[Float[Array, "sample *output"], Any]:
    """The history of an operator for which nothing is faster than one step after the other."""
    state = operator.reset() if state is None else state

    def one(state: Any, value: Scalar) -> tuple[Any, Array]:
        return operator.step(state, value)

    state, outputs = jax.lax.scan(one, state, inputs)
    return outputs, state


# Play and stop: the elements of which the other operators are made.
#
# Reference: M. Brokate, J. Sprekels, "Hysteresis and Phase Transitions", Springer 1996, ch. 2.

Method = Literal["scan", "associative"]
METHODS = ("scan", "associative")

_UNROLL = 4  # so many time steps are one turn of the loop: its own cost is then small beside theirs


def clip(value: Array, lower: Array, upper: Array) -> Array:
    """Value within bounds; where it is at one of them the derivative is not lost.

    `lax.clamp` differentiates to 0 there, which is where a play is after every clipped step
    that is followed by a rest.
    """
    return smaller(larger(value, lower), upper)


def play(
    inputs: Float[Array, " sample"],
    thresholds: PerThreshold,
    state: PerThreshold | None = None,
    method: Method | None = None,
) -> Float[Array, "sample threshold"]:
    """Play operators of many thresholds: w_k = clip(w_{k-1}, u_k - r, u_k + r).

    Clips of clips are clips, so that the whole history can also be one associative scan. Both
    methods give the same bits; on a CPU the scan over time is many times faster.

    Arguments:
        thresholds: r, not negative, in the unit of the input.
        state: w before the first sample; 0 by default.
        method: "scan" or "associative"; by default the first on a CPU.

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
    """Stop operators of many thresholds, e = u - w: what the play of the same threshold leaves.

    Arguments as of `play`: the state is that of the play, w.
    """
    return inputs[:, None] - play(inputs, thresholds, state, method)


class AbstractPlays(AbstractExactOperator):
    """An operator that remembers plays of its thresholds, and nothing else."""

    @property
    @abc.abstractmethod
    def thresholds(self) -> PerThreshold:
        """Of the plays, in the unit of the input."""

    @abc.abstractmethod
    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """Outputs at one sample or at many."""

    def reset(self) -> PerThreshold:
        """All plays at 0."""
        return jnp.zeros_like(self.thresholds)

    def step(self, state: PerThreshold, value: Scalar) -> tuple[PerThreshold, Array]:
        """Plays and output after the input has moved."""
        state = clip(state, value - self.thresholds, value + self.thresholds)
        return state, self.output(value, state)

    def history(
        self, inputs: Float[Array, " sample"], state: PerThreshold | None = None
    ) -> tuple[Float[Array, "sample *output"], PerThreshold]:
        """Outputs at all samples."""
        plays = play(inputs, self.thresholds, state)
        return self.output(inputs, plays), plays[-1]


class Play(AbstractPlays):
    """Play operators side by side: backlash of half-widths `thresholds`, in the input's unit."""

    thresholds: PerThreshold = parameter(PLAY.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """The plays."""
        return plays


class Stop(AbstractPlays):
    """Stop operators side by side: elastic up to `thresholds`, then sliding. Remembers plays."""

    thresholds: PerThreshold = parameter(STOP.thresholds)

    def __check_init__(self) -> None:
        check_thresholds(self.thresholds)

    def output(
        self, inputs: Float[Array, "*sample"], plays: Float[Array, "*sample threshold"]
    ) -> Array:
        """What the plays leave."""
        return jnp.asarray(inputs)[..., None] - plays


def check_thresholds(thresholds: Array, weights: Array | None = None) -> None:
    """Refuse thresholds that are not a list of numbers of at least 0, or have other weights.

    Raises:
        InputError: where the values are known, not while a program is traced.
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


_HALVINGS = 60  # each halves the bracket: after 60 of them it is below rounding
_EDGE = 1e-12  # so near to an end of the bracket, relative to its width, the end is the answer


class InverseByBisection(AbstractExactOperator):
    """The input within a bracket whose output is nearest to the desired one, at each step.

    For operators whose output never falls when the input rises, such as Preisach's with a
    positive density. Where an output belongs to no input of the bracket, its nearest end is
    the answer.

    The answer is differentiable, by the implicit function theorem, where the operator's output
    rises there and the bracket does not end there.
    """

    operator: AbstractOperator
    lower: float = eqx.field(static=True)
    upper: float = eqx.field(static=True)

    def reset(self) -> Any:
        """The memory of the operator."""
        return self.operator.reset()

    def step(self, state: Any, value: Scalar) -> tuple[Any, Scalar]:
        """Memory of the operator after its input moved to where its output is the value."""
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
        """Outputs at all samples."""
        return history_by_steps(self, inputs, state)

    def _differentiable(self, state: Any, value: Scalar, root: Scalar) -> Scalar:
        """The root with its derivative: one Newton step, whose value is 0."""

        def output(at: Scalar) -> Scalar:
            return self.operator.step(state, at)[1]

        miss = output(root) - value
        _, slope = jax.jvp(output, (root,), (jnp.ones_like(root),))
        slope = jax.lax.stop_gradient(slope)
        room = _EDGE * (self.upper - self.lower)
        inside = (root > self.lower + room) & (root < self.upper - room) & (slope > 0)
        step = (miss - jax.lax.stop_gradient(miss)) / jnp.where(inside, slope, 1)
        return root - jnp.where(inside, step, 0)
