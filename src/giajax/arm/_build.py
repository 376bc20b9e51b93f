"""The general constructor of an arm."""

import dataclasses
from collections.abc import Mapping, Sequence
from inspect import signature
from typing import Any

import numpy as np

from .._errors import InputError
from ..joint import JointPair
from ..parameters import checked, declaration, find, switched_on
from ._arm import Arm
from ._atmosphere import Air
from ._axes import named_axes
from ._contact import Contact
from ._joints import Joints
from ._links import Links
from ._masses import Buoyancy, PointMasses
from ._muscled import muscles_in, without_idle_springs
from ._trim import trimmed


def chain(
    links: int = 20,
    *,
    length: Any = None,
    diameter: Any = None,
    mass: Any = None,
    centre_of_mass: Any = None,
    inertia_transverse: Any = None,
    inertia_axial: Any = None,
    joint_axes: str | Sequence[str | Sequence[float]] = "pitch_yaw",
    base_rotation: Any = (0.0, 0.0, 0.0),
    gravity: Any = 0.0,
    air_density: Any = None,
    drag: str = "centre",
    strip_points: int = 3,
    drag_curve: str = "constant",
    added_mass: str = "kirchhoff",
    buoyancy: bool = False,
    trim: bool = False,
    point_masses: PointMasses | None = None,
    muscles: str | Sequence[int] | None = None,
    pair: JointPair | None = None,
    contact: Contact | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> Arm:
    """Build an arm; by default that of the paper (`takeichi_20m`).

    Arguments:
        links: number of links.
        length, diameter: of a link, m; a number for all links or one per link.
        mass: of a link, kg; likewise.
        centre_of_mass: from the link's joint along the link, m; half the length by default.
        inertia_transverse, inertia_axial: about the centre of mass, kg m^2; those of a
            thin-walled tube of the link's mass, length and diameter by default.
        joint_axes: "pitch_yaw", or for each joint "pitch", "yaw" or a vector.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: along -z, m/s^2.
        air_density: kg/m^3.
        drag: "centre" (eq. 1) or "strip" (cross flow along the link, by `strip_points` points).
        strip_points: Gauss points of strip drag.
        drag_curve: "constant", or "cylinder": C_D follows the Reynolds number.
        added_mass: "kirchhoff", or "inertia": without the products of velocities.
        buoyancy: whether displaced air, helium and trim weights count; without gravity only
            their masses do.
        trim: hang the trim weights that make each link float, and float level unless
            `buoyancy.trim_position` is among `parameters`.
        point_masses: bodies fixed to links, such as a camera at the tip.
        muscles: joints that pairs of muscles drive in place of springs: "pitch", "all" or their
            numbers from 1 on; none by default.
        pair: the joint and the law of its muscles, the same in each; by default braided muscles,
            with corrections that are blended over 1 deg about 0.
        contact: obstacles around the arm, and how links press against them; none by default.
        parameters: values of any parameters by path, SI (`giajax parameters` lists them); one
            that is left out by default, such as `air.added_mass_coefficient`, is switched on.

    Returns:
        The arm, with the default stiffnesses, damping and drag coefficient.

    Raises:
        InputError: a pair without joints, a list whose length is not the number of links, a number
            that is not finite or, where physics needs it, not positive, an unknown path or choice,
            a link that is too heavy to float.

    Example:
        >>> import giajax
        >>> arm = giajax.chain(
        ...     3, length=[1.0, 0.8, 0.6], parameters={"air.added_mass_coefficient": 1.0}
        ... )
    """
    if pair is not None and muscles is None:
        raise InputError('a pair of muscles is in no joint: give muscles="pitch" as well')
    if links < 1:
        raise InputError(f"an arm of {links} links cannot be built: give at least 1")

    def per_link(name: str, value: Any, fallback: Any = None) -> Any:
        declared = declaration(Links, name)
        if value is None:
            value = declared.default if fallback is None else fallback
        array = np.asarray(value, dtype=float)
        if array.shape not in ((), (1,), (links,)):
            raise InputError(
                f"{name} has {array.size} values for {links} links: give one number or {links}"
            )
        if not np.all(np.isfinite(array)) or not np.all(array > declared.lower):
            raise InputError(
                f"{name} is out of bounds: "
                f"give finite numbers greater than {declared.lower:g} {declared.unit}"
            )
        return np.broadcast_to(array, (links,))

    length = per_link("length", length)
    diameter = per_link("diameter", diameter)
    mass = per_link("mass", mass)
    axial = mass * (diameter / 2) ** 2
    air = {} if air_density is None else {"density": air_density}
    joints = Joints(axes=named_axes(joint_axes, links))
    pneumatics = None if muscles is None else muscles_in(muscles, pair, joints)
    arm = Arm(
        links=Links(
            length=length,
            diameter=diameter,
            mass=mass,
            centre_of_mass=per_link("centre_of_mass", centre_of_mass, length / 2),
            inertia_transverse=per_link(
                "inertia_transverse", inertia_transverse, axial / 2 + mass * length**2 / 12
            ),
            inertia_axial=per_link("inertia_axial", inertia_axial, axial),
            **{name: per_link(name, None) for name in _OTHERS},
        ),
        joints=joints,
        air=Air(
            drag=drag,
            strip_points=strip_points,
            drag_curve=drag_curve,
            added_mass=added_mass,
            **air,
        ),
        buoyancy=Buoyancy(trim_position=length / 2) if buoyancy or trim else None,
        point_masses=point_masses,
        pneumatics=pneumatics,
        contact=contact,
        base_rotation=base_rotation,
        gravity=gravity,
    )
    values = dict(parameters or {})
    if trim and "buoyancy.trim_mass" in values:
        raise InputError(
            "trim computes buoyancy.trim_mass, which is among the parameters, too: leave one out"
        )
    arm = _with_parameters(arm, values)
    if pneumatics is not None:
        idle = without_idle_springs(arm.joints, pneumatics)
        arm = dataclasses.replace(arm, joints=idle)
    return trimmed(arm, level="buoyancy.trim_position" not in values) if trim else arm


# What of a link has no argument of its own.
_OTHERS = [name for name in Links.__dataclass_fields__ if name not in signature(chain).parameters]


def _with_parameters(arm: Arm, values: Mapping[str, Any]) -> Arm:
    for path, value in values.items():
        array = np.asarray(value, dtype=float)
        arm = switched_on(arm, [path])
        parameter = find(arm, path)
        allowed = [(), parameter.value(arm).shape]
        if parameter.declaration.each and not path.startswith("point_masses."):
            counted = parameter.any_number and array.ndim == 1
            allowed.append(array.shape if counted else (arm.count,))
        if array.shape not in allowed or not np.all(np.isfinite(array)):
            raise InputError(
                f"'{path}' has {array.size} values: give one finite number"
                + (f", or {allowed[-1][0]} of them" if allowed[-1] else "")
            )
        arm = parameter.set(arm, array)
    # Numbers of elements came one after the other.
    return checked(arm)
