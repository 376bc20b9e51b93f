"""The inverse of an operator that has no formula for it: by bisection, step by step."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar
from ._operator import AbstractExactOperator, AbstractOperator, history_by_steps

# Each halves the bracket: after 60 of them it is below rounding.
_HALVINGS = 60

# So near to an end of the bracket, relative to its width, the end is the answer.
_EDGE = 1e-12


class InverseByBisection(AbstractExactOperator):
    """The input within a bracket whose output is nearest to the desired one, at each step.

    For operators whose output never falls when the input rises, such as Preisach's with a
    positive density. Where an output belongs to no input of the bracket, its nearest end is
    the answer.

    The answer is differentiable, by the implicit function theorem, where the operator's output
    rises there and the bracket does not end there.

    Arguments:
        operator: the operator to invert.
        lower, upper: bracket of its input.
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
