"""Bouc-Wen hysteresis: differential equation, operator and oscillator.

References: Y.-K. Wen, J. Eng. Mech. Div. 102 (1976) 249-263; J. P. Noel, M. Schoukens,
"Hysteretic benchmark with a dynamic nonlinearity", Workshop on Nonlinear System Identification
Benchmarks, Brussels 2016, whose notation is used.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any, Self

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.scipy.special import spence

from ...runtime.arrays import Array, Bool, Float, Scalar, limited
from ...runtime.text import InputError
from ...schema import BOUC_WEN, BOUC_WEN_OSCILLATOR
from ...schema.parameters import parameter
from ._operator import AbstractOperator, history_by_steps


def bouc_wen_rate(
    velocity: Float[Array, "*shape"],
    z: Float[Array, "*shape"],
    alpha: Float[Array, "*shape"],
    beta: Float[Array, "*shape"],
    gamma: Float[Array, "*shape"],
    delta: Float[Array, "*shape"],
    nu: Float[Array, "*shape"],
) -> Float[Array, "*shape"]:
    """Return dz/dt = alpha v - beta (gamma |v| |z|^(nu-1) z + delta v |z|^nu).

    Here v is the rate of the input.
    """
    # This form of |z|^(nu-1) is differentiable at z = 0, where a motion starts.
    zero = z == 0
    power = jnp.where(zero, 1, jnp.abs(z)) ** (nu - 1)
    power = jnp.where(zero & (nu != 1), 0, power)
    return alpha * velocity - beta * power * (
        gamma * jnp.abs(velocity) * z + delta * velocity * jnp.abs(z)
    )


@eqx.filter_custom_jvp
def bouc_wen_after(
    ways: Float[Array, "leg *shape"], z: Float[Array, "*shape"], nu: Scalar, delta: Scalar
) -> Float[Array, "*shape"]:
    """Return z after successive motions, each of which has one direction.

    This is the integral of `bouc_wen_rate` over the displacement, which does not depend on the
    rate. With nu = 1 and delta = 0 (Dahl model), the solution is an exponential function.
    Otherwise, the equation is integrated numerically with an error of at most 5e-5, except at the
    sharp knee of a large nu. This takes thirty times as long.

    Arguments:
        ways: successive displacements divided by the yield angle, with the sign of the direction.
        z: value before the motions.
        nu, delta: parameters as in `BoucWen`, where alpha and beta are 1 and gamma is 1 - delta.
    """

    def exponential() -> Array:
        after = z
        for way in ways:
            sign = _sign(way)
            after = sign - (sign - after) * jnp.exp(-sign * way)
        return after

    def integrated() -> Array:
        return jax.lax.scan(lambda z, way: (_leg(way, z, nu, delta), None), z, ways)[0]

    # One branch serves all motions, because a branch costs more than the exponentials.
    return jax.lax.cond(_is_dahl(nu, delta), exponential, integrated)


@bouc_wen_after.def_jvp
def _bouc_wen_after_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Compute the partial derivatives of each motion once, for any number of tangents."""
    ways, z, nu, delta = primals
    shaped = [index for index in (2, 3) if tangents[index] is not None]
    wanted = [0, 1, *shaped]

    def exponential() -> tuple[Array, ...]:
        def one(z: Array, way: Array) -> tuple[Array, tuple[Array, ...]]:
            sign = _sign(way)
            way, before = sign * way, sign * z
            kept = jnp.exp(-way)
            after = 1 - (1 - before) * kept
            of_shape = {2: _dahl_by_nu, 3: _dahl_by_delta}
            by_shape = (sign * of_shape[index](way, before, after, kept) for index in shaped)
            return sign * after, (1 - after, kept, *by_shape)

        return jax.lax.scan(one, z, ways)[1]

    def integrated() -> tuple[Array, ...]:
        def one(z: Array, way: Array) -> tuple[Array, tuple[Array, ...]]:
            def along(index: int, by: Array) -> Array:
                given = [way, z, nu, delta]
                given[index] = by
                return _leg(*given)

            slopes = []
            for index in wanted:
                at = (way, z, nu, delta)[index]
                of_one = functools.partial(along, index)
                after, slope = jax.jvp(of_one, (at,), (jnp.ones_like(at),))
                slopes.append(slope)
            return after, tuple(slopes)

        return jax.lax.scan(one, z, ways)[1]

    slopes = jax.lax.cond(_is_dahl(nu, delta), exponential, integrated)
    (by_way, by_z), by_shape = slopes[:2], slopes[2:]
    of_ways, moved = (
        jnp.zeros_like(at) if tangent is None else tangent
        for at, tangent in zip((ways, z), tangents[:2], strict=True)
    )
    for leg in range(len(ways)):
        moved = by_z[leg] * moved + by_way[leg] * of_ways[leg]
        for index, slopes in zip(shaped, by_shape, strict=True):
            moved = moved + slopes[leg] * tangents[index]
    return bouc_wen_after(*primals), moved


