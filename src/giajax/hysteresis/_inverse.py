"""The inverse of an operator that has no formula for it: by bisection, step by step."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Scalar
from ._operator import AbstractOperator

# Each halves the bracket: after 60 of them it is below rounding.
_HALVINGS = 60

# So near to an end of the bracket, relative to its width, the end is the answer.
_EDGE = 1e-12


class InverseByBisection(AbstractOperator):
    """The input within a bracket whose output is nearest to the wanted one, at each step.

    For operators whose output never falls when the input rises, such as Preisach's with a
    positive density. Where an output belongs to no input of the bracket, the end of it is given.

    Arguments:
        operator: the operator to invert.
        lower, upper: bracket of its input.
    The input is differentiable: by the implicit function theorem, where the operator's output
    rises at it and the bracket does not end there.
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
        found = self._differentiable(state, value, (low + high) / 2)
        return self.operator.step(state, found)[0], found

    def _differentiable(self, state: Any, value: Scalar, found: Scalar) -> Scalar:
        """The root with its derivative: one Newton step, whose value is 0."""

        def output(at: Scalar) -> Scalar:
            return self.operator.step(state, at)[1]

        miss = output(found) - value
        _, slope = jax.jvp(output, (found,), (jnp.ones_like(found),))
        slope = jax.lax.stop_gradient(slope)
        room = _EDGE * (self.upper - self.lower)
        inside = (found > self.lower + room) & (found < self.upper - room) & (slope > 0)
        step = (miss - jax.lax.stop_gradient(miss)) / jnp.where(inside, slope, 1)
        return found - jnp.where(inside, step, 0)
