"""Parts of an arm: links, joints, buoyancy, point masses, air, and the contact law."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Bool, Float, Scalar, larger, safe_norm, scaled, smaller
from ...runtime.text import InputError
from ...schema import AIR, BUOYANCY, CONTACT, JOINTS, LINKS, POINT_MASSES
from ...schema.parameters import inline, is_concrete, parameter
from ..obstacles import AbstractObstacle
from ._drag import AbstractDragLaw, CentreDrag, StripDrag
from ._joint_laws import (
    AbstractJointLaw,
    CoulombFriction,
    Damper,
    JointHysteresis,
    JointLaws,
    PerJoint,
)
from ._wind import AbstractWind

Axis = tuple[float, float, float]

PITCH: Axis = (0.0, -1.0, 0.0)
"""Axis of a pitch joint: a positive angle raises the arm."""

YAW: Axis = (0.0, 0.0, 1.0)
"""Axis of a yaw joint: a positive angle turns the arm to the left."""


def named_axes(axes: str | Sequence[str | Sequence[float]], count: int) -> tuple[Axis, ...]:
    """Return the unit axes (x, y, z) of joints in the frame of the straight arm.

    Arguments:
        axes: "pitch_yaw" (odd joints pitch, even joints yaw) or, for each joint, "pitch", "yaw"
            or a vector, which is normalised.
        count: number of joints.

    Raises:
        InputError: a name is unknown, a vector is zero, or the list does not have one axis for each
            joint.
    """
    if axes == "pitch_yaw":
        return tuple(YAW if joint % 2 else PITCH for joint in range(count))
    if isinstance(axes, str) or len(axes) != count:
        raise InputError(
            f'joint_axes is {axes!r}: give "pitch_yaw" or a list of {count} axes, '
            'each "pitch", "yaw" or [x, y, z]'
        )
    return tuple(_unit_axis(axis) for axis in axes)


def _unit_axis(axis: str | Sequence[float]) -> Axis:
    if isinstance(axis, str):
        try:
            return {"pitch": PITCH, "yaw": YAW}[axis]
        except KeyError:
            raise InputError(
                f'the joint axis {axis!r} is unknown: use "pitch", "yaw" or [x, y, z]'
            ) from None
    vector = np.asarray(axis, dtype=float)
    norm = np.linalg.norm(vector)
    if vector.shape != (3,) or not norm > 0:
        raise InputError(
            f"the joint axis {list(axis)} is not a direction: give three numbers, not all zero"
        )
    # A unit vector is not normalised again, so that an arm read from its file is identical.
    unit = vector if abs(norm - 1) < 1e-15 else vector / norm
    x, y, z = (float(component) for component in unit)
    return x, y, z


DRAGS = AbstractDragLaw.names_of_giajax
"""Where drag acts: at each link's centre (eq. 1), or along the link."""

DRAG_CURVES = ("constant", "cylinder")
"""How C_D depends on the Reynolds number."""

ADDED_MASSES = ("kirchhoff", "inertia")
"""Models of added mass: with terms quadratic in the velocities, or without them."""


