"""Muscles that drive joints: pairs of the paper's controller (fig. 6) in place of springs.

The statics of a pair are those of `giajax.joint`; here they act in the arm's equation of motion.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..joint import (
    LARGEST_ANGLE,
    AbstractMuscle,
    BraidedMuscle,
    Correction,
    Joint,
    JointPair,
    commanded,
    muscle_torques,
    net_torque,
    resistance,
    resistance_energy,
)
from ..parameters import held
from ._muscle_drive import MuscleDrive

MUSCLE_BLEND = float(np.deg2rad(1.0))
"""Half-width about 0 within which alpha and beta join unless stated, rad."""

# Angles at which the steepest slope is looked for.
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 121)

# A pressure as a state of the motion is in this unit, Pa: of the size of an angle.
_UNIT = 1e5


def _blended() -> Joint:
    return Joint(correction=Correction(blend=MUSCLE_BLEND))


class Pneumatics(eqx.Module):
    """Pairs of muscles in some joints, in place of their springs; the same pair in each.

    Pressures are arrays of shape (2, joint), Pa: of the first muscles, towards which a positive
    angle bends, and of the second ones; 0 in joints without muscles. Beyond 60 deg a joint has
    the torque of its pair at 60 deg, and a stop.

    Arguments:
        joints: numbers of the joints, increasing; 1 is the base joint.
        joint: its parameters keep the paths that they have in the model of a joint
            (`geometry.anchor_x`, `alpha.offset`, `torque`).
        muscle: the law of all muscles (`muscle.effectiveness`).
        drive: lag, passive stiffness and stop.

    Raises:
        InputError: no joint or the same twice, or corrections that jump.
    """

    joints: tuple[int, ...] = eqx.field(static=True)
    # A recording of an arm hardly tells them: a fit finds those that it is asked for.
    joint: Joint = held(inline=True, default_factory=_blended)
    muscle: AbstractMuscle = held(default_factory=BraidedMuscle)
    drive: MuscleDrive = eqx.field(default_factory=MuscleDrive)

    def __check_init__(self) -> None:
        if not self.joints or np.any(np.diff(self.joints) <= 0) or self.joints[0] < 1:
            raise InputError(
                f"muscles are in joints {list(self.joints)}: give numbers of joints from 1 on, "
                "increasing, each once"
            )
        correction = self.joint.correction
        if correction.reading == "printed":
            raise InputError(
                "the corrections of an arm's muscles are as printed, where beta jumps at 2 and 20 "
                'deg, and a joint would stick there: use "continuous" or "none"'
            )
        if correction.reading == "continuous" and not correction.blend > 0:
            raise InputError(
                "the corrections of an arm's muscles jump at 0, and a joint would stick there: "
                "blend them over a half-width such as 1 deg"
            )

    @property
    def pair(self) -> JointPair:
        """The pair in each of these joints."""
        return JointPair(joint=self.joint, muscle=self.muscle)

    @property
    def rows(self) -> int:
        """States of each joint: its two pressures where they lag."""
        return 0 if self.drive.lag is None else 2

    def filled(self, pressures: Float[Array, "2 joint"]) -> Float[Array, "row joint"]:
        """The states of muscles in which pressures (Pa) have settled."""
        return pressures[: self.rows] / _UNIT

    def inside(self, states: Float[Array, "row joint"]) -> Float[Array, "2 joint"]:
        """Pressures (Pa) of states, where pressures lag."""
        return states * _UNIT

    def rate(
        self, supplied: Float[Array, "2 joint"], states: Float[Array, "row joint"]
    ) -> Float[Array, "row joint"]:
        """How fast the states change under supplied pressures (Pa), 1/s."""
        if self.drive.lag is None:
            return states
        return (supplied / _UNIT - states) / self.drive.lag

    def commanded(self, command: Float[Array, " joint"]) -> Float[Array, "2 joint"]:
        """Pressures with which the controller holds commanded angles (rad), Pa."""
        angle = self._limited(self._of(command))
        load = jnp.zeros_like(angle)
        if self.drive.passive_stiffness is not None:
            load = self.drive.passive_stiffness * angle
        torque = jnp.broadcast_to(self.joint.torque, angle.shape)
        pressures = commanded(self.pair, angle, load, torque).pressures
        return self._in(command, jnp.moveaxis(pressures, -1, 0))

    def torque(
        self, angles: Float[Array, " joint"], pressures: Float[Array, "2 joint"]
    ) -> Float[Array, " joint"]:
        """Torque on each joint at pressures (Pa), N m; 0 in a joint without muscles."""
        angle = self._of(angles)
        bent = self._limited(angle)
        torque = net_torque(self.pair, self._of(pressures), jnp.zeros(()), bent, bent >= 0)
        torque = torque - self.drive.stop_stiffness * (angle - bent)
        if self.drive.passive_stiffness is not None:
            torque = torque - self.drive.passive_stiffness * angle
        return self._in(angles, torque)

    def pull(
        self, angles: Float[Array, " joint"], pressures: Float[Array, "2 joint"]
    ) -> Float[Array, " joint"]:
        """The part of the torque that the pressures do, N m."""
        bent = self._limited(self._of(angles))
        first, second = muscle_torques(self.pair, self._of(pressures), bent, bent >= 0)
        return self._in(angles, first - second)

    def energy(self, angles: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Energy that joints store whatever the pressures are, J; 0 in the straight arm."""
        angle, correction = self._of(angles), self.joint.correction
        bent = self._limited(angle)
        beyond = angle - bent
        energy = resistance_energy(correction, bent)
        energy = energy + resistance(correction, bent, bent >= 0) * beyond
        energy = energy + self.drive.stop_stiffness * beyond**2 / 2
        if self.drive.passive_stiffness is not None:
            energy = energy + self.drive.passive_stiffness * angle**2 / 2
        return self._in(angles, energy)

    @property
    def stiffest(self) -> Scalar:
        """Largest stiffness that any pressures give a joint, N m/rad."""
        angles = jnp.asarray(_ANGLES)
        pressures = jnp.full(2, 1.0) * self.muscle.limit

        def torque(angle: Array) -> Array:
            return net_torque(self.pair, pressures, jnp.zeros(()), angle, angle >= 0)

        slopes = jax.jvp(torque, (angles,), (jnp.ones_like(angles),))[1]
        passive = 0.0 if self.drive.passive_stiffness is None else self.drive.passive_stiffness
        return jnp.maximum(jnp.max(-slopes), self.drive.stop_stiffness) + passive

    def _limited(self, angle: Array) -> Array:
        return jnp.clip(angle, -LARGEST_ANGLE, LARGEST_ANGLE)

    @property
    def _stride(self) -> int | None:
        """The distance between these joints, where it is the same everywhere."""
        steps = set(np.diff(self.joints).tolist())
        return None if len(steps) > 1 else next(iter(steps), 1)

    def _of(self, each: Array) -> Array:
        """What of each joint belongs to these, along the last axis."""
        if self._stride is not None:
            return each[..., self.joints[0] - 1 : self.joints[-1] : self._stride]
        return each[..., np.asarray(self.joints) - 1]

    def _in(self, like: Array, values: Array) -> Array:
        """Values of these joints among all, as many as `like` has, and 0 elsewhere."""
        count = like.shape[-1]
        zero = jnp.zeros((), values.dtype)
        if self._stride is not None:
            # A slice and a padding cost nothing; gathering and scattering do.
            within = (self.joints[0] - 1, count - self.joints[-1], self._stride - 1)
            around = [(0, 0, 0)] * (values.ndim - 1)
            return jax.lax.pad(values, zero, [*around, within])
        every = jnp.zeros((*values.shape[:-1], count), values.dtype)
        return every.at[..., np.asarray(self.joints) - 1].set(values)
