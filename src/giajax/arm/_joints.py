"""The joints of an arm: axes, springs, dampers, friction and the inertia of drives."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import inline, parameter
from ..quantities import JOINTS
from ._axes import Axis
from ._hysteresis import JointHysteresis


class Joints(eqx.Module):
    """The joints: fixed axes, and a spring towards the commanded angle beside a damper.

    A joint whose axis is nearer to vertical than to horizontal (in its own straight pose) is a
    yaw joint and takes the yaw stiffness; every other one takes the pitch stiffness.
    """

    axes: tuple[Axis, ...] = eqx.field(static=True)
    pitch_stiffness: Scalar = parameter(JOINTS.pitch_stiffness)
    yaw_stiffness: Scalar = parameter(JOINTS.yaw_stiffness)
    damping: Float[Array, ""] | Float[Array, " joint"] = parameter(JOINTS.damping)
    friction: Float[Array, ""] | Float[Array, " joint"] | None = parameter(JOINTS.friction)
    friction_rate: Scalar = parameter(JOINTS.friction_rate)
    armature: Float[Array, ""] | Float[Array, " joint"] | None = parameter(JOINTS.armature)
    hysteresis: JointHysteresis = inline(default_factory=JointHysteresis)

    def __check_init__(self) -> None:
        norms = np.linalg.norm(np.asarray(self.axes, dtype=float), axis=-1)
        if not np.allclose(norms, 1.0, rtol=0, atol=1e-12):
            raise InputError("a joint axis is no unit vector: build the arm with chain(...)")

    @property
    def is_yaw(self) -> Bool[np.ndarray, " joint"]:
        """Which joints take the yaw stiffness."""
        return np.abs(np.asarray(self.axes))[:, 2] > np.sqrt(0.5)

    @property
    def stiffness(self) -> Float[Array, " joint"]:
        """Stiffness of each joint, N m/rad."""
        return jnp.where(self.is_yaw, self.yaw_stiffness, self.pitch_stiffness)

    def resistance(self, rates: Float[Array, " joint"]) -> Float[Array, " joint"]:
        """Torque against the motion of each joint, damping and friction, N m."""
        torque = self.damping * rates
        if self.friction is None:
            return torque
        return torque + self.friction * jnp.tanh(rates / self.friction_rate)

    @property
    def stiffest_damping(self) -> Float[Array, " joint"]:
        """Steepest slope of `resistance` of each joint, N m s/rad."""
        slope = self.damping
        if self.friction is not None:
            slope = slope + self.friction / self.friction_rate
        return jnp.broadcast_to(slope, (len(self.axes),))
