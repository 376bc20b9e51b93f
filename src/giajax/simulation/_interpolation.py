"""Interpolation between two steps of a motion whose accelerations are known."""

from typing import Any

import diffrax
import jax.numpy as jnp

from .._typing import Array, Float, Scalar

State = Float[Array, "row joint"]


class QuinticInterpolation(diffrax.AbstractLocalInterpolation):
    """Angles by the polynomial through angles, rates and accelerations at both ends of a step.

    The rates are its slope. Both are of the fifth order, as the method is; the interpolation that
    Kennedy and Carpenter give is of the third. States beside these are cubic.
    """

    t0: Scalar  # type: ignore[misc]
    t1: Scalar  # type: ignore[misc]
    y0: State
    y1: State
    f0: State
    f1: State

    def evaluate(self, t0: Any, t1: Any | None = None, left: bool = True) -> State:
        """The state at a time, or the change between two."""
        del left
        if t1 is not None:
            return self.evaluate(t1) - self.evaluate(t0)
        step = self.t1 - self.t0
        # A step of no length occurs between corners that differ by rounding.
        step = jnp.where(step == 0, 1, step)
        x = (t0 - self.t0) / step
        start, end = self.y0[0], self.y1[0]
        v0, v1 = step * self.y0[1], step * self.y1[1]
        a0, a1 = step**2 * self.f0[1], step**2 * self.f1[1]
        # What is left to reach at the end after a motion with the acceleration of the start.
        angle, rate, bend = end - start - v0 - a0 / 2, v1 - v0 - a0, a1 - a0
        c3 = 10 * angle - 4 * rate + bend / 2
        c4 = -15 * angle + 7 * rate - bend
        c5 = 6 * angle - 3 * rate + bend / 2
        angles = start + x * (v0 + x * (a0 / 2 + x * (c3 + x * (c4 + x * c5))))
        rates = v0 + x * (a0 + x * (3 * c3 + x * (4 * c4 + x * 5 * c5)))
        moved = jnp.stack([angles, rates / step])
        if self.y0.shape[0] == 2:
            return moved
        start, end = self.y0[2:], self.y1[2:]
        v0, v1 = step * self.f0[2:], step * self.f1[2:]
        c2, c3 = 3 * (end - start) - 2 * v0 - v1, v0 + v1 - 2 * (end - start)
        return jnp.concatenate([moved, start + x * (v0 + x * (c2 + x * c3))])
