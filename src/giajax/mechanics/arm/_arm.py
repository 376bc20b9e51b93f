"""The arm, the rigid bodies that its links are, and how arms are made: trim and presets."""

import dataclasses
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from inspect import signature
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...runtime.arrays import Array, Float, Scalar, rotate, rotation_vector_to_quaternion
from ...runtime.plugins import law_named, name_of, registered
from ...runtime.text import InputError, ShownAsTable, format_estimate
from ...schema import AIR, BASE, BUOYANCY, LINKS, NO_NEUTRAL, POINT_MASSES
from ...schema.parameters import (
    checked,
    declaration,
    find,
    inline,
    is_concrete,
    parameter,
    parameter_rows,
    switched_on,
)
from ..joint import JointPair
from ._drag import AbstractDragLaw, check_drag_law
from ._joint_laws import AbstractJointLaw, JointLaws, Spring
from ._joint_trial import check_joint_law
from ._parts import (
    DRAGS,
    PITCH,
    YAW,
    Air,
    Buoyancy,
    Contact,
    Joints,
    Links,
    PointMasses,
    named_axes,
    six_points,
)
from ._pneumatics import Pneumatics, idle_springs, muscles_in
from ._wind import AbstractWind, as_wind, check_wind

# Frame: x along the straight arm away from the base, z up, y to the left; the origin is joint 1.
# Joint i precedes link i. Angles are in radians and everything is SI.


class Arm(ShownAsTable, eqx.Module):
    """A chain of links in air, fixed at its base.

    Build one with a preset (`takeichi_20m`), or your own with `chain`. Every array of it may be
    differentiated, batched and replaced (`giajax.replace`). What is None is left out, and costs
    nothing.

    Arguments:
        links: the rigid links.
        joints: axes, springs and dampers.
        air: what surrounds the links.
        buoyancy: helium and trim weights; None where lift and weight are not part of the model.
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
                "give one axis for each link"
            )
        if self.point_masses is not None and max(self.point_masses.links) > self.links.count:
            raise InputError(
                f"a point mass is on link {max(self.point_masses.links)} of an arm with only "
                f"{self.links.count} links: correct the number"
            )
        if self.pneumatics is not None and self.pneumatics.joints[-1] > self.links.count:
            raise InputError(
                f"joint {self.pneumatics.joints[-1]} has muscles, but the arm has only "
                f"{self.links.count} joints: correct the number"
            )
        driven = [type(law).__name__ for law in self.further_laws.laws if law.takes_pressures]
        if len(driven) > 1:
            raise InputError(
                f"{' and '.join(driven)} both take pressures: use only one such law in an arm"
            )

    @property
    def count(self) -> int:
        """Number of links, which is the number of joints and of degrees of freedom."""
        return self.links.count

    @property
    def spring_stiffness(self) -> Float[Array, " joint"]:
        """Stiffness of the spring of each joint about its command, N m/rad; 0 with muscles."""
        own = () if self.pneumatics is None else self.pneumatics.joints
        driven = np.isin(np.arange(self.count) + 1, np.asarray(own))
        return jnp.where(driven, 0, self.joints.stiffness) if own else self.joints.stiffness

    @property
    def joint_laws(self) -> JointLaws:
        """What acts in the joints: springs, dampers, hysteresis, more laws, and muscles."""
        laws = (*self.joints.dampers, *self.further_laws.laws)
        return JointLaws((Spring(self.spring_stiffness), *laws))

    @property
    def further_laws(self) -> JointLaws:
        """What acts beside springs and dampers, and has all states: of `joints`, and muscles."""
        muscles = () if self.pneumatics is None else (self.pneumatics.in_links(self.links),)
        return JointLaws((*self.joints.further_laws.laws, *muscles))

    def _table(self) -> tuple[str, Sequence[str], Sequence[Sequence[str]]]:
        links, law, laws = self.links, self.air.drag_law, self.joint_laws.laws
        axes = Counter({PITCH: "pitch", YAW: "yaw"}.get(axis, "other") for axis in self.joints.axes)
        mass = sum(np.sum(part.mass, axis=-1) for part in (links, self.point_masses) if part)
        drag = type(law).__name__
        if self.air.law is None:
            drag += f", C_D {_in_text(self.air.drag_coefficient)}"
        rows = {
            "length": f"{_in_text(np.sum(links.length, axis=-1))} m",
            "diameter": f"{_in_text(links.diameter)} m",
            "mass": f"{_in_text(mass)} kg, without helium and trim weights",
            "joints": ", ".join(f"{count} {name}" for name, count in axes.items()),
            "joint laws": ", ".join(dict.fromkeys(type(law).__name__ for law in laws)),
            "drag": f"{drag}, in air of {_in_text(self.air.density)} kg/m^3",
        }
        others = {
            "helium": self.buoyancy,
            "point masses": self.point_masses,
            "muscles": self.pneumatics,
            "obstacles": self.contact,
            "a wind field": self.air.wind_field,
        }
        rows["also"] = ", ".join(name for name, part in others.items() if part is not None) or "-"
        rows |= parameter_rows(self)
        return f"arm of {self.count} link{'s' * (self.count > 1)}", ("", ""), list(rows.items())


def _in_text(values: Any) -> str:
    return format_estimate(np.ravel(values).tolist(), None)[0]


PerLink = Float[Array, " link"]


class Bodies(NamedTuple):
    """The rigid body that each link is, with all that it carries.

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
    """The bodies of an arm's links, their own structure, helium, trim weights and point masses."""
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
        # In groups in which no link is named twice.
        turns = np.asarray([fixed.links[:i].count(link) for i, link in enumerate(fixed.links)])
        for turn in range(max(turns) + 1):
            which = np.flatnonzero(turns == turn)

            def spread_out(value: Array, which: Any = which) -> PerLink:
                each = jnp.broadcast_to(value, (len(fixed.links),))[which]
                places = np.asarray(fixed.links)[which] - 1
                return jnp.zeros(count, value.dtype).at[places].set(each)

            y, z = (None if v is None else spread_out(v) for v in (fixed.left, fixed.up))
            points.append(_Point(spread_out(fixed.mass), spread_out(fixed.position), y, z))
    return points