class Air(eqx.Module):
    """The air: by default only the drag of eq. (1) of the paper; other effects are optional.

    - `drag = "centre"`: eq. (1), with the full velocity of the centre of each link.
    - `drag = "strip"`: cross-flow drag, which depends only on the velocity normal to the link. It
      is integrated along the link with `strip_points` Gauss points. `axial_coefficient` adds the
      drag along the link.
    - `drag_curve = "constant"`: C_D is `drag_coefficient`. "cylinder": C_D depends on the Reynolds
      number as for a smooth circular cylinder, scaled so that `drag_coefficient` is its value at
      Re = 1e5.
    - `added_mass_coefficient`: the air that a link accelerates in transverse motion.
    - `added_mass = "kirchhoff"`: added mass with the terms that follow from its energy, which are
      products of velocities. "inertia": added mass without these terms, as in engines that add it
      only to their mass matrix. Energy is then not conserved. This option is intended for
      comparison with such engines.
    - `wind`: a constant wind, added to that of the run.
    - `law`: a user-defined drag law that replaces the drag options, with parameters named
      `air.law.NAME`.
    - `wind_field`: a wind as a function of position and time, added to the other winds, with
      parameters named `air.wind_field.NAME`.
    """

    density: Scalar = parameter(AIR.density)
    drag_coefficient: Scalar = parameter(AIR.drag_coefficient)
    axial_coefficient: Scalar | None = parameter(AIR.axial_coefficient)
    added_mass_coefficient: Scalar | None = parameter(AIR.added_mass_coefficient)
    wind: Float[Array, "3"] | None = parameter(AIR.wind)
    viscosity: Scalar = parameter(AIR.viscosity)
    drag: str = eqx.field(static=True, default="centre")
    strip_points: int = eqx.field(static=True, default=3)
    drag_curve: str = eqx.field(static=True, default="constant")
    added_mass: str = eqx.field(static=True, default="kirchhoff")
    law: AbstractDragLaw | None = None
    wind_field: AbstractWind | None = None

    def __check_init__(self) -> None:
        choices = {"drag": DRAGS, "drag_curve": DRAG_CURVES, "added_mass": ADDED_MASSES}
        for name, known in choices.items():
            if (value := getattr(self, name)) not in known:
                raise InputError(f"{name} is {value!r}: use one of {', '.join(known)}")
        if self.strip_points < 1:
            raise InputError(f"strip_points is {self.strip_points}: give at least 1")
        if self.axial_coefficient is not None and self.drag == "centre" and self.law is None:
            raise InputError(
                "drag = 'centre' already uses the full velocity and has no axial coefficient: "
                "use drag = 'strip', or omit air.axial_coefficient"
            )

    @property
    def drag_law(self) -> AbstractDragLaw:
        """The drag law: `law`, or the law selected by `drag` and `drag_curve`."""
        if self.law is not None:
            return self.law
        if self.drag == "centre":
            return CentreDrag(coefficient=self.drag_coefficient, curve=self.drag_curve)
        return StripDrag(
            coefficient=self.drag_coefficient,
            axial=self.axial_coefficient,
            curve=self.drag_curve,
            points=self.strip_points,
        )


class Links(eqx.Module):
    """The rigid links. Each array has one element per link."""

    length: Float[Array, " link"] = parameter(LINKS.length)
    diameter: Float[Array, " link"] = parameter(LINKS.diameter)
    mass: Float[Array, " link"] = parameter(LINKS.mass)
    centre_of_mass: Float[Array, " link"] = parameter(LINKS.centre_of_mass)
    inertia_transverse: Float[Array, " link"] = parameter(LINKS.inertia_transverse)
    inertia_axial: Float[Array, " link"] = parameter(LINKS.inertia_axial)
    fullness: Float[Array, " link"] = parameter(LINKS.fullness)
    pressure: Float[Array, ""] | Float[Array, " link"] = parameter(LINKS.pressure)

    def __check_init__(self) -> None:
        shapes = {getattr(self, name).shape for name in self.__dataclass_fields__}
        shapes -= {()} if self.pressure.shape == () else set()
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise InputError(
                f"the arrays of Links have shapes {sorted(shapes)}: "
                "give each the shape (number of links,)"
            )

    @property
    def count(self) -> int:
        """Number of links."""
        return self.length.shape[0]

    @property
    def volume(self) -> Float[Array, " link"]:
        """Volume of air that each link displaces, m^3."""
        return np.pi / 4 * self.diameter**2 * self.length * self.fullness

    @property
    def neck_pressure(self) -> Float[Array, ""] | Float[Array, " joint"]:
        """Gauge pressure of the gas in the neck of each joint, Pa: the lower one of its two links.

        Half of a neck belongs to each link, and both halves bear the same moment, so the neck folds
        on the side with the lower pressure. The first joint has the pressure of the first link.
        """
        pressure = self.pressure
        if pressure.ndim == 0:
            return pressure
        return smaller(pressure, jnp.concatenate([pressure[:1], pressure[:-1]]))

    @property
    def end_force(self) -> Float[Array, " link"]:
        """Force p pi r^2 of the pressure on the end of each link, N.

        A link folds if muscles pull its end with a larger force.
        """
        return self.pressure * np.pi / 4 * self.diameter**2


