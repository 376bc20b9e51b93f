"""Bouc-Wen hysteresis as a differential equation, and as an operator.

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
    """dz/dt = alpha v - beta (gamma |v| |z|^(nu-1) z + delta v |z|^nu), v the rate of the input."""
    # |z|^(nu-1) as a number that has a derivative also at z = 0, where the motion begins.
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
    """z after motions in one direction: `bouc_wen_rate` over |v|, which depends on no rate.

    With nu = 1 and delta = 0 (Dahl) it falls off exponentially; otherwise it is integrated, right
    to 5e-5 but where a large nu makes the knee sharp, and takes thirty times as long.

    Arguments:
        ways: one after the other, over the yield angle, with the sign of their direction.
        z: before them.
        nu, delta: as of `BoucWen`, where alpha and beta are 1 and gamma is 1 - delta.
    """

    def exponential() -> Array:
        after = z
        for way in ways:
            sign = _sign(way)
            after = sign - (sign - after) * jnp.exp(-sign * way)
        return after

    def integrated() -> Array:
        return jax.lax.scan(lambda z, way: (_leg(way, z, nu, delta), None), z, ways)[0]

    # All of them in one: a branch costs more than the exponentials.
    return jax.lax.cond(_is_dahl(nu, delta), exponential, integrated)


@bouc_wen_after.def_jvp
def _bouc_wen_after_jvp(primals: Any, tangents: Any) -> tuple[Array, Array]:
    """What each leg does to derivatives, worked out once however many of them there are."""
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


# What z of Dahl's model is by its shape, after a way x in the direction in which z rises from y0 to
# y = 1 - (1 - y0) e^-x. A derivative d of it falls off as z does, and is made on the way: by delta
# d' = -d + min(2 y, 0), by nu d' = -d - y ln|y|, whose integrals over e^t are elementary and, with
# the dilogarithm Li2, closed.


def _dahl_by_delta(way: Array, before: Array, after: Array, kept: Array) -> Array:
    del after
    # Up to where z is 0.
    falling = limited(jnp.log1p(-jnp.where(before < 0, before, 0)), 0, way)
    return 2 * kept * (jnp.expm1(falling) - (1 - before) * falling)


def _dahl_by_nu(way: Array, before: Array, after: Array, kept: Array) -> Array:
    dilogarithms = _dilogarithm(after) - _dilogarithm(before)
    return (1 - after) * (way + dilogarithms) - _y_log_y(after) + kept * _y_log_y(before)


def _y_log_y(y: Array) -> Array:
    return y * jnp.log(jnp.where(y == 0, 1, jnp.abs(y)))


def _dilogarithm(y: Array) -> Array:
    """The real part of Li2(1 - y), for y up to 1."""
    negative = y < 0
    # Beyond its branch point by that of 1 / (1 - y).
    inner = spence(jnp.where(negative, -y / (1 - y), y))
    return jnp.where(negative, jnp.pi**2 / 3 - jnp.log(1 - y) ** 2 / 2 - inner, inner)


def _sign(way: Array) -> Array:
    return jnp.where(way < 0, -1.0, 1.0)


@eqx.filter_custom_jvp
def _is_dahl(nu: Scalar, delta: Scalar) -> Bool[Array, ""]:
    """Whether nu is 1 and delta 0; not where one is differentiated by once more."""
    return (nu == 1) & (delta == 0)


@_is_dahl.def_jvp
def _is_dahl_jvp(primals: Any, tangents: Any) -> tuple[Array, None]:
    held = all(tangent is None for tangent in tangents)
    return _is_dahl(*primals) & held, None


def _leg(way: Array, z: Array, nu: Scalar, delta: Scalar) -> Array:
    """z after one motion, integrated."""
    most, one = _FULL + _DECAY / nu, jnp.ones_like(nu)
    width = limited(way, -most, most) / _STEPS
    return _by_steps(lambda z: bouc_wen_rate(width, z, one, one, 1 - delta, delta, nu), z, _STEPS)


def _by_steps(slope: Callable[[Array], Array], z: Array, count: int) -> Array:
    """z after so many classical Runge-Kutta steps, of a slope times the width of one."""

    def one(_: int, z: Array) -> Array:
        first = slope(z)
        second = slope(z + first / 2)
        third = slope(z + second / 2)
        fourth = slope(z + third)
        return z + (first + 2 * second + 2 * third + fourth) / 6

    # The number of turns is known, which keeps both modes of differentiation.
    return jax.lax.fori_loop(0, count, one, z)


_FULL, _DECAY, _STEPS = 2.0, 24.0, 32  # yield angles up to the knee, and beyond it; steps of both

_LONG = 200  # substeps of a move that may be as long as the whole range

# Substeps within the width of the knee, in an inverse: RK4 is then right to about 1e-5.
_PER_KNEE = 4.0
_MOST = 4000

_COARSE = 2.0  # in widths of the knee: a longer substep is wrong, and one beyond 2.8 unstable


class BoucWen(AbstractOperator):
    """y = elastic u + z, where z follows the Bouc-Wen equation along the input.

    Only the products beta gamma and beta delta are determined by a history: the three of them
    are kept because they are the literature's.

    Arguments:
        elastic: output per input without memory.
        alpha: slope of z where it is 0.
        beta, gamma, delta: shape of the loop; beta in 1/input where nu is 1.
        nu: sharpness of the knee.
        substeps: Runge-Kutta steps between two samples.

    Raises:
        InputError: fewer than 1 substep.
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
        """With more substeps: the method is of fourth order."""
        return dataclasses.replace(self, substeps=int(np.ceil(self.substeps * factor**-0.25)))

    def stiffness(self, z: Scalar) -> Scalar:
        """How fast z is forgotten, 1/input: beta (gamma + |delta|) nu |z|^(nu-1)."""
        size = jnp.maximum(jnp.abs(z), jnp.finfo(z.dtype).tiny)
        factor = self.beta * (jnp.abs(self.gamma) + jnp.abs(self.delta)) * self.nu
        return factor * size ** (self.nu - 1)

    def for_moves_of(self, width: float) -> Self:
        """With as many substeps as a move of that width needs."""
        fine = dataclasses.replace(self, substeps=_LONG)
        end = jnp.asarray(width, dtype=self.elastic.dtype)
        _, z = fine.travelled(fine.reset(), end)
        needed = _PER_KNEE * width * float(self.stiffness(z))
        if not needed < _MOST:
            raise InputError(
                f"the knee of the Bouc-Wen operator is too narrow for a range of {width:g} "
                "(SI): fit a smaller beta, gamma or nu"
            )
        return dataclasses.replace(self, substeps=max(self.substeps, int(np.ceil(needed))))

    def travelled(self, state: tuple[Scalar, Scalar], value: Scalar) -> tuple[Scalar, Scalar]:
        """Memory after a move that may be much longer than those between two samples."""
        return dataclasses.replace(self, substeps=max(self.substeps, _LONG)).step(state, value)[0]

    def too_coarse(
        self, inputs: Float[Array, " sample"], outputs: Float[Array, " sample"]
    ) -> Bool[Array, ""]:
        """Whether a move of a history, with what `history` gave, is too long for the substeps."""
        z = jnp.max(jnp.abs(outputs - self.elastic * inputs))
        longest = jnp.max(jnp.abs(jnp.diff(inputs)), initial=0)
        return longest * self.stiffness(z) > _COARSE * self.substeps

    def reset(self) -> tuple[Scalar, Scalar]:
        """Input and z at 0."""
        return jnp.zeros_like(self.elastic), jnp.zeros_like(self.elastic)

    def step(
        self, state: tuple[Scalar, Scalar], value: Scalar
    ) -> tuple[tuple[Scalar, Scalar], Scalar]:
        """Input, z and output after the input has moved.

        The equation does not depend on how fast the input moves: it is integrated over the
        input itself.
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
        """Outputs at all samples."""
        return history_by_steps(self, inputs, state)


# Forces are kept for so many steps a sample, so that a finer solution needs no others.
MOST_STEPS = 16

State = Float[Array, "3"]


class BoucWenOscillator(eqx.Module):
    """mass y'' + damping y' + stiffness y + z = force, with z of the Bouc-Wen equation.

    A mass on a spring and a damper starts at rest. The defaults are those of the benchmark.

    Arguments:
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
                f"{self.steps} steps per sample do not divide {MOST_STEPS}: choose 1, 2, 4, 8 or 16"
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
        """Displacement (m), velocity (m/s) and hysteretic force (N) at every sample, from rest.

        By classical Runge-Kutta steps. The force is smooth within a step, and its values at the
        ends and in the middle are what the method uses: no interpolation enters here.

        Arguments:
            forces: N, at equal distances after the sample before, the last one at the sample
                itself; twice `MOST_STEPS` of them. The first row is not driven through: its last
                force is that at the first sample.
            intervals: s, from the sample before; the first one is not used.
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
