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
        """

    def refined(self, factor: float) -> Self:
        """The same operator with its numerical error multiplied by about a factor; most are exact.

        Arguments:
            factor: positive, below 1 for a smaller error.
        """
        return self

    def for_moves_of(self, width: float) -> Self:
        """The same operator, accurate also for single moves of a width; most are exact.

        The parameters must be known (no tracers).
        """
        return self

    def travelled(self, state: Any, value: Scalar) -> Any:
        """Memory after a move that may be much longer than those between two samples."""
        return self.step(state, value)[0]

    def history(
        self, inputs: Float[Array, " sample"], state: Any = None
    ) -> tuple[Float[Array, "sample *output"], Any]:
        """Outputs of a whole input history, one row a sample, and the memory at its end.

        Arguments:
            inputs: shape (sample,).
            state: memory before the first sample; virgin by default.

        Example:
            >>> import jax.numpy as jnp
            >>> from giajax.hysteresis import PrandtlIshlinskii
            >>> operator = PrandtlIshlinskii(weights=[0.5], thresholds=[1.0])
            >>> outputs, memory = operator.history(jnp.asarray([0.0, 2.0, 0.0]))
            >>> outputs.tolist()
            [0.0, 2.5, 0.5]
        """
        state = self.reset() if state is None else state

        def one(state: Any, value: Scalar) -> tuple[Any, Array]:
            return self.step(state, value)

        state, outputs = jax.lax.scan(one, state, inputs)
        return outputs, state