class Joints(eqx.Module):
    """The joints: fixed axes, springs that pull towards the commanded angles, and dampers.

    `laws` contains further joint laws by name, whose torques are added. Their parameters have paths
    of the form `joints.laws.CLASS.NAME`. A joint whose axis in the straight arm is nearer to the
    vertical than to the horizontal is a yaw joint, which has the yaw stiffness. All other joints
    have the pitch stiffness.
    """

    axes: tuple[Axis, ...] = eqx.field(static=True)
    pitch_stiffness: Scalar = parameter(JOINTS.pitch_stiffness)
    yaw_stiffness: Scalar = parameter(JOINTS.yaw_stiffness)
    damping: Float[Array, ""] | PerJoint = parameter(JOINTS.damping)
    friction: Float[Array, ""] | PerJoint | None = parameter(JOINTS.friction)
    friction_rate: Scalar = parameter(JOINTS.friction_rate)
    armature: Float[Array, ""] | PerJoint | None = parameter(JOINTS.armature)
    drive_lag: Float[Array, ""] | PerJoint | None = parameter(JOINTS.drive_lag)
    drive_gain: Float[Array, ""] | PerJoint | None = parameter(JOINTS.drive_gain)
    drive_saturation: Float[Array, ""] | PerJoint | None = parameter(JOINTS.drive_saturation)
    stiffness_factor: Float[Array, ""] | PerJoint | None = parameter(JOINTS.stiffness_factor)
    stiffness_drift: Scalar | None = parameter(JOINTS.stiffness_drift)
    hysteresis: JointHysteresis = inline(default_factory=JointHysteresis)
    laws: dict[str, AbstractJointLaw] = eqx.field(default_factory=dict)

    def __check_init__(self) -> None:
        norms = np.linalg.norm(np.asarray(self.axes, dtype=float), axis=-1)
        if not np.allclose(norms, 1.0, rtol=0, atol=1e-12):
            raise InputError("a joint axis is not a unit vector: build the arm with chain(...)")

    @property
    def is_yaw(self) -> Bool[np.ndarray, " joint"]:
        """Whether each joint has the yaw stiffness."""
        return np.abs(np.asarray(self.axes))[:, 2] > np.sqrt(0.5)

    def at_time(self, time: Scalar) -> "Joints":
        """Return the joints with the stiffness at a time (s), if it drifts."""
        if self.stiffness_drift is None:
            return self
        usual = 1.0 if self.stiffness_factor is None else self.stiffness_factor
        # The stiffness of a joint that has lost its pressure is 0, not negative.
        grown = usual * larger(1 + self.stiffness_drift * time, 0)
        return dataclasses.replace(self, stiffness_factor=grown, stiffness_drift=None)

    @property
    def stiffness(self) -> PerJoint:
        """Stiffness of each joint at 0 s, N m/rad."""
        usual = jnp.where(self.is_yaw, self.yaw_stiffness, self.pitch_stiffness)
        return usual if self.stiffness_factor is None else usual * self.stiffness_factor

    @property
    def dampers(self) -> tuple[AbstractJointLaw, ...]:
        """The joint laws of damping and friction."""
        damper = Damper(self.damping)
        if self.friction is None:
            return (damper,)
        return damper, CoulombFriction(self.friction, self.friction_rate)

    @property
    def further_laws(self) -> JointLaws:
        """Hysteresis and `laws`: all laws except springs and dampers; only these have states."""
        return JointLaws((*self.hysteresis.laws, *self.laws.values()))


PerLink = Float[Array, ""] | Float[Array, " link"]
PerBody = Float[Array, ""] | Float[Array, " body"]


class Buoyancy(eqx.Module):
    """Buoyancy of the links, with helium and trim weights.

    The displaced air lifts each link at its centre. Helium and trim weights move with the link.
    With trim weights that balance the remaining lift (`trimmed`), each link is neutrally buoyant,
    and its total mass equals the mass of the displaced air, whatever its structural mass. The
    helium does not follow the rotation of the link about its longitudinal axis.
    """

    helium_density: Scalar = parameter(BUOYANCY.helium_density)
    trim_mass: PerLink = parameter(BUOYANCY.trim_mass)
    trim_position: PerLink = parameter(BUOYANCY.trim_position)
    trim_depth: PerLink | None = parameter(BUOYANCY.trim_depth)
    imbalance: PerLink | None = parameter(BUOYANCY.imbalance)
    imbalance_drift: PerLink | None = parameter(BUOYANCY.imbalance_drift)

    def at_time(self, time: Scalar) -> "Buoyancy":
        """Return the buoyancy with the imbalance at a time (s), if it drifts."""
        if self.imbalance_drift is None:
            return self
        grown = self.imbalance_drift * time
        grown = grown if self.imbalance is None else self.imbalance + grown
        return dataclasses.replace(self, imbalance=grown, imbalance_drift=None)


