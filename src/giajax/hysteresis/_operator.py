"""What all hysteresis operators share: memory, one step, a whole history, and forgetting."""

import abc
from typing import Any, Self

import equinox as eqx
import jax

from .._typing import Array, Float, Scalar


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
        """Memory and output after the input has moved to a value.

        Arguments:
            state: memory, as `reset` or an earlier step gave it.
            value: the new input, shape ().

        Returns:
            The memory and the output after the move.
        """

    @abc.abstractmethod
    def refined(self, factor: float) -> Self:
        """The same operator with its numerical error multiplied by about a factor.

        Arguments:
            factor: positive, below 1 for a smaller error.
        """

    @abc.abstractmethod
    def for_moves_of(self, width: float) -> Self:
        """The same operator, accurate also for single moves of a width.

        The parameters must be known (no tracers).

        Arguments:
            width: of a move, in the unit of the input.
        """

    @abc.abstractmethod
    def travelled(self, state: Any, value: Scalar) -> Any:
        """Memory after a move that may be much longer than those between two samples.

        Arguments:
            state: memory before the move.
            value: the input after it, shape ().

        Returns:
            The memory after it.
        """

    @abc.abstractmethod
    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, "sample *output"], Any]:
        """Outputs of a whole input history, one row a sample, and the memory at its end.

        Arguments:
            inputs: shape (sample,).
            state: memory before the first sample; virgin by default.

        Returns:
            Outputs, one row a sample, and the memory at the end.

        Example:
            >>> import jax.numpy as jnp
            >>> from giajax.hysteresis import PrandtlIshlinskii
            >>> operator = PrandtlIshlinskii(weights=[0.5], thresholds=[1.0])
            >>> outputs, memory = operator.history(jnp.asarray([0.0, 2.0, 0.0]))
            >>> outputs.tolist()
            [0.0, 2.5, 0.5]
        """


class AbstractExactOperator(AbstractOperator):
    """An operator without numerical error, however long a move is."""

    def refined(self, factor: float) -> Self:
        """The same."""
        del factor
        return self

    def for_moves_of(self, width: float) -> Self:
        """The same."""
        del width
        return self

    def travelled(self, state: Any, value: Scalar) -> Any:
        """Memory after the move, in one step."""
        return self.step(state, value)[0]


def history_by_steps(
    operator: AbstractOperator, inputs: Float[Array, " sample"], state: Any
) -> tuple[Float[Array, "sample *output"], Any]:
    """The history of an operator for which nothing is faster than one step after the other.

    Arguments:
        operator: the operator.
        inputs: shape (sample,).
        state: memory before the first sample; None for that of the virgin operator.

    Returns:
        Outputs, one row a sample, and the memory at the end.
    """
    state = operator.reset() if state is None else state

    def one(state: Any, value: Scalar) -> tuple[Any, Array]:
        return operator.step(state, value)

    state, outputs = jax.lax.scan(one, state, inputs)
    return outputs, state
