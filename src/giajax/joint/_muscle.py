"""What every muscle law offers: force from pressure and contraction, and the inverse."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy.typing as npt

from .._errors import InputError
from .._typing import Array, Float
from ..parameters import is_concrete
from ._answer import (
    NEEDS_PRESSURE,
    NEEDS_PUSH,
    PULLS_ANYWAY,
    REACHED,
    TOO_SHORT,
    PressureAnswer,
)

# Below this (N) a force is the rounding of zero, not a push.
_NO_FORCE = 1e-9


class AbstractMuscle(eqx.Module):
    """A muscle, or another actuator, by its statics without friction."""

    name: ClassVar[str]
    own_motion: ClassVar[int]
    """Sign of the recorded displacement in which it moves by itself: +1 where it shortens."""
    pushes: ClassVar[bool]
    """Whether its force may be negative; else it is slack beyond its reach."""

    @abc.abstractmethod
    def signed_force(
        self,
        pressure: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> Float[Array, "*shape"]:
        """Force by the law alone, N; negative beyond its reach.

        Arguments:
            pressure: above the surroundings, Pa.
            contraction: relative to the length at rest.
            length: of the muscle at rest, m.

        Returns:
            Force, N.
        """

    @abc.abstractmethod
    def pressure_for(
        self,
        force: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> tuple[Float[Array, "*shape"], Float[Array, "*shape"]]:
        """Pressure that the law says for a force >= 0, Pa, and the force gained per pascal.

        Where nothing is gained there is no such pressure, and its value means nothing.

        Arguments:
            force: at least 0, N.
            contraction: relative to the length at rest.
            length: of the muscle at rest, m.

        Returns:
            Pressure, Pa, and force gained per pascal, N/Pa.
        """

    @property
    @abc.abstractmethod
    def limit(self) -> Float[Array, ""]:
        """Highest pressure, Pa."""

    def force(
        self,
        pressure: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> Float[Array, "*shape"]:
        """Force, N: that of the law, or 0 where the actuator is slack.

        Arguments:
            pressure: above the surroundings, Pa.
            contraction: relative to the length at rest.
            length: of the muscle at rest, m.

        Returns:
            Force, N.
        """
        force = self.signed_force(pressure, contraction, length)
        return force if self.pushes else jnp.maximum(force, 0)

    def answer(
        self,
        force: Float[Array, "*shape"],
        contraction: Float[Array, "*shape"],
        length: Float[Array, ""],
    ) -> PressureAnswer:
        """Pressure for a force at a contraction; nothing is checked.

        Arguments:
            force: to be reached, N.
            contraction: relative to the length at rest.
            length: of the muscle at rest, m.

        Returns:
            The pressure, or the nearest one, and why the force is out of reach.
        """
        needed, gain = self.pressure_for(jnp.maximum(force, 0), contraction, length)
        able = gain > 0
        pressure = jnp.where(able, jnp.clip(needed, 0, self.limit), self.limit)
        code = jnp.where(
            able,
            jnp.where(
                needed > self.limit,
                NEEDS_PRESSURE,
                jnp.where(needed * gain < -_NO_FORCE, PULLS_ANYWAY, REACHED),
            ),
            jnp.where(force > _NO_FORCE, TOO_SHORT, REACHED),
        )
        # Where the muscle cannot pull, it has no force without pressure.
        pressure = jnp.where(~able & (force <= _NO_FORCE), 0, pressure)
        push = force < -_NO_FORCE
        return PressureAnswer(
            pressure=jnp.where(push, 0, pressure),
            force=self.force(jnp.where(push, 0, pressure), contraction, length),
            code=jnp.where(push, NEEDS_PUSH, code),
        )


def muscle_force(
    muscle: AbstractMuscle,
    pressure: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> Float[Array, "*shape"]:
    """Force of a muscle without friction, N.

    Arguments:
        muscle: the law.
        pressure: above the surroundings, Pa, of any shape.
        contraction: relative to the length at rest, of the same shape or one number.
        length: of the muscle at rest, m.

    Returns:
        Force, N, of the shape of the arguments; 0 where the muscle is slack.

    Raises:
        InputError: a number that is not finite, a negative pressure, or a contraction of 1 or
            more.

    Example:
        >>> import giajax
        >>> float(giajax.muscle_force(giajax.BraidedMuscle(dead_band=0.0), 100e3, 0.0)) > 17
        True
    """
    pressure, contraction, length = _arrays(pressure, contraction, length)
    _check(contraction, length, pressure=pressure)
    return muscle.force(pressure, contraction, length)


def muscle_pressure(
    muscle: AbstractMuscle,
    force: npt.ArrayLike | Array,
    contraction: npt.ArrayLike | Array,
    length: npt.ArrayLike | Array = 1.96,
) -> PressureAnswer:
    """Pressure at which a muscle pulls with a force at a contraction, in closed form.

    Arguments:
        muscle: the law.
        force: to be reached, N, of any shape.
        contraction: relative to the length at rest, of the same shape or one number.
        length: of the muscle at rest, m.

    Returns:
        The pressure, or where the force is out of reach the nearest one, and why.

    Raises:
        InputError: a number that is not finite, or a contraction of 1 or more.

    Example:
        >>> import giajax
        >>> answer = giajax.muscle_pressure(giajax.BraidedMuscle(), 2.0, 0.35)
        >>> bool(answer.reached), answer.message()
        (False, 'the muscle does not shorten so far at any pressure: ask for less contraction')
    """
    force, contraction, length = _arrays(force, contraction, length)
    _check(contraction, length, force=force)
    return muscle.answer(force, contraction, length)


def _arrays(
    first: npt.ArrayLike | Array, contraction: npt.ArrayLike | Array, length: npt.ArrayLike | Array
) -> tuple[Array, Array, Array]:
    dtype = jnp.result_type(float)
    first, contraction, length = (
        jnp.asarray(item, dtype=dtype) for item in (first, contraction, length)
    )
    if length.ndim or (first.ndim and contraction.ndim and first.shape != contraction.shape):
        raise InputError(
            f"values have the shapes {first.shape}, {contraction.shape} and {length.shape}: give "
            "arrays of one shape, or numbers, and one length"
        )
    shape = first.shape or contraction.shape
    return jnp.broadcast_to(first, shape), jnp.broadcast_to(contraction, shape), length


def _check(contraction: Array, length: Array, **others: Array) -> None:
    if not is_concrete((contraction, length, *others.values())):
        return
    for what, values in {"contraction": contraction, "length": length, **others}.items():
        if not bool(jnp.all(jnp.isfinite(values))):
            raise InputError(f"a {what} is not finite: give finite numbers")
    if bool(jnp.any(contraction >= 1)):
        raise InputError(
            f"a contraction is {float(jnp.max(contraction)):g}, and at 1 nothing is left of the "
            "muscle: give the fraction of its length at rest, not percent"
        )
    if "pressure" in others and bool(jnp.any(others["pressure"] < 0)):
        raise InputError(
            f"a pressure is {float(jnp.min(others['pressure'])):g} Pa: give the pressure above the "
            "surroundings, 0 or more"
        )
