"""The arm: a chain of rigid links, joints with a spring and a damper, and the air around it.

Frame: x along the straight arm away from the base, z up, y to the left; the origin is joint 1.
Joint i precedes link i. Angles are in radians and everything is SI.
"""

from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from .._typing import Array, Bool, Float, Scalar
from ..parameters import parameter
from ._masses import Buoyancy, PointMasses

Axis = tuple[float, float, float]

PITCH: Axis = (0.0, -1.0, 0.0)
"""Axis of a pitch joint: a positive angle raises the arm."""

YAW: Axis = (0.0, 0.0, 1.0)
"""Axis of a yaw joint: a positive angle turns the arm to the left."""

DRAGS = ("centre", "strip")
"""Where drag acts: at each link's centre (eq. 1), or along the link."""

DRAG_CURVES = ("constant", "cylinder")
"""How C_D depends on the Reynolds number."""


def check_choice(name: str, value: str, choices: Sequence[str]) -> None:
    """Refuse a value that is not among the choices.

    Raises:
        InputError: naming the choices.
    """
    if value not in choices:
        raise InputError(f"{name} is {value!r}; use one of: {', '.join(choices)}")


class Links(eqx.Module):
    """The rigid links, one element of each array per link."""

    length: Float[Array, " link"] = parameter(
        0.99, unit="m", lower=0, doc="length of a link, joint to joint"
    )
    diameter: Float[Array, " link"] = parameter(
        0.3, unit="m", lower=0, doc="diameter of a link, as the air sees it"
    )
    mass: Float[Array, " link"] = parameter(
        0.047, unit="kg", lower=0, doc="mass of a link that moves with it"
    )
    centre_of_mass: Float[Array, " link"] = parameter(
        0.495, unit="m", doc="distance of a link's centre of mass from its joint, along the link"
    )
    # A thin-walled tube of mass 0.047 kg, length 0.99 m and diameter 0.3 m.
    inertia_transverse: Float[Array, " link"] = parameter(
        0.004367475,
        unit="kg m^2",
        lower=0,
        assumed=True,
        doc="moment of inertia about a transverse axis through the centre of mass (thin tube)",
    )
    inertia_axial: Float[Array, " link"] = parameter(
        0.0010575,
        unit="kg m^2",
        lower=0,
        assumed=True,
        doc="moment of inertia about the link's own axis (thin tube)",
    )
    fullness: Float[Array, " link"] = parameter(
        1.0,
        unit="",
        lower=0,
        assumed=True,
        doc="displaced volume of a link over that of the cylinder of its length and diameter",
    )

    def __check_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in self.__dataclass_fields__}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise InputError(
                f"the arrays of Links have shapes {sorted(shapes)}; "
                "give each the shape (number of links,)"
            )

    @property
    def count(self) -> int:
        """Number of links."""
        return self.length.shape[0]

    @property
    def volume(self) -> Float[Array, " link"]:
        """Air that each link displaces, m^3."""
        return np.pi / 4 * self.diameter**2 * self.length * self.fullness


class Joints(eqx.Module):
    """The joints: fixed axes, and a spring towards the commanded angle beside a damper.

    A joint whose axis is nearer to vertical than to horizontal (in its own straight pose) is a
    yaw joint and takes the yaw stiffness; every other one takes the pitch stiffness.
    """

    axes: tuple[Axis, ...] = eqx.field(static=True)
    pitch_stiffness: Scalar = parameter(
        3.0,
        unit="N m/rad",
        lower=0,
        upper=1e3,
        frozen=False,
        assumed=True,
        doc="stiffness of a pitch joint about its commanded angle",
    )
    yaw_stiffness: Scalar = parameter(
        30.0,
        unit="N m/rad",
        lower=0,
        upper=1e4,
        frozen=False,
        assumed=True,
        doc="stiffness of a yaw joint about its commanded angle",
    )
    damping: Float[Array, ""] | Float[Array, " joint"] = parameter(
        0.05,
        unit="N m s/rad",
        each=True,
        lower=0,
        upper=1e2,
        frozen=False,
        assumed=True,
        doc="viscous damping of a joint's own rate (one number, or one per joint)",
    )
    friction: Float[Array, ""] | Float[Array, " joint"] | None = parameter(
        0.1,
        unit="N m",
        each=True,
        lower=0,
        upper=1e3,
        optional=True,
        doc="Coulomb friction of a joint (one number, or one per joint)",
    )
    friction_rate: Scalar = parameter(
        0.05,
        unit="rad/s",
        lower=0,
        assumed=True,
        doc="rate at which Coulomb friction has reached tanh(1) = 76 % of its value",
    )
    armature: Float[Array, ""] | Float[Array, " joint"] | None = parameter(
        1e-3,
        unit="kg m^2",
        each=True,
        lower=0,
        optional=True,
        doc="inertia of a joint's drive, reflected to the joint (one number, or one per joint)",
    )

    def __check_init__(self) -> None:
        norms = np.linalg.norm(np.asarray(self.axes, dtype=float), axis=-1)
        if not np.allclose(norms, 1.0, rtol=0, atol=1e-12):
            raise InputError("joint axes must be unit vectors; build the arm with chain(...)")

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


