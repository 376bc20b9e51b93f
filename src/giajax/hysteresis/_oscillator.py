"""A mass on a spring and a damper, with a Bouc-Wen element beside them: force in, motion out.

Reference: J. P. Noel, M. Schoukens, "Hysteretic benchmark with a dynamic nonlinearity", Workshop
on Nonlinear System Identification Benchmarks, Brussels 2016.
"""

import dataclasses
import math
from typing import Self

import equinox as eqx
import jax
import jax.numpy as jnp

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import parameter
from ..quantities import BOUC_WEN_OSCILLATOR
from ._bouc_wen import bouc_wen_rate

# Forces are kept for so many steps a sample, so that a finer solution needs no others.
MOST_STEPS = 16

State = Float[Array, "3"]


class BoucWenOscillator(eqx.Module):
    """mass y'' + damping y' + stiffness y + z = force, with z of the Bouc-Wen equation.

    Starts at rest. The defaults are those of the benchmark.

    Arguments:
        mass, damping, stiffness: of the linear part.
        alpha, beta, gamma, delta, nu: of z, as in `BoucWen`.
        steps: Runge-Kutta steps from one sample to the next, a divisor of `MOST_STEPS`.

    Raises:
        InputError: another number of steps.
    """

    mass: Scalar = parameter(BOUC_WEN_OSCILLATOR.mass)
    damping: Scalar = parameter(BOUC_WEN_OSCILLATOR.damping)
    stiffness: Scalar = parameter(BOUC_WEN_OSCILLATOR.stiffness)
    alpha: Scalar = parameter(BOUC_WEN_OSCILLATOR.alpha)
    beta: Scalar = parameter(BOUC_WEN_OSCILLATOR.beta)
    gamma: Scalar = parameter(BOUC_WEN_OSCILLATOR.gamma)
    delta: Scalar = parameter(BOUC_WEN_OSCILLATOR.delta)
    nu: Scalar = parameter(BOUC_WEN_OSCILLATOR.nu)
    steps: int = eqx.field(default=4, static=True)

    def __check_init__(self) -> None:
        if self.steps < 1 or MOST_STEPS % self.steps:
            raise InputError(
                f"{self.steps} steps a sample do not divide {MOST_STEPS}: choose 1, 2, 4, 8 or 16"
            )

    def rate(self, state: State, force: Scalar) -> State:
        """Time derivative of displacement (m), velocity (m/s) and hysteretic force (N)."""
        displacement, velocity, z = state
        pull = self.damping * velocity + self.stiffness * displacement + z
        return jnp.stack(
            [
                velocity,
                (force - pull) / self.mass,
                bouc_wen_rate(velocity, z, self.alpha, self.beta, self.gamma, self.delta, self.nu),
            ]
        )

    def refined(self, factor: float) -> Self:
        """With more steps, up to as many as there are forces for."""
        finer = 2 ** math.ceil(math.log2(max(self.steps * factor**-0.5, 1)))
        return dataclasses.replace(self, steps=min(finer, MOST_STEPS))

    def motion(
        self, forces: Float[Array, "sample half"], intervals: Float[Array, " sample"]
    ) -> Float[Array, "sample 3"]:
        """State at every sample, by classical Runge-Kutta steps from rest.

        The force is smooth within a step, and its values at the ends and in the middle are what
        the method uses: no interpolation enters here.

        Arguments:
            forces: N, at equal distances after the sample before, the last one at the sample
                itself; twice `MOST_STEPS` of them. The first row is not driven through: its last
                force is that at the first sample.
            intervals: s, from the sample before; the first one is not used.

        Returns:
            Displacement (m), velocity (m/s) and hysteretic force (N), shape (sample, 3).
        """
        samples, count = forces.shape
        stride = count // (2 * self.steps)
        middles = forces[1:, stride - 1 :: 2 * stride]
        ends = forces[1:, 2 * stride - 1 :: 2 * stride]
        widths = jnp.repeat(intervals[1:] / self.steps, self.steps)

        def one(carry: tuple[State, Scalar], row: tuple[Scalar, Scalar, Scalar]) -> tuple:
            state, force = carry
            middle, end, h = row
            first = self.rate(state, force)
            second = self.rate(state + h / 2 * first, middle)
            third = self.rate(state + h / 2 * second, middle)
            fourth = self.rate(state + h * third, end)
            state = state + h / 6 * (first + 2 * second + 2 * third + fourth)
            return (state, end), state

        rest = jnp.zeros(3, dtype=self.mass.dtype)
        rows = (middles.ravel(), ends.ravel(), widths)
        start = (rest, forces[0, -1])
        states: Array = jax.lax.scan(one, start, rows, unroll=self.steps)[1]
        by_sample = states.reshape(samples - 1, self.steps, 3)[:, -1]
        return jnp.concatenate([rest[None], by_sample])