def lift(arm: Arm) -> PerLink | None:
    """Force of the air on each link at its centre, upwards, N; None without buoyancy."""
    if arm.buoyancy is None:
        return None
    upwards = arm.air.density * arm.links.volume * arm.gravity
    if arm.buoyancy.imbalance is not None:
        upwards = upwards + arm.buoyancy.imbalance
    return upwards


def net_lift(arm: Arm) -> Float[Array, " link"]:
    """Mass that each link could still carry, kg: displaced air less all that moves with it.

    Negative where a link is too heavy to float.

    Raises:
        InputError: the arm leaves buoyancy out.
    """
    if arm.buoyancy is None:
        raise InputError("this arm has no buoyancy: build it with buoyancy=True")
    return arm.air.density * arm.links.volume - bodies(arm).mass


def trimmed(arm: Arm, *, level: bool = False) -> Arm:
    """The arm with the trim weights that make each link float, in place of those that it has.

    Arguments:
        level: also hang them where each link floats level: its centre of mass is then at the
            same distance along the link as its lift. Otherwise they hang where they are.

    Raises:
        InputError: it leaves buoyancy out, a link is too heavy to float, or its weight would
            hang beyond its ends.
    """
    if arm.buoyancy is None:
        raise InputError("this arm has no buoyancy: build it with buoyancy=True")
    bare = dataclasses.replace(arm.buoyancy, trim_mass=jnp.zeros_like(arm.links.mass))
    weights = net_lift(dataclasses.replace(arm, buoyancy=bare))
    if is_concrete(weights) and np.any(np.asarray(weights) < 0):
        link = int(np.argmin(np.asarray(weights))) + 1
        raise InputError(
            f"link {link} is {-float(weights[link - 1]):.3g} kg too heavy to float, so no trim "
            "weight balances it: make the link lighter or larger"
        )
    changes = {"trim_mass": weights}
    if level:
        changes["trim_position"] = _level(arm, bare, weights)
    return dataclasses.replace(arm, buoyancy=dataclasses.replace(bare, **changes))