# Derivatives of z with respect to delta and nu at the Dahl model. In a displacement x in the
# direction in which z increases, z increases from y0 to y = 1 - (1 - y0) e^-x. A derivative d obeys
# d' = -d + min(2 y, 0) for delta and d' = -d - y ln|y| for nu. The first solution is elementary,
# and the second is in closed form with the dilogarithm Li2.


def _dahl_by_delta(way: Array, before: Array, after: Array, kept: Array) -> Array:
    del after
    # Displacement up to the point at which z is 0.
    falling = limited(jnp.log1p(-jnp.where(before < 0, before, 0)), 0, way)
    return 2 * kept * (jnp.expm1(falling) - (1 - before) * falling)


def _dahl_by_nu(way: Array, before: Array, after: Array, kept: Array) -> Array:
    dilogarithms = _dilogarithm(after) - _dilogarithm(before)
    return (1 - after) * (way + dilogarithms) - _y_log_y(after) + kept * _y_log_y(before)


def _y_log_y(y: Array) -> Array:
    return y * jnp.log(jnp.where(y == 0, 1, jnp.abs(y)))


def _dilogarithm(y: Array) -> Array:
    """Return the real part of Li2(1 - y) for y <= 1."""
    negative = y < 0
    # Beyond the branch point, the inversion formula gives it from the value at 1 / (1 - y).
    inner = spence(jnp.where(negative, -y / (1 - y), y))
    return jnp.where(negative, jnp.pi**2 / 3 - jnp.log(1 - y) ** 2 / 2 - inner, inner)


def _sign(way: Array) -> Array:
    return jnp.where(way < 0, -1.0, 1.0)


@eqx.filter_custom_jvp
def _is_dahl(nu: Scalar, delta: Scalar) -> Bool[Array, ""]:
    """Return whether nu is 1 and delta is 0.

    The result is False where nu or delta is differentiated a second time, because the closed form
    holds only at the Dahl model.
    """
    return (nu == 1) & (delta == 0)


@_is_dahl.def_jvp
def _is_dahl_jvp(primals: Any, tangents: Any) -> tuple[Array, None]:
    held = all(tangent is None for tangent in tangents)
    return _is_dahl(*primals) & held, None


def _leg(way: Array, z: Array, nu: Scalar, delta: Scalar) -> Array:
    """Return z after one motion, by numerical integration."""
    most, one = _FULL + _DECAY / nu, jnp.ones_like(nu)
    width = limited(way, -most, most) / _STEPS
    return _by_steps(lambda z: bouc_wen_rate(width, z, one, one, 1 - delta, delta, nu), z, _STEPS)


def _by_steps(slope: Callable[[Array], Array], z: Array, count: int) -> Array:
    """Return z after `count` classical Runge-Kutta steps.

    Arguments:
        slope: derivative of z, multiplied by the width of a step, as a function of z.
        z: initial value.
        count: number of steps.
    """

    def one(_: int, z: Array) -> Array:
        first = slope(z)
        second = slope(z + first / 2)
        third = slope(z + second / 2)
        fourth = slope(z + third)
        return z + (first + 2 * second + 2 * third + fourth) / 6

    # The number of iterations is static, so both modes of differentiation are available.
    return jax.lax.fori_loop(0, count, one, z)


# The integration is limited to `_FULL` + `_DECAY` / nu yield angles, beyond which z has converged,
# and uses `_STEPS` steps.
_FULL, _DECAY, _STEPS = 2.0, 24.0, 32

_LONG = 200  # substeps of a change of the input by up to the whole range

# Substeps within the width of the knee in an inverse. The error of RK4 is then about 1e-5.
_PER_KNEE = 4.0
_MOST = 4000

# Largest width of a substep, in units of the width of the knee. A larger substep is inaccurate, and
# one above 2.8 is unstable.
_COARSE = 2.0


