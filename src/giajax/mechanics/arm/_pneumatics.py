"""Muscles that drive joints: pairs of the paper's controller (fig. 6) in place of springs.

The statics of a pair are those of `giajax.mechanics.joint`; here they act in the arm's equation of
motion.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Float, Scalar, larger
from ...runtime.text import InputError
from ...schema import DRIVE
from ...schema.parameters import held, parameter
from ..joint import (
    LARGEST_ANGLE,
    AbstractMuscle,
    BraidedMuscle,
    Correction,
    Joint,
    JointPair,
    PairCommand,
    commanded,
    compression,
    muscle_torques,
    net_torque,
    resistance,
    resistance_energy,
)
from ..wrinkling import NeckFilm
from ._joint_laws import AbstractJointLaw, JointState, PerJoint, States, Supply, slope
from ._parts import Joints, Links

# Angles at which the steepest slope is looked for.
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 121)


def stiffest_pair(pair: JointPair) -> Scalar:
    """Bound of the stiffness of a pair at any pressures within its range, N m/rad.

    One pressure may be high where the other is low, so that what each muscle adds counts by itself.
    A neck adds what it has where it is tight, and its radius times what the compression changes by.
    """
    angles = jnp.asarray(_ANGLES)
    ahead, pressures = angles >= 0, jnp.full(2, 1.0) * pair.muscle.pressure_limit

    def torques(angle: Array) -> tuple[Array, Array]:
        own = resistance(pair.joint.correction, angle, ahead)
        return muscle_torques(pair, pressures, angle, ahead), own

    (first, second), own = jax.jvp(torques, (angles,), (jnp.ones_like(angles),))[1]
    added = larger(-first, 0) + larger(second, 0) + own
    if pair.neck.radius is None:
        return jnp.max(added)

    def pressed(angle: Array) -> Array:
        alone = jnp.eye(2) * pair.muscle.pressure_limit
        return jax.vmap(lambda each: compression(pair, each, angle, ahead))(alone)

    changed = jnp.sum(jnp.abs(slope(pressed, angles)), axis=0)
    return jnp.max(added + pair.neck.radius * changed) + pair.neck.stiffness


class MuscleDrive(eqx.Module):
    """Lag of the pressures (None: they follow at once), and what else acts on joints with muscles:
    a passive stiffness to the straight pose (None for nothing), and a stop beyond 60 deg.
    """

    lag: Scalar | None = parameter(DRIVE.lag)
    passive_stiffness: Scalar | None = parameter(DRIVE.passive_stiffness)
    stop_stiffness: Scalar = parameter(DRIVE.stop_stiffness)


MUSCLE_BLEND = float(np.deg2rad(1.0))
"""Half-width about 0 within which alpha and beta join unless stated, rad."""

_END = LARGEST_ANGLE * (1 + 1e-14)  # the largest angle as other conversions from degrees round it
_UNIT = 1e5  # a pressure as a state of the motion is in this unit, Pa: of the size of an angle


class Pneumatics(AbstractJointLaw):
    """Pairs of muscles in some joints, in place of their springs; the same pair in each.

    Pressures are arrays of shape (2, joint), Pa: of the first muscles, towards which a positive
    angle bends, and of the second ones; 0 in joints without muscles. Beyond 60 deg a joint has
    the torque of its pair at 60 deg, and a stop. The controller knows of no neck.

    Arguments:
        joints: numbers of the joints, increasing; 1 is the base joint.
        joint: its parameters keep the paths that they have in the model of a joint
            (`geometry.anchor_x`, `alpha.offset`, `torque`).
        muscle: the law of all muscles (`muscle.effectiveness`).
        drive: lag, passive stiffness and stop.
        neck: the film between links, at these joints; none by default.
        gas: gauge pressure in the neck of each of these joints, Pa; None in an arm, which has it
            in its links (`in_links`).

    Raises:
        InputError: no joint or the same twice, a law that pushes, or corrections that jump.
    """

    passive: ClassVar[bool] = False  # their air does work
    largest_angle: ClassVar[float] = LARGEST_ANGLE

    joints: tuple[int, ...] = eqx.field(static=True)
    # A recording of an arm hardly tells them: a fit finds those that it is asked for.
    joint: Joint = held(
        inline=True, default_factory=lambda: Joint(correction=Correction(blend=MUSCLE_BLEND))
    )
    muscle: AbstractMuscle = held(default_factory=BraidedMuscle)
    drive: MuscleDrive = eqx.field(default_factory=MuscleDrive)
    neck: NeckFilm = eqx.field(default_factory=NeckFilm)
    gas: Float[Array, "..."] | None = None

    def __check_init__(self) -> None:
        if not self.joints or np.any(np.diff(self.joints) <= 0) or self.joints[0] < 1:
            raise InputError(
                f"the joints with muscles are {list(self.joints)}: give increasing numbers of "
                f"joints, from 1 on, each once"
            )
        if self.muscle.pushes:
            raise InputError(
                f'the law of an arm\'s muscles is "{self.muscle.name}", which pushes, but '
                "the muscles of a pair must pull: use another law"
            )
        correction = self.joint.correction
        if correction.reading == "printed":
            raise InputError(
                "the corrections of an arm's muscles are as printed, where beta jumps at 2 and 20 "
                'deg, which would stop a joint there: use "continuous" or "none"'
            )
        if correction.reading == "continuous" and not correction.blend > 0:
            raise InputError(
                "the corrections of an arm's muscles jump at 0, which would stop a joint there: "
                "blend them over a half-width such as 1 deg"
            )

    @property
    def pair(self) -> JointPair:
        """The pair in each of these joints, with the gas of each in its neck.

        Raises:
            InputError: a neck without gas.
        """
        if self.neck.radius is None:
            return self._hinge
        if self.gas is None:
            raise InputError(
                "the necks of these joints share the gas of the links: use in_links(arm.links)"
            )
        return JointPair(self.joint, self.muscle, self.neck.filled(self.gas))

    @property
    def _hinge(self) -> JointPair:
        return JointPair(joint=self.joint, muscle=self.muscle)

    def in_links(self, links: Links) -> "Pneumatics":
        """With the gas of links in the necks; without necks themselves."""
        if self.neck.radius is None:
            return self
        gas = links.neck_pressure
        return dataclasses.replace(self, gas=self._of(gas) if gas.ndim else gas)

    @property
    def rows(self) -> int:
        """States of each joint: its two pressures where they lag."""
        return 0 if self.drive.lag is None else 2

    def settled(self, at: JointState) -> States:
        """The states of muscles in which the supplied pressures have settled."""
        assert at.pressures is not None
        return at.pressures[: self.rows] / _UNIT

    def inside(self, at: JointState) -> Supply:
        """Pressures in the muscles, Pa: those supplied, or where these lag, of the states."""
        pressures = at.states * _UNIT if self.rows else at.pressures
        assert pressures is not None
        return pressures

    def rate(self, at: JointState) -> States:
        """How fast the states change under the supplied pressures, 1/s."""
        if self.drive.lag is None:
            return at.states
        assert at.pressures is not None
        return (at.pressures / _UNIT - at.states) / self.drive.lag

    def asked(self, angle: Float[Array, "*shape"]) -> PairCommand:
        """What the controller asks of both muscles of a joint at angles (rad)."""
        angle = self._limited(angle)
        load = jnp.zeros_like(angle)
        if self.drive.passive_stiffness is not None:
            load = self.drive.passive_stiffness * angle
        torque = jnp.broadcast_to(self.joint.torque, angle.shape)
        return commanded(self._hinge, angle, load, torque)

    def commanded(self, command: PerJoint) -> Supply:
        """Pressures with which the controller holds commanded angles (rad), Pa."""
        pressures = self.asked(self._of(command)).pressures
        return self._in(command, jnp.moveaxis(pressures, -1, 0))

    def torque(self, at: JointState) -> PerJoint:
        """Torque on each joint at the pressures inside, N m; 0 in a joint without muscles."""
        angle, pressures = self._of(at.angles), self._of(self.inside(at))
        bent = self._limited(angle)
        torque = net_torque(self.pair, pressures, jnp.zeros(()), bent, bent >= 0)
        torque = torque - self.drive.stop_stiffness * (angle - bent)
        if self.drive.passive_stiffness is not None:
            torque = torque - self.drive.passive_stiffness * angle
        return self._in(at.angles, torque)

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Stiffness at the pressures inside, N m/rad; no damping."""
        stiffness = -slope(lambda x: self.torque(at._replace(angles=x)), at.angles)
        return stiffness, jnp.zeros_like(stiffness)

    def energy(self, at: JointState) -> PerJoint:
        """Energy that joints store whatever the pressures are, J; 0 in the straight arm.

        What a neck stores depends on the muscles that press it: it counts with their power.
        """
        angle, correction = self._of(at.angles), self.joint.correction
        bent = self._limited(angle)
        beyond = angle - bent
        energy = resistance_energy(correction, bent)
        energy = energy + resistance(correction, bent, bent >= 0) * beyond
        energy = energy + self.drive.stop_stiffness * beyond**2 / 2
        if self.drive.passive_stiffness is not None:
            energy = energy + self.drive.passive_stiffness * angle**2 / 2
        return self._in(at.angles, energy)

    def stiffest(self, at: JointState) -> PerJoint:
        """Bound of the stiffness that any pressures give joints, N m/rad.

        It is that of the range. A motion that reaches the stop is left to the control of errors.
        """
        stiffest = stiffest_pair(self.pair)
        if self.drive.passive_stiffness is not None:
            stiffest = stiffest + self.drive.passive_stiffness
        return self._in(at.angles, jnp.full(len(self.joints), stiffest))

    def _limited(self, angle: Array) -> Array:
        # Not `clip`, whose slope is a half at 60 deg itself, a usual command.
        return jnp.where(jnp.abs(angle) <= _END, angle, jnp.sign(angle) * LARGEST_ANGLE)

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


