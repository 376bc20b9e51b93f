"""Sensors on links and joints: IMUs, inclinometers, tension and curvature sensors."""

import functools
from typing import ClassVar

import jax
import jax.numpy as jnp

from ..mechanics.arm import Pose, angular_velocities, pose
from ..runtime.arrays import Array, Float, dot, safe_norm
from ..runtime.plugins import register
from ..schema import CURVATURE, IMU_FORCE, IMU_RATE, INCLINATION, TENSION
from ..schema.parameters import parameter
from ..simulation import Trajectory
from ._arm_sensors import AbstractSensor, Marker, per_row

PerLink = Float[Array, ""] | Float[Array, " link"] | None


# An optional sensor parameter, with one value for all links or joints or one for each.
_each = functools.partial(parameter, 0.0, optional=True, per="link", each=True)


def _in_frames(vectors: Float[Array, "3 link"], here: Pose) -> Float[Array, "link 3"]:
    """Resolve vectors of the base frame along, to the left of and above their links."""
    assert here.left is not None
    return jnp.stack([dot(vectors, axis) for axis in (here.direction, here.left, here.up)], axis=-1)


def _shifted(
    shown: Float[Array, "sample link 3"], *offsets: PerLink
) -> Float[Array, "sample link 3"]:
    for place, offset in enumerate(offsets):
        if offset is not None:
            shown = shown.at[:, :, place].add(per_row(offset, shown[:, :, place]))
    return shown


@register
class Gyroscope(AbstractSensor):
    """Angular velocity of each link (`imuNN_gyro_x`): along it, to its left and upwards, rad/s."""

    kind: ClassVar[str] = "gyroscope"
    channel = IMU_RATE

    offset_x: PerLink = _each(
        unit="rad/s", doc="bias of the gyroscope about the axis along its link"
    )
    offset_y: PerLink = _each(
        unit="rad/s", doc="bias of the gyroscope about the leftward axis of its link"
    )
    offset_z: PerLink = _each(
        unit="rad/s", doc="bias of the gyroscope about the upward axis of its link"
    )

    def values(self, motion: Trajectory) -> Float[Array, "sample link 3"]:
        """Return the angular velocities in the link frames, with offsets."""

        def at(angles: Array, rates: Array) -> Array:
            here = pose(motion.arm, angles, sideways=True)
            return _in_frames(angular_velocities(here, rates), here)

        shown = jax.vmap(at)(motion.angles, motion.rates)
        return _shifted(shown, self.offset_x, self.offset_y, self.offset_z)


@register
class Accelerometer(AbstractSensor):
    """Specific force at a point of each link (`imuNN_accel_x`), m/s^2; at rest g, upwards.

    It is the acceleration of the point minus that of gravity, resolved along the link, to its left
    and upwards.
    """

    kind: ClassVar[str] = "accelerometer"
    channel = IMU_FORCE

    along: PerLink = _each(
        unit="m", doc="offset of an IMU from the centre of its link, along the link"
    )
    left: PerLink = _each(unit="m", doc="leftward offset of an IMU from the centre of its link")
    up: PerLink = _each(unit="m", doc="upward offset of an IMU from the centre of its link")
    offset_x: PerLink = _each(
        unit="m/s^2", doc="bias of the accelerometer in the direction along its link"
    )
    offset_y: PerLink = _each(
        unit="m/s^2", doc="bias of the accelerometer in the leftward direction of its link"
    )
    offset_z: PerLink = _each(
        unit="m/s^2", doc="bias of the accelerometer in the upward direction of its link"
    )

    def values(self, motion: Trajectory) -> Float[Array, "sample link 3"]:
        """Return the specific forces in the link frames, with offsets."""
        arm = motion.arm
        place = functools.partial(Marker(self.along, self.left, self.up).on_links, arm)

        def velocity(angles: Array, rates: Array) -> Array:
            return jax.jvp(place, (angles,), (rates,))[1]

        def at(angles: Array, rates: Array, accelerations: Array) -> Array:
            moved = jax.jvp(velocity, (angles, rates), (rates, accelerations))[1].T
            force = moved.at[2].add(arm.gravity)
            return _in_frames(force, pose(arm, angles, sideways=True))

        shown = jax.vmap(at)(motion.angles, motion.rates, motion.accelerations)
        return _shifted(shown, self.offset_x, self.offset_y, self.offset_z)


@register
class Inclinometer(AbstractSensor):
    """Angle of each link above the horizontal (`linkNN_inclination`), rad, from -pi/2 to pi/2."""

    kind: ClassVar[str] = "inclinometer"
    channel = INCLINATION

    offset: PerLink = _each(unit="rad", doc="reading of the inclinometer of a horizontal link")

    def values(self, motion: Trajectory) -> Float[Array, "sample link"]:
        """Return the elevation of the direction of each link, with offsets."""

        def at(angles: Array) -> Array:
            along = pose(motion.arm, angles).direction
            return jnp.arctan2(along[2], safe_norm(along.at[2].set(0)))

        shown = jax.vmap(at)(motion.angles)
        return shown if self.offset is None else shown + per_row(self.offset, shown)


@register
class TensionSensor(AbstractSensor):
    """Force along its link that each joint transmits (`jointNN_tension`), N; tension positive."""

    kind: ClassVar[str] = "tension"
    channel = TENSION

    offset: PerLink = _each(
        unit="N", doc="reading of the tension sensor of an unloaded joint", per="joint"
    )

    def values(self, motion: Trajectory) -> Float[Array, "sample joint"]:
        """Return the force that pulls on the links beyond each joint, along the first of them."""

        def at(angles: Array, forces: Array) -> Array:
            return -dot(pose(motion.arm, angles).direction, forces.T)

        shown = jax.vmap(at)(motion.angles, motion.forces)
        return shown if self.offset is None else shown + per_row(self.offset, shown)


@register
class CurvatureSensor(AbstractSensor):
    """Curvature of the arm at each joint (`jointNN_curvature`), 1/m.

    It is the joint angle divided by the mean length of the two adjacent links. At the first joint
    it is divided by the length of the first link.
    """

    kind: ClassVar[str] = "curvature"
    channel = CURVATURE

    offset: PerLink = _each(
        unit="1/m", doc="reading of the curvature sensor of a straight joint", per="joint"
    )

    def values(self, motion: Trajectory) -> Float[Array, "sample joint"]:
        """Return the curvature with the sign of the joint angle, with offsets."""
        length = motion.arm.links.length
        before = jnp.concatenate([length[:1], length[:-1]])
        shown = motion.angles * (2 / (before + length))[None]
        return shown if self.offset is None else shown + per_row(self.offset, shown)
