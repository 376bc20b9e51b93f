"""Joints of an arm driven by pairs of muscles with the controller of the paper (fig. 6).

The pairs replace the springs of the joints. `giajax.mechanics.joint` computes the statics of a
pair. This module adds them to the equation of motion of the arm.
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

# Angles at which the largest stiffness is computed.
_ANGLES = np.linspace(-LARGEST_ANGLE, LARGEST_ANGLE, 121)


def stiffest_pair(pair: JointPair) -> Scalar:
    """Return an upper bound of the stiffness of a pair at any permitted pressures, N m/rad.

    One pressure may be high while the other is low, so only positive contributions of the muscles
    are added. A neck contributes its stiffness in the tight state, and its radius times the change
    in the compression.
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
    """Pressure lag and passive torques of joints with muscles.

    Attributes:
        lag: time constant of the pressures, s; None if they follow without delay.
        passive_stiffness: stiffness about the straight pose, N m/rad; None for no stiffness.
        stop_stiffness: stiffness of the end stop beyond 60 deg, N m/rad.
    """

    lag: Scalar | None = parameter(DRIVE.lag)
    passive_stiffness: Scalar | None = parameter(DRIVE.passive_stiffness)
    stop_stiffness: Scalar = parameter(DRIVE.stop_stiffness)


MUSCLE_BLEND = float(np.deg2rad(1.0))
"""Default half-width (rad) of the range about 0 over which alpha and beta are blended."""

_END = LARGEST_ANGLE * (1 + 1e-14)  # includes 60 deg with a rounding error of the conversion
_UNIT = 1e5  # Pa; unit of pressures in the state of the motion, which gives them the size of angles


