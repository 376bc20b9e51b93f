"""The inverse of an operator that has no formula for it: by bisection, step by step."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from .._typing import Scalar
from ._operator import AbstractOperator

# Each halves the bracket: after 60 of them it is below rounding.
_HALVINGS = 60


class InverseByBisection(AbstractOperator):
    """The input within a bracket whose output is nearest to the wanted one, at each step.

    For operators whose output never falls when the input rises, such as Preisach's with a
    positive density. Where an output belongs to no input of the bracket, the end of it is given.

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

        def halve(_: int, bracket: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
            low, high = bracket
            middle = (low + high) / 2
            above = self.operator.step(state, middle)[1] > value
            return jnp.where(above, low, middle), jnp.where(above, middle, high)

        ends = jnp.full_like(value, self.lower), jnp.full_like(value, self.upper)
        low, high = jax.lax.fori_loop(0, _HALVINGS, halve, ends)
        found = (low + high) / 2
        return self.operator.step(state, found)[0], found
