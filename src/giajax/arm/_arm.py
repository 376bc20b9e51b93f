"""The arm: a chain of rigid links, joints with a spring and a damper, and the air around it.

Frame: x along the straight arm away from the base, z up, y to the left; the origin is joint 1.
Joint i precedes link i. Angles are in radians and everything is SI.
"""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Float, Scalar
from ..parameters import inline, parameter
from ..quantities import BASE
from ._atmosphere import Air
from ._contact import Contact
from ._joints import Joints
from ._links import Links
from ._masses import Buoyancy, PointMasses
from ._pneumatics import Pneumatics


class Arm(eqx.Module):
    """A chain of links in air, fixed at its base.

    Build one with a preset (`takeichi_20m`) or with `chain`. Every array of it may be
    differentiated, batched and replaced (`giajax.replace`). What is None is left out, and costs
    nothing.

    Arguments:
        links: the rigid links.
        joints: axes, springs and dampers.
        air: what surrounds the links.
        buoyancy: helium and trim weights; None where lift and weight are no part of the model.
        point_masses: bodies fixed to links; None for none.
        pneumatics: muscles that drive joints, in place of their springs; None where springs do.
        contact: obstacles around the arm, and how links press against them; None for none.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: along -z, m/s^2.
    """

    links: Links
    joints: Joints
    air: Air
    buoyancy: Buoyancy | None = None
    point_masses: PointMasses | None = None
    pneumatics: Pneumatics | None = inline(default=None)
    contact: Contact | None = None
    base_rotation: Float[Array, "3"] = parameter(BASE.base_rotation)
    gravity: Scalar = parameter(BASE.gravity)

    def __check_init__(self) -> None:
        if len(self.joints.axes) != self.links.count:
            raise InputError(
                f"{len(self.joints.axes)} joint axes for {self.links.count} links: "
                "give one axis per link"
            )
        if self.point_masses is not None and max(self.point_masses.links) > self.links.count:
            raise InputError(
                f"a point mass is on link {max(self.point_masses.links)} of an arm of "
                f"{self.links.count} links: correct the number"
            )
        if self.pneumatics is not None and self.pneumatics.joints[-1] > self.links.count:
            raise InputError(
                f"joint {self.pneumatics.joints[-1]} has muscles, but the arm has "
                f"{self.links.count} joints: correct the number"
            )

    @property
    def count(self) -> int:
        """Number of links, which is the number of joints and of degrees of freedom."""
        return self.links.count

    @property
    def spring_stiffness(self) -> Float[Array, " joint"]:
        """Stiffness of the spring of each joint about its command, N m/rad; 0 with muscles."""
        if self.pneumatics is None:
            return self.joints.stiffness
        driven = np.isin(np.arange(self.count), np.asarray(self.pneumatics.joints) - 1)
        return jnp.where(driven, 0, self.joints.stiffness)

    @property
    def stiffest_spring(self) -> Float[Array, " joint"]:
        """Largest stiffness of each joint: of spring or muscles, and hysteresis, N m/rad."""
        stiffest = self.spring_stiffness + self.joints.hysteresis.stiffness
        if self.pneumatics is None:
            return stiffest
        return stiffest + self.pneumatics.stiffest(self.count)