class Air(eqx.Module):
    """The air: by default as the paper's eq. (1) sees it, and on request all of it.

    - `drag = "centre"`: eq. (1), with the full velocity of each link's centre.
    - `drag = "strip"`: cross-flow drag, from the velocity normal to the link alone, integrated
      along the link by `strip_points` Gauss points; `axial_coefficient` adds what acts along it.
    - `drag_curve = "constant"`: C_D is `drag_coefficient`. "cylinder": it follows the Reynolds
      number as that of a smooth circular cylinder does, scaled so that `drag_coefficient` is its
      value at Re = 1e5.
    - `added_mass_coefficient`: the air that a link must move out of its way (Kirchhoff).
    - `wind`: a constant wind, beside that of the run.
    """

    density: Scalar = parameter(
        1.204, unit="kg/m^3", lower=0, doc="density of the air (20 C, 1 atm)"
    )
    drag_coefficient: Scalar = parameter(
        1.2,
        unit="",
        lower=0,
        upper=50,
        frozen=False,
        assumed=True,
        doc="drag coefficient C_D of eq. (1), referred to length times diameter",
    )
    axial_coefficient: Scalar | None = parameter(
        0.02,
        unit="",
        lower=0,
        upper=50,
        optional=True,
        assumed=True,
        doc="coefficient of the drag along a link, referred to length times diameter (strip drag)",
    )
    added_mass_coefficient: Scalar | None = parameter(
        1.0,
        unit="",
        lower=0,
        upper=10,
        optional=True,
        doc="added mass across a link over the air that it displaces (1 for a long cylinder)",
    )
    wind: Float[Array, "3"] | None = parameter(
        0.0,
        unit="m/s",
        shape=(3,),
        optional=True,
        doc="constant velocity of the air in the base frame, beside the wind of the run",
    )
    viscosity: Scalar = parameter(
        1.516e-5, unit="m^2/s", lower=0, doc="kinematic viscosity of the air (20 C, 1 atm)"
    )
    drag: str = eqx.field(static=True, default="centre")
    strip_points: int = eqx.field(static=True, default=3)
    drag_curve: str = eqx.field(static=True, default="constant")

    def __check_init__(self) -> None:
        check_choice("drag", self.drag, DRAGS)
        check_choice("drag_curve", self.drag_curve, DRAG_CURVES)
        if self.strip_points < 1:
            raise InputError(f"strip_points is {self.strip_points}; give at least 1")
        if self.axial_coefficient is not None and self.drag == "centre":
            raise InputError(
                'an axial coefficient needs drag = "strip": eq. (1) has the full velocity already'
            )


class Arm(eqx.Module):
    """A chain of links in air, fixed at its base.

    Build one with a preset (`takeichi_20m`) or with `chain`. Every array of it may be
    differentiated, batched and replaced (`giajax.replace`). What is None is left out, and costs
    nothing.
    """

    links: Links
    joints: Joints
    air: Air
    buoyancy: Buoyancy | None = None
    point_masses: PointMasses | None = None
    base_rotation: Float[Array, "3"] = parameter(
        0.0,
        unit="rad",
        shape=(3,),
        doc="turn of the straight arm against the base frame, as a rotation vector",
    )
    gravity: Scalar = parameter(
        0.0,
        unit="m/s^2",
        doc="acceleration of gravity along -z; 0 where buoyancy balances weight",
    )

    def __check_init__(self) -> None:
        if len(self.joints.axes) != self.links.count:
            raise InputError(
                f"{len(self.joints.axes)} joint axes for {self.links.count} links; "
                "give one axis per link"
            )
        if self.point_masses is not None and max(self.point_masses.links) > self.links.count:
            raise InputError(
                f"a point mass is on link {max(self.point_masses.links)} of an arm of "
                f"{self.links.count} links; correct the number"
            )

    @property
    def count(self) -> int:
        """Number of links, which is the number of joints and of degrees of freedom."""
        return self.links.count


def named_axes(axes: str | Sequence[str | Sequence[float]], count: int) -> tuple[Axis, ...]:
    """Unit axes of the joints from their names.

    Arguments:
        axes: "pitch_yaw" (odd joints pitch, even joints yaw) or, for each joint, "pitch", "yaw"
            or a vector, which is normalised.
        count: number of joints.

    Raises:
        InputError: an unknown name, a zero vector, or a list of another length.
    """
    if axes == "pitch_yaw":
        return tuple(YAW if joint % 2 else PITCH for joint in range(count))
    if isinstance(axes, str) or len(axes) != count:
        raise InputError(
            f'joint_axes is {axes!r}; give "pitch_yaw" or a list of {count} axes, '
            'each "pitch", "yaw" or [x, y, z]'
        )
    return tuple(_unit_axis(axis) for axis in axes)


def _unit_axis(axis: str | Sequence[float]) -> Axis:
    if isinstance(axis, str):
        try:
            return {"pitch": PITCH, "yaw": YAW}[axis]
        except KeyError:
            raise InputError(
                f'the joint axis {axis!r} is unknown; use "pitch", "yaw" or [x, y, z]'
            ) from None
    vector = np.asarray(axis, dtype=float)
    norm = np.linalg.norm(vector)
    if vector.shape != (3,) or not norm > 0:
        raise InputError(f"the joint axis {list(axis)} must be three numbers, not all zero")
    # A unit vector stays as it is, so that an arm comes back from its file bit for bit.
    unit = vector if abs(norm - 1) < 1e-15 else vector / norm
    x, y, z = (float(component) for component in unit)
    return x, y, z