class PointMasses(eqx.Module):
    """Small bodies fixed to links, such as a camera at the tip, cables, tubes or a pendulum ball.

    Arguments:
        links: number of the link that carries each body, starting from 1.
        mass: mass of each body, kg.
        position: distance of each body from the joint of its link, along the link, m.
        left, up: distances of each body to the left of and above the link axis in the straight arm,
            m; None if all bodies are on the axis.
        drag_area: C_D A of each body, m^2; None if no body has drag.
    """

    links: tuple[int, ...] = eqx.field(static=True)
    mass: PerBody = parameter(POINT_MASSES.mass, default=False)
    position: PerBody = parameter(POINT_MASSES.position, default=False)
    left: PerBody | None = parameter(POINT_MASSES.left)
    up: PerBody | None = parameter(POINT_MASSES.up)
    drag_area: PerBody | None = parameter(POINT_MASSES.drag_area)

    def __check_init__(self) -> None:
        if not self.links or min(self.links) < 1:
            raise InputError(
                "a point mass has no link, or a link number below 1: number links from 1"
            )
        for name in ("mass", "position", "left", "up", "drag_area"):
            value = getattr(self, name)
            if value is not None and value.shape not in ((), (len(self.links),)):
                raise InputError(
                    f"the point masses have {len(self.links)} links and a {name} of shape "
                    f"{value.shape}: give one number, or one for each point mass"
                )


_ROUND = 1e-9  # tolerance for an axisymmetric inertia, relative to the inertia of the link
# Fraction of the mass of a link that is not axisymmetric that remains in the link itself. The rest
# is in its point masses.
_BARE = 1e-9


def six_points(
    mass: np.ndarray, centre: np.ndarray, inertia: np.ndarray, others: PointMasses | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, PointMasses | None]:
    """Represent each link that is not axisymmetric by six point masses.

    Two point masses lie on each principal axis. Together they have the mass, the centre of mass and
    the inertia of the link.

    Arguments:
        mass: mass of each link, kg, shape (link,).
        centre: centre of mass of each link relative to its joint, in the frame of the link, m,
            shape (link, 3).
        inertia: inertia of each link about its centre of mass, kg m^2, shape (link, 3, 3).
        others: point masses that the links carry in addition.

    Returns:
        Mass, axial and transverse moment of inertia that remain in the links, and all point masses.

    Raises:
        InputError: no rigid body can have such an inertia.
    """
    rows, links = [], []
    left, moments = np.array(mass), np.diagonal(inertia, axis1=1, axis2=2).copy()
    for link, (whole, place, tensor) in enumerate(zip(mass, centre, inertia, strict=True)):
        principal, axes = np.linalg.eigh(tensor)
        scale = principal.sum()
        if not (scale > 0 and 2 * principal[-1] <= (1 + 1e-6) * scale):
            raise InputError(
                f"no rigid body can have the inertia of link {link + 1}, whose principal moments "
                f"are {', '.join(f'{moment:.3g}' for moment in principal)} kg m^2: the largest "
                "must be positive, and at most the sum of the other two"
            )
        moment = moments[link]
        uneven = np.abs(tensor - np.diag(moment)).max() + abs(moment[1] - moment[2])
        offset = np.linalg.norm(place[1:])
        if uneven <= _ROUND * scale and whole * offset**2 <= _ROUND**2 * scale:
            continue
        left[link], moments[link] = whole * _BARE, _BARE * scale
        each = (whole - left[link]) / 6
        second = np.maximum(scale / 2 - principal, 0)
        for axis, reach in zip(axes.T, np.sqrt(second / (2 * each)), strict=True):
            rows += [(each, *(place + sign * reach * axis)) for sign in (-1, 1)]
            links += [link + 1] * 2
    if rows:
        columns = dict(zip(("mass", "position", "left", "up"), np.asarray(rows).T, strict=True))
        if others is not None:
            if others.drag_area is not None:
                columns["drag_area"] = np.zeros(len(rows))
            links += others.links
            for name, own in columns.items():
                value = getattr(others, name)
                carried = np.zeros(len(others.links)) + (
                    0.0 if value is None else np.asarray(value)
                )
                columns[name] = np.concatenate([own, carried])
        others = PointMasses(links=tuple(links), **columns)
    return left, moments[:, 0], moments[:, 1], others