class Pneumatics(AbstractJointLaw):
    """Equal pairs of muscles that replace the springs of some joints.

    Pressures are arrays of shape (2, joint), Pa. The first row contains the pressures of the first
    muscles, towards which a positive angle bends the joints, and the second row those of the second
    muscles. The pressures are 0 in joints without muscles. Beyond 60 deg, a joint has the torque of
    its pair at 60 deg and an end stop. The controller does not take a neck into account.

    Arguments:
        joints: increasing numbers of the joints with muscles; 1 is the base joint.
        joint: geometry and corrections of the joints; the parameters have the same paths as in the
            model of a joint (`geometry.anchor_x`, `alpha.offset`, `torque`).
        muscle: law of all muscles (`muscle.effectiveness`).
        drive: pressure lag, passive stiffness and end stop.
        neck: neck of film between the links at these joints; none by default.
        gas: gauge pressure in the neck of each of these joints, Pa; None in an arm, where the
            pressure is that of the links (`in_links`).

    Raises:
        InputError: no joint is given, a joint is given twice, the law pushes, or the corrections
            jump.
    """

    passive: ClassVar[bool] = False  # the gas in the muscles does work
    largest_angle: ClassVar[float] = LARGEST_ANGLE

    joints: tuple[int, ...] = eqx.field(static=True)
    # A recording of an arm contains little information about these parameters, so a fit estimates
    # them only on request.
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
                f"the joints with muscles are {list(self.joints)}: give joint numbers of "
                "at least 1 in increasing order"
            )
        if self.muscle.pushes:
            raise InputError(
                f'the muscle law of an arm is "{self.muscle.name}", which pushes, but '
                "the muscles of a pair must pull: use another law"
            )
        correction = self.joint.correction
        if correction.reading == "printed":
            raise InputError(
                "the corrections of an arm's muscles are those printed in the paper, and the jumps "
                'of beta at 2 and 20 deg would stop a joint there: use "continuous" or "none"'
            )
        if correction.reading == "continuous" and not correction.blend > 0:
            raise InputError(
                "the corrections of an arm's muscles jump at 0, which would stop a joint there: "
                "blend them over a half-width such as 1 deg"
            )

    @property
    def pair(self) -> JointPair:
        """The pair in each of these joints, with the gas in its neck.

        Raises:
            InputError: there is a neck without gas.
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
        """Return the pairs with the gas of links in their necks; unchanged without necks."""
        if self.neck.radius is None:
            return self
        gas = links.neck_pressure
        return dataclasses.replace(self, gas=self._of(gas) if gas.ndim else gas)

    @property
    def rows(self) -> int:
        """Number of states of each joint: 2 if the pressures lag, otherwise 0."""
        return 0 if self.drive.lag is None else 2

    def settled(self, at: JointState) -> States:
        """Return the states of muscles whose pressures equal the supplied pressures."""
        assert at.pressures is not None
        return at.pressures[: self.rows] / _UNIT

    def inside(self, at: JointState) -> Supply:
        """Return the pressures in the muscles, Pa: from the states if they lag, else the supply."""
        pressures = at.states * _UNIT if self.rows else at.pressures
        assert pressures is not None
        return pressures

    def rate(self, at: JointState) -> States:
        """Return the time derivative of the states under the supplied pressures, 1/s."""
        if self.drive.lag is None:
            return at.states
        assert at.pressures is not None
        return (at.pressures / _UNIT - at.states) / self.drive.lag

    def asked(self, angle: Float[Array, "*shape"]) -> PairCommand:
        """Return the command of the controller to both muscles of a joint at angles (rad)."""
        angle = self._limited(angle)
        load = jnp.zeros_like(angle)
        if self.drive.passive_stiffness is not None:
            load = self.drive.passive_stiffness * angle
        torque = jnp.broadcast_to(self.joint.torque, angle.shape)
        return commanded(self._hinge, angle, load, torque)

    def commanded(self, command: PerJoint) -> Supply:
        """Return the pressures with which the controller holds commanded angles (rad), Pa."""
        pressures = self.asked(self._of(command)).pressures
        return self._in(command, jnp.moveaxis(pressures, -1, 0))

    def torque(self, at: JointState) -> PerJoint:
        """Return the torque of the muscles on each joint, N m; 0 in a joint without muscles."""
        angle, pressures = self._of(at.angles), self._of(self.inside(at))
        bent = self._limited(angle)
        torque = net_torque(self.pair, pressures, jnp.zeros(()), bent, bent >= 0)
        torque = torque - self.drive.stop_stiffness * (angle - bent)
        if self.drive.passive_stiffness is not None:
            torque = torque - self.drive.passive_stiffness * angle
        return self._in(at.angles, torque)

    def slopes(self, at: JointState) -> tuple[PerJoint, PerJoint]:
        """Return the stiffness at the pressures in the muscles, N m/rad, and zero damping."""
        stiffness = -slope(lambda x: self.torque(at._replace(angles=x)), at.angles)
        return stiffness, jnp.zeros_like(stiffness)

    def energy(self, at: JointState) -> PerJoint:
        """Return the energy stored in joints at any pressures, J; 0 in the straight arm.

        The energy in a neck is not included, because it depends on the compression by the muscles.
        It is included in the power of the muscles.
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
        """Return an upper bound of the stiffness of joints at any pressures, N m/rad.

        The bound applies within the range of the angles. At the end stop, the error control of the
        integrator limits the steps.
        """
        stiffest = stiffest_pair(self.pair)
        if self.drive.passive_stiffness is not None:
            stiffest = stiffest + self.drive.passive_stiffness
        return self._in(at.angles, jnp.full(len(self.joints), stiffest))

    def _limited(self, angle: Array) -> Array:
        # `clip` is not used, because its derivative is 1/2 at 60 deg, which is a common command.
        return jnp.where(jnp.abs(angle) <= _END, angle, jnp.sign(angle) * LARGEST_ANGLE)

    @property
    def _stride(self) -> int | None:
        """Difference of the numbers of neighbouring joints, or None if it is not constant."""
        steps = set(np.diff(self.joints).tolist())
        return None if len(steps) > 1 else next(iter(steps), 1)

    def _of(self, each: Array) -> Array:
        """Select the values of the joints with muscles along the last axis."""
        if self._stride is not None:
            return each[..., self.joints[0] - 1 : self.joints[-1] : self._stride]
        return each[..., np.asarray(self.joints) - 1]

    def _in(self, like: Array, values: Array) -> Array:
        """Insert values of the joints with muscles into zeros for all joints.

        The last axis of `like` has the number of joints.
        """
        count = like.shape[-1]
        zero = jnp.zeros((), values.dtype)
        if self._stride is not None:
            # Slicing and padding are much cheaper than gathering and scattering.
            within = (self.joints[0] - 1, count - self.joints[-1], self._stride - 1)
            around = [(0, 0, 0)] * (values.ndim - 1)
            return jax.lax.pad(values, zero, [*around, within])
        every = jnp.zeros((*values.shape[:-1], count), values.dtype)
        return every.at[..., np.asarray(self.joints) - 1].set(values)


def muscles_in(muscles: str | Sequence[int], pair: JointPair | None, joints: Joints) -> Pneumatics:
    """Create the muscles of joints that are given by a name or by their numbers."""
    named = {"pitch": ~joints.is_yaw, "all": np.ones(len(joints.axes), bool)}
    if isinstance(muscles, str) and muscles in named:
        numbers = np.flatnonzero(named[muscles]) + 1
    else:
        numbers = np.asarray(muscles)
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise InputError(f'muscles is {muscles!r}: use "pitch", "all" or a list of joint numbers')
    own: dict[str, Any] = {} if pair is None else {"joint": pair.joint, "muscle": pair.muscle}
    return Pneumatics(tuple(numbers.tolist()), **own)


def idle_springs(joints: Joints, pneumatics: Pneumatics | None) -> dict[str, Any]:
    """Return 0 for each stiffness that no spring uses, so that a fit does not estimate it."""
    driven = () if pneumatics is None else pneumatics.joints
    sprung = np.setdiff1d(np.arange(len(joints.axes)), np.asarray(driven, dtype=int) - 1)
    yaws = joints.is_yaw[sprung]
    idle = {"yaw_stiffness": np.any(yaws), "pitch_stiffness": np.any(~yaws)}
    return {name: 0.0 for name, used in idle.items() if not used}