def _level(arm: Arm, bare: Buoyancy, weights: Float[Array, " link"]) -> Float[Array, " link"]:
    """Where the weights hang, so that mass and displaced air balance about every point."""
    length = arm.links.length
    other = bodies(dataclasses.replace(arm, buoyancy=bare))
    moment = other.mass * (length / 2 - other.along)
    # Without a weight there is no place for it, and no moment that it could balance.
    place = length / 2 + moment / jnp.where(weights > 0, weights, jnp.inf)
    if is_concrete(place) and np.any(np.asarray((place < 0) | (place > length))):
        link = int(np.argmax(np.asarray(abs(place - length / 2) - length / 2))) + 1
        raise InputError(
            f"link {link} floats level only with its trim weight {float(place[link - 1]):.3g} m "
            f"along a link of {float(length[link - 1]):.3g} m: give buoyancy.trim_position"
        )
    return place


STANDARD_GRAVITY = 9.80665


def chain(
    links: int,
    *,
    length: Any = None,
    diameter: Any = None,
    mass: Any = None,
    centre_of_mass: Any = None,
    inertia_transverse: Any = None,
    inertia_axial: Any = None,
    inertia: Any = None,
    joint_axes: str | Sequence[str | Sequence[float]] | None = None,
    base_rotation: Any = (0.0, 0.0, 0.0),
    gravity: Any = STANDARD_GRAVITY,
    air_density: Any = None,
    drag: str | AbstractDragLaw = "centre",
    strip_points: int = 3,
    drag_curve: str = "constant",
    added_mass: str = "kirchhoff",
    joint_laws: Sequence[str | AbstractJointLaw] = (),
    wind_field: str | AbstractWind | Callable[..., Any] | None = None,
    buoyancy: bool = False,
    trim: bool = False,
    point_masses: PointMasses | None = None,
    muscles: str | Sequence[int] | None = None,
    pair: JointPair | None = None,
    contact: Contact | None = None,
    parameters: Mapping[str, Any] | None = None,
) -> Arm:
    """Build an arm of your own.

    What has no neutral value must be given: length, diameter, mass, `joint_axes`, and among the
    parameters `joints.pitch_stiffness` and `joints.yaw_stiffness` of joints that springs drive, and
    `joints.damping` (0 is a value). All else is absent, or as here.

    Arguments:
        length, diameter, mass: of a link, m and kg; a number for all links or one per link.
        centre_of_mass: from the link's joint along the link, m; half the length by default.
        inertia_transverse, inertia_axial: about the centre of mass, kg m^2; those of a
            thin-walled tube of the link's mass, length and diameter by default.
        inertia: in place of these two, of a link that is not round about its axis: xx, yy, zz, xy,
            xz, yz in the link's frame (x along it, z up in the straight arm), about its centre of
            mass, kg m^2, shape (6,) or (link, 6). Such a link is its mass in six points.
        joint_axes: "pitch_yaw", or for each joint "pitch", "yaw" or a vector.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: along -z, m/s^2; 0 where buoyancy balances weight.
        air_density: kg/m^3; that of air at 20 C by default.
        drag: a word of `Air`, a law of drag, or the name of a registered one (`giajax.register`).
        strip_points, drag_curve, added_mass: as of `Air`.
        joint_laws: laws of the joints beside springs, dampers and hysteresis, or their names:
            "hardening", "end_stops", or that of a registered one.
        wind_field: a wind that is a function of place and time (`with_wind`), or the name of a
            registered one; none by default.
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
            C_D is 1 by default.

    Raises:
        InputError: a value that is missing, a pair without joints, a list whose length is not the
            number of links, a number that is not finite or, where physics needs it, not positive,
            an unknown path or choice, a link that is too heavy to float.

    Example:
        >>> import giajax
        >>> arm = giajax.chain(
        ...     2,
        ...     length=[0.8, 0.6],
        ...     diameter=0.05,
        ...     mass=0.1,
        ...     joint_axes=["pitch", [0, 0.6, 0.8]],
        ...     parameters={
        ...         "joints.pitch_stiffness": 2.0,
        ...         "joints.yaw_stiffness": 3.0,
        ...         "joints.damping": 0.01,
        ...     },
        ... )
    """
    if pair is not None and muscles is None:
        raise InputError(
            'a law of muscles is given, but no joint has muscles: give muscles="pitch" as well'
        )
    if links < 1:
        raise InputError(f"an arm of {links} links cannot be built: give at least 1")
    values = dict(parameters or {})
    # Without axes nothing is built: their absence is named with all that is missing.
    axes = named_axes("pitch_yaw" if joint_axes is None else joint_axes, links)
    joints = Joints(axes=axes, laws=_laws_of(joint_laws))
    pneumatics = None if muscles is None else muscles_in(muscles, pair, joints)
    idle = idle_springs(joints, pneumatics)
    given = {"links.length": length, "links.diameter": diameter, "links.mass": mass}
    # A size among the parameters is one as the argument is: inertias follow from it.
    given = {path: values.pop(path, None) if one is None else one for path, one in given.items()}
    length, diameter, mass = given.values()
    _check_stated({**values, **given}, joint_axes, idle)
    joints = dataclasses.replace(joints, **idle)

    def per_link(name: str, value: Any, fallback: Any = None) -> Any:
        declared = declaration(Links, name)
        if value is None:
            value = declared.default if fallback is None else fallback
        array = np.asarray(value, dtype=float)
        if array.shape not in ((), (1,), (links,)):
            raise InputError(
                f"{name} has {array.size} values for {links} links: give one number, or {links}"
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
    centre_of_mass = per_link("centre_of_mass", centre_of_mass, length / 2)
    axial = mass * (diameter / 2) ** 2
    if inertia is not None:
        if inertia_transverse is not None or inertia_axial is not None:
            raise InputError(
                "inertia already contains the transverse and axial inertias: omit these two"
            )
        centre = np.stack([centre_of_mass, *np.zeros((2, links))], axis=1)
        whole = six_points(mass, centre, _tensors(inertia, links), point_masses)
        mass, inertia_axial, inertia_transverse, point_masses = whole
    air: dict[str, Any] = {"strip_points": strip_points, "drag_curve": drag_curve}
    air |= {"drag": drag, "added_mass": added_mass, "drag_coefficient": 1.0}
    law = None
    if isinstance(drag, AbstractDragLaw):
        law = drag
    elif drag not in DRAGS:
        # Entry points are looked up in the metadata of all packages: not for each arm.
        law = law_named(AbstractDragLaw.registered_as, drag)
    if law is not None:
        if (strip_points, drag_curve) != (3, "constant"):
            raise InputError(
                "strip_points and drag_curve apply only to the drag laws of giajax: remove them"
            )
        # The coefficient of eq. (1) is at its bound, so that no fit frees it.
        air |= {"drag": "centre", "law": law, "drag_coefficient": 0.0}
    air |= {} if air_density is None else {"density": air_density}
    arm = Arm(
        links=Links(
            length=length,
            diameter=diameter,
            mass=mass,
            centre_of_mass=centre_of_mass,
            inertia_transverse=per_link(
                "inertia_transverse", inertia_transverse, axial / 2 + mass * length**2 / 12
            ),
            inertia_axial=per_link("inertia_axial", inertia_axial, axial),
            **{name: per_link(name, None) for name in _OTHERS},
        ),
        joints=joints,
        air=Air(**air),
        buoyancy=Buoyancy(trim_position=length / 2) if buoyancy or trim else None,
        point_masses=point_masses,
        pneumatics=pneumatics,
        contact=contact,
        base_rotation=base_rotation,
        gravity=gravity,
    )
    if trim and "buoyancy.trim_mass" in values:
        raise InputError(
            "trim computes buoyancy.trim_mass, which is also among the parameters: remove one of "
            "the two"
        )
    if wind_field is not None:
        arm = with_wind(arm, wind_field)
    arm = _with_parameters(arm, values)
    if law is not None:
        if arm.air.axial_coefficient is not None or values.get("air.drag_coefficient", 0.0):
            raise InputError(
                "the drag coefficients of air do not apply to a user-defined drag law: remove "
                "air.drag_coefficient and air.axial_coefficient"
            )
        check_drag_law(arm.air.drag_law, links)
    for each in arm.joints.laws.values():
        # Those of giajax are tried in its tests.
        if not type(each).__module__.startswith("giajax."):
            check_joint_law(each, links)
    if pneumatics is not None:
        arm = dataclasses.replace(arm, joints=dataclasses.replace(arm.joints, **idle))
    return trimmed(arm, level="buoyancy.trim_position" not in values) if trim else arm


def with_wind(arm: Arm, wind: str | AbstractWind | Callable[..., Any]) -> Arm:
    """The arm in a wind that is a function of place and time, in place of one that it has.

    It is beside the wind of a run, and `air.wind`.

    Arguments:
        wind: of positions in the base frame, m, shape (..., 3), and a time, s, the velocity of the
            air there, m/s, of the same shape: a plain def or lambda, whose globals keep
            their first values in a process (as in `jax.jit`), an instance of a class of
            `AbstractWind`, or the name of a registered one.

    Raises:
        InputError: as of `check_wind`, at the links of the straight arm; or nothing has that name.
    """
    field: Any = wind
    if isinstance(wind, str) and (field := law_named(AbstractWind.registered_as, wind)) is None:
        raise InputError(f"there is no registered wind {wind!r}: register it, or correct the name")
    field = as_wind(field)
    # From the first joint to the tip, in the direction of the straight arm.
    ends = jnp.concatenate([jnp.zeros_like(arm.links.length[:1]), jnp.cumsum(arm.links.length)])
    turn = rotation_vector_to_quaternion(arm.base_rotation)
    straight = jnp.zeros((3, arm.count + 1), ends.dtype).at[0].set(ends)
    check_wind(field, rotate(turn[:, None], straight).T)
    return dataclasses.replace(arm, air=dataclasses.replace(arm.air, wind_field=field))


def _check_stated(values: Mapping[str, Any], axes: Any, idle: Mapping[str, float]) -> None:
    """Refuse a user's arm without what has no neutral value."""
    missing = [
        each.path if each.key is None else f"{each.path} ({each.key.name})"
        for each in NO_NEUTRAL
        if values.get(each.path) is None and each.path.removeprefix("joints.") not in idle
    ]
    missing += ["joint_axes"] if axes is None else []
    if missing:
        raise InputError(
            f"this arm lacks {', '.join(missing)}: state these values (joints.* in "
            f"[arm.parameters] of a file; 0 is valid there), or start from"
            " a preset, such as "
            "takeichi_20m"
        )


def _laws_of(laws: Sequence[str | AbstractJointLaw]) -> dict[str, AbstractJointLaw]:
    """Laws of joints by name, in its order, as JAX has it."""
    named: dict[str, AbstractJointLaw] = {}
    if isinstance(laws, str | AbstractJointLaw) or not isinstance(laws, Sequence):
        raise InputError(f"joint_laws is {laws!r}: give a list of names or instances of laws")
    for each in laws:
        if not isinstance(each, str | AbstractJointLaw):
            raise InputError(f"joint_laws has {each!r}: give a list of names or instances of laws")
        law: Any = each if isinstance(each, AbstractJointLaw) else law_named("joint", each)
        if law is None:
            raise InputError(
                f"there is no registered joint law {each!r}: register it, or correct the name"
            )
        name, kind = name_of(type(law)), type(law)
        if kind.__module__ == AbstractJointLaw.__module__ and registered("joint", name) is not kind:
            raise InputError(
                f"{name} is a law that parameters of the joints switch on: give these parameters, "
                f"such as "
                "joints.pitch_stiffness or joints.memory.strength, or derive your own class"
            )
        if name in named:
            raise InputError(
                f"{name} appears twice in joint_laws: derive another class for one of the two"
            )
        named[name] = law
    return dict(sorted(named.items()))


# What of a link has no argument of its own, and is an array.
_OTHERS = [
    name
    for name in Links.__dataclass_fields__
    if name not in signature(chain).parameters and not declaration(Links, name).each
]


def _tensors(inertia: Any, links: int) -> np.ndarray:
    """Matrices of inertia, shape (link, 3, 3), of six numbers for all links or each."""
    array = np.asarray(inertia, dtype=float)
    if array.shape not in ((6,), (links, 6)) or not np.all(np.isfinite(array)):
        raise InputError(
            f"inertia has the shape {array.shape}: give six finite numbers (xx, yy, zz, xy, xz, "
            f"yz), or one such row for each of {links} links"
        )
    rows = np.broadcast_to(array, (links, 6))
    return rows[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(links, 3, 3)


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
                + (f", or {allowed[-1][0]} numbers" if allowed[-1] else "")
            )
        arm = parameter.set(arm, array)
    # Numbers of elements came one after the other.
    return checked(arm)


def takeichi_20m(links: int = 20, **changes: Any) -> Arm:
    """The 20 m, 20-link helium-balloon arm of Takeichi, Suzumori, Endo and Nabae.

    Alternating pitch and yaw joints, links of 0.99 m, 0.30 m and 0.047 kg (table 2), drag by
    eq. (1), no gravity because trim weights balance the buoyancy. Stiffnesses, damping and C_D
    are assumed: the paper gives none, and finding them is a fit's job. `changes` are arguments of
    `chain`, which has none of these numbers.

    Example:
        >>> import giajax
        >>> giajax.takeichi_20m().count
        20
    """
    paper = {name: getattr(LINKS, name).default for name in ("length", "diameter", "mass")}
    paper |= {"joint_axes": "pitch_yaw", "gravity": BASE.gravity.default}
    assumed = {each.path: each.default for each in NO_NEUTRAL if each.path.startswith("joints.")}
    if changes.get("drag") in [None, *DRAGS]:
        assumed[AIR.drag_coefficient.path] = AIR.drag_coefficient.default
    assumed |= changes.pop("parameters", None) or {}
    stated = {name: value for name, value in changes.items() if value is not None}
    return chain(links, **(paper | stated), parameters=assumed)


def takeichi_20m_full(links: int = 20, **changes: Any) -> Arm:
    """The same arm with the air that the paper leaves out.

    Cross-flow drag along the links with C_D by Reynolds number, added mass, gravity and
    buoyancy, trim weights that make each link float level and hang 0.15 m below its axis, and
    the camera of 3 g at the tip.
    """
    extras = {AIR.added_mass_coefficient.path: AIR.added_mass_coefficient.default}
    if changes.get("drag", "strip") == "strip":
        extras[AIR.axial_coefficient.path] = AIR.axial_coefficient.default
    floats = changes.get("buoyancy", True)
    if floats:
        extras[BUOYANCY.trim_depth.path] = BUOYANCY.trim_depth.default
    length = changes.get("length")
    tip = LINKS.length.default if length is None else float(np.ravel(length)[-1])
    mass = POINT_MASSES.mass.default
    camera = PointMasses((links,), mass=jnp.full(1, mass), position=jnp.full(1, tip))
    defaults = {
        "gravity": STANDARD_GRAVITY,
        "drag": "strip",
        "drag_curve": "cylinder",
        "buoyancy": floats,
        "trim": floats,
        "point_masses": camera,
    }
    parameters = {**extras, **(changes.pop("parameters", None) or {})}
    return takeichi_20m(links, **{**defaults, **changes}, parameters=parameters)


def pendulum(links: int = 1, **changes: Any) -> Arm:
    """A pendulum of thin rods that hang down, in a plane, without springs, damping and air.

    Rods of 1 m, 2 cm and 1 kg; all joints have the same axis, and all angles are 0 where the
    pendulum hangs at rest. Free the damping, or give what is known of it.

    Example:
        >>> import giajax
        >>> double = giajax.pendulum(2, length=[0.3, 0.2], parameters={"joints.damping": 1e-3})
    """
    absent = ("joints.pitch_stiffness", "joints.yaw_stiffness", "joints.damping")
    none = dict.fromkeys((*absent, "air.drag_coefficient"), 0.0)
    defaults: dict[str, Any] = {
        "length": 1.0,
        "diameter": 0.02,
        "mass": 1.0,
        "joint_axes": ["pitch"] * links,
        "gravity": STANDARD_GRAVITY,
        "base_rotation": (0.0, np.pi / 2, 0.0),
    }
    parameters = {**none, **(changes.pop("parameters", None) or {})}
    return chain(links, **{**defaults, **changes}, parameters=parameters)


PRESETS: dict[str, Callable[..., Arm]] = {
    "takeichi_20m": takeichi_20m,
    "takeichi_20m_full": takeichi_20m_full,
    "pendulum": pendulum,
    "chain": chain,
}
"""Presets by name; each takes the number of links and the arguments of `chain`."""


def preset(name: str, links: int | None = None, **changes: Any) -> Arm:
    """The preset of a name, changed by arguments of `chain`.

    Raises:
        InputError: there is no such preset, or it has no number of links of its own.
    """
    if name not in PRESETS:
        raise InputError(f"there is no arm preset '{name}': use one of {', '.join(PRESETS)}")
    if links is None and name == "chain":
        raise InputError(
            "the number of links of this arm is unknown: state links, or a list with one value "
            "for each link"
        )
    return PRESETS[name](**changes) if links is None else PRESETS[name](links, **changes)
