"""The arm, and the rigid body that each of its links is with everything that moves with it."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Float, Scalar
from ...runtime.text import InputError
from ...schema import BASE
from ...schema.parameters import inline, parameter
from ._parts import Air, Buoyancy, Contact, Joints, Links, PointMasses
from ._pneumatics import Pneumatics

# Frame: x along the straight arm away from the base, z up, y to the left; the origin is joint 1.
# Joint i precedes link i. Angles are in radians and everything is SI.


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


# The rigid body that each link is, with everything that moves with it.

PerLink = Float[Array, " link"]


class Bodies(NamedTuple):
    """Mass, centre of mass and inertia of each link with all that it carries.

    Attributes:
        mass: kg.
        along: distance of the centre of mass from the joint, along the link, m.
        transverse, axial: moments of inertia about the centre of mass of a body that is round
            about the link's axis, kg m^2.
        across: the centre of mass to the left of and above the link's axis, m; None where
            everything lies on the axis.
        uneven: what the inertia has beyond the round body: xx, yy, zz, xy, xz, yz in the link's
            frame, kg m^2; None where everything lies on the axis.
    """

    mass: PerLink
    along: PerLink
    transverse: PerLink
    axial: PerLink
    across: Float[Array, "2 link"] | None
    uneven: Float[Array, "6 link"] | None


class _Point(NamedTuple):
    mass: Array
    x: Array
    y: Array | None = None
    z: Array | None = None


def bodies(arm: Arm) -> Bodies:
    """The bodies of an arm's links, their own structure, helium, trim weights and point masses.

    Arguments:
        arm: the arm.

    Returns:
        Mass, centre of mass and inertia of each link with all that it carries.
    """
    links = arm.links
    transverse, axial = links.inertia_transverse, links.inertia_axial
    points = _points(arm)
    if not points:
        return Bodies(links.mass, links.centre_of_mass, transverse, axial, None, None)
    points = [_Point(links.mass, links.centre_of_mass), *points]
    if arm.buoyancy is not None:
        helium = arm.buoyancy.helium_density * links.volume
        # A uniform cylinder of gas, which does not take part in a spin about its own axis.
        transverse = transverse + helium * (links.length**2 / 12 + links.diameter**2 / 16)
    mass = sum((point.mass for point in points), jnp.zeros_like(links.mass))
    along = sum((point.mass * point.x for point in points), jnp.zeros_like(mass)) / mass
    spread = sum((point.mass * (point.x - along) ** 2 for point in points), jnp.zeros_like(mass))
    if all(point.y is None and point.z is None for point in points):
        return Bodies(mass, along, transverse + spread, axial, None, None)
    zero = jnp.zeros_like(mass)
    left = sum((p.mass * p.y for p in points if p.y is not None), zero) / mass
    up = sum((p.mass * p.z for p in points if p.z is not None), zero) / mass
    uneven = jnp.zeros((6, arm.count), mass.dtype)
    for point in points:
        dx = point.x - along
        dy = -left if point.y is None else point.y - left
        dz = -up if point.z is None else point.z - up
        square = dx * dx + dy * dy + dz * dz
        uneven = uneven + point.mass[None] * jnp.stack(
            [square - dx * dx, square - dy * dy, square - dz * dz, -dx * dy, -dx * dz, -dy * dz]
        )
    return Bodies(mass, along, transverse, axial, jnp.stack([left, up]), uneven)


def _points(arm: Arm) -> list[_Point]:
    """Point masses in the frame of each link, as rows over all links."""
    count, points = arm.count, []

    def row(value: Array) -> PerLink:
        return jnp.broadcast_to(value, (count,))

    if arm.buoyancy is not None:
        held = arm.buoyancy
        points.append(_Point(held.helium_density * arm.links.volume, arm.links.length / 2))
        depth = None if held.trim_depth is None else -row(held.trim_depth)
        points.append(_Point(row(held.trim_mass), row(held.trim_position), None, depth))
    if arm.point_masses is not None:
        fixed = arm.point_masses
        for together in _no_link_twice(fixed.links):
            places = np.asarray([fixed.links[i] - 1 for i in together])

            def spread_out(value: Array, places: Any = places, which: Any = together) -> PerLink:
                each = jnp.broadcast_to(value, (len(fixed.links),))[np.asarray(which)]
                return jnp.zeros(count, value.dtype).at[places].set(each)

            y, z = (None if v is None else spread_out(v) for v in (fixed.left, fixed.up))
            points.append(_Point(spread_out(fixed.mass), spread_out(fixed.position), y, z))
    return points


def _no_link_twice(links: tuple[int, ...]) -> list[list[int]]:
    """Positions in the list, in groups in which no link is named twice."""
    groups: list[list[int]] = []
    for index, link in enumerate(links):
        free = [group for group in groups if link not in {links[i] for i in group}]
        if free:
            free[0].append(index)
        else:
            groups.append([index])
    return groups


def lift(arm: Arm) -> PerLink | None:
    """Force of the air on each link at its centre, upwards, N; None without buoyancy.

    Arguments:
        arm: the arm.

    Returns:
        Force, N, shape (link,), or None.
    """
    if arm.buoyancy is None:
        return None
    upwards = arm.air.density * arm.links.volume * arm.gravity
    if arm.buoyancy.imbalance is not None:
        upwards = upwards + arm.buoyancy.imbalance
    return upwards