class BoucWen(AbstractOperator):
    """The operator y = elastic u + z, where z obeys the Bouc-Wen equation with the input u.

    A history determines only the products beta gamma and beta delta. All three parameters are kept
    because the literature uses them.

    Arguments:
        elastic: output per input of the part without memory.
        alpha: slope of z at z = 0.
        beta, gamma, delta: shape of the loop; if nu is 1, the unit of beta is 1/input.
        nu: sharpness of the knee.
        substeps: number of Runge-Kutta steps between two samples.

    Raises:
        InputError: there are fewer than 1 substeps.
    """

    elastic: Scalar = parameter(BOUC_WEN.elastic)
    alpha: Scalar = parameter(BOUC_WEN.alpha)
    beta: Scalar = parameter(BOUC_WEN.beta)
    gamma: Scalar = parameter(BOUC_WEN.gamma)
    delta: Scalar = parameter(BOUC_WEN.delta)
    nu: Scalar = parameter(BOUC_WEN.nu)
    substeps: int = eqx.field(default=4, static=True)

    def __check_init__(self) -> None:
        if self.substeps < 1:
            raise InputError(f"the operator has {self.substeps} substeps: give at least 1")

    def refined(self, factor: float) -> Self:
        """Return the operator with more substeps, as for a method of fourth order."""
        return dataclasses.replace(self, substeps=int(np.ceil(self.substeps * factor**-0.25)))

    def stiffness(self, z: Scalar) -> Scalar:
        """Return the decay rate of z, 1/input: beta (|gamma| + |delta|) nu |z|^(nu-1)."""
        size = jnp.maximum(jnp.abs(z), jnp.finfo(z.dtype).tiny)
        factor = self.beta * (jnp.abs(self.gamma) + jnp.abs(self.delta)) * self.nu
        return factor * size ** (self.nu - 1)

    def for_moves_of(self, width: float) -> Self:
        """Return the operator with the number of substeps that a change by `width` requires."""
        fine = dataclasses.replace(self, substeps=_LONG)
        end = jnp.asarray(width, dtype=self.elastic.dtype)
        _, z = fine.travelled(fine.reset(), end)
        needed = _PER_KNEE * width * float(self.stiffness(z))
        if not needed < _MOST:
            raise InputError(
                f"the knee of the Bouc-Wen operator is too narrow for an input change of {width:g} "
                "(SI): fit a smaller beta, gamma or nu"
            )
        return dataclasses.replace(self, substeps=max(self.substeps, int(np.ceil(needed))))

    def travelled(self, state: tuple[Scalar, Scalar], value: Scalar) -> tuple[Scalar, Scalar]:
        """Return the memory after a change of the input that may be much larger than usual."""
        return dataclasses.replace(self, substeps=max(self.substeps, _LONG)).step(state, value)[0]

    def too_coarse(
        self, inputs: Float[Array, " sample"], outputs: Float[Array, " sample"]
    ) -> Bool[Array, ""]:
        """Return whether the substeps are too large for the largest change in a history.

        Arguments:
            inputs: input at each sample.
            outputs: outputs of `history` for these inputs.
        """
        z = jnp.max(jnp.abs(outputs - self.elastic * inputs))
        longest = jnp.max(jnp.abs(jnp.diff(inputs)), initial=0)
        return longest * self.stiffness(z) > _COARSE * self.substeps

    def reset(self) -> tuple[Scalar, Scalar]:
        """Return the memory of a virgin operator: input and z at 0."""
        return jnp.zeros_like(self.elastic), jnp.zeros_like(self.elastic)

    def step(
        self, state: tuple[Scalar, Scalar], value: Scalar
    ) -> tuple[tuple[Scalar, Scalar], Scalar]:
        """Return the memory (input and z) and the output after the input has changed to a value.

        The equation does not depend on the rate of the input, so it is integrated over the input.
        """
        before, z = state
        width = (value - before) / self.substeps

        def slope(z: Scalar) -> Scalar:
            return bouc_wen_rate(width, z, self.alpha, self.beta, self.gamma, self.delta, self.nu)

        z = _by_steps(slope, z, self.substeps)
        return (value, z), self.elastic * value + z

    def history(
        self, inputs: Float[Array, " sample"], state: tuple[Scalar, Scalar] | None = None
    ) -> tuple[Float[Array, " sample"], tuple[Scalar, Scalar]]:
        """Return the outputs at all samples and the final memory."""
        return history_by_steps(self, inputs, state)


# Forces are stored for this number of steps per sample, so that a finer solution can use them.
MOST_STEPS = 16

State = Float[Array, "3"]


class BoucWenOscillator(eqx.Module):
    """Oscillator mass y'' + damping y' + stiffness y + z = force with Bouc-Wen hysteresis z.

    The mass starts at rest. The default values are those of the benchmark.

    Arguments:
        mass: mass, kg.
        damping: damping, N s/m.
        stiffness: stiffness, N/m.
        alpha, beta, gamma, delta, nu: parameters of z, as in `BoucWen`.
        steps: number of Runge-Kutta steps per sample, a divisor of `MOST_STEPS`.

    Raises:
        InputError: the number of steps is not a divisor of `MOST_STEPS`.
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
                f"{self.steps} steps per sample do not divide {MOST_STEPS}: choose 1, 2, 4, 8 or 16"
            )

    def rate(self, state: State, force: Scalar) -> State:
        """Return the time derivative of displacement (m), velocity (m/s) and z (N).

        Arguments:
            state: displacement, velocity and hysteretic force z.
            force: driving force, N.
        """
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
        """Return the oscillator with more steps, up to `MOST_STEPS`."""
        finer = 2 ** math.ceil(math.log2(max(self.steps * factor**-0.5, 1)))
        return dataclasses.replace(self, steps=min(finer, MOST_STEPS))

    def motion(
        self, forces: Float[Array, "sample half"], intervals: Float[Array, " sample"]
    ) -> Float[Array, "sample 3"]:
        """Return displacement (m), velocity (m/s) and hysteretic force (N) at every sample.

        The motion starts from rest and is computed by classical Runge-Kutta steps. The force must
        be smooth within a step. The method uses it only at the ends and in the middle of a step, so
        no interpolation is needed.

        Arguments:
            forces: forces at twice `MOST_STEPS` equidistant times after the previous sample, the
                last one at the sample itself, N. Of the first row, only the last force is used,
                which is the force at the first sample.
            intervals: time since the previous sample, s; the first value is not used.
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