def structural_points(
    mass: np.ndarray, links: Sequence[int], masses: np.ndarray
) -> Bool[np.ndarray, " point"]:
    """Return which point masses represent links themselves, as created by `six_points`.

    Arguments:
        mass: mass of each link, kg, shape (link,).
        links: number of the link of each point mass, starting from 1.
        masses: mass of each point mass, kg, shape (point,).
    """
    found = np.zeros(len(links), dtype=bool)
    for link in {link for link in links if link <= len(mass)}:
        first = np.flatnonzero(np.asarray(links) == link)[:6]
        found[first] = len(first) == 6 and mass[link - 1] < 10 * _BARE * np.sum(masses[first])
    return found


class Contact(eqx.Module):
    """Contact law: links are inextensible tubes under pressure, which obstacles flatten.

    Two plates that flatten a tube of length L and gauge pressure p by delta exert the force
    (pi / 2) p L delta, because the flat part has the width pi delta / 2. A single wall causes half
    of the flattening. If the distance of the link axis from a wall is smaller than the radius by w,
    the wall therefore exerts the force pi p w per unit of length (`shape_factor` is this pi).

    Friction is elastic up to the Coulomb limit. The skin of a link in contact sticks to the
    obstacle until the friction force reaches `friction` times the normal force, and then slides.
    The stretch of the skin is a state of shape (3, link), m. Without friction, there is no such
    state.

    Arguments:
        obstacles: obstacles around the arm, at least one.
        shape_factor: force divided by pressure, length and penetration.
        damping: damping coefficient, s/m. The normal force is multiplied by (1 + damping times
            closing speed) (Hunt and Crossley, J. Appl. Mech. 42 (1975) 440). It is therefore
            smaller while the contact opens. It is never negative, so contact never creates energy.
        friction: coefficient of friction; None for no friction.
        friction_stiffness: stiffness of a link along a surface to which it sticks, N/m.
        points: number of Gauss points on each of the three pieces of the contact between a link and
            a box.

    Raises:
        InputError: there is no obstacle, two obstacles have the same name, or the stiffness for
            friction is not positive.
    """

    obstacles: tuple[AbstractObstacle, ...]
    shape_factor: Scalar = parameter(CONTACT.shape_factor)
    damping: Scalar = parameter(CONTACT.damping)
    friction: Scalar | None = parameter(CONTACT.friction)
    friction_stiffness: Scalar = parameter(CONTACT.friction_stiffness)
    points: int = eqx.field(static=True, default=5)

    def __check_init__(self) -> None:
        if not self.obstacles:
            raise InputError(
                "contact is given without an obstacle: give at least one obstacle, or omit contact"
            )
        names = [obstacle.name for obstacle in self.obstacles]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"two obstacles are called '{twice}': give each its own name")
        stiffness = self.friction_stiffness
        if self.friction is not None and is_concrete(stiffness) and not float(stiffness) > 0:
            raise InputError(
                f"contact.friction_stiffness is {float(stiffness):g}: make it positive"
            )

    @property
    def former_pressure(self) -> Scalar:
        """Pressure that earlier versions stored here, kept for the keys of tasks.

        The pressure is now a parameter of the links.
        """
        return jnp.asarray(LINKS.pressure.default, jnp.result_type(float))

    @property
    def rows(self) -> int:
        """Number of friction states of each link."""
        return 0 if self.friction is None else 3

    def line(self, links: Links) -> Float[Array, " link"]:
        """Return the contact force per length and penetration for the pressures of links, N/m^2."""
        return self.shape_factor * jnp.broadcast_to(links.pressure, (links.count,))

    def hold(
        self, strain: Float[Array, "3 link"], normal: Float[Array, " link"]
    ) -> Float[Array, "3 link"]:
        """Return the stretch of the skin limited to what friction can hold, m.

        Arguments:
            strain: stretch of the skin of each link, m.
            normal: normal force on each link, N.
        """
        if self.friction is None:
            return strain
        most = self.friction * normal / self.friction_stiffness
        size = safe_norm(strain)
        over = size > most
        return scaled(jnp.where(over, most / jnp.where(over, size, 1), 1), strain)
