"""What every muscle law offers: force from pressure and contraction, and the inverse."""

import abc
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp

from .._typing import Array, Float
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