def muscles_in(muscles: str | Sequence[int], pair: JointPair | None, joints: Joints) -> Pneumatics:
    """Muscles in the joints of a name or of these numbers."""
    named = {"pitch": ~joints.is_yaw, "all": np.ones(len(joints.axes), bool)}
    if isinstance(muscles, str) and muscles in named:
        numbers = np.flatnonzero(named[muscles]) + 1
    else:
        numbers = np.asarray(muscles)
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise InputError(
            f'muscles is {muscles!r}: use "pitch", "all" or a list of numbers of joints'
        )
    own: dict[str, Any] = {} if pair is None else {"joint": pair.joint, "muscle": pair.muscle}
    return Pneumatics(tuple(numbers.tolist()), **own)


def idle_springs(joints: Joints, pneumatics: Pneumatics | None) -> dict[str, Any]:
    """Stiffnesses that no spring has, as 0, so that no fit looks for them."""
    driven = () if pneumatics is None else pneumatics.joints
    sprung = np.setdiff1d(np.arange(len(joints.axes)), np.asarray(driven, dtype=int) - 1)
    yaws = joints.is_yaw[sprung]
    idle = {"yaw_stiffness": np.any(yaws), "pitch_stiffness": np.any(~yaws)}
    return {name: 0.0 for name, used in idle.items() if not used}
