"""The arm model: rigid bodies of the links, `chain`, presets, trim and lift."""

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

# Base frame: x points along the straight arm away from the base, y to the left and z up. The origin
# is joint 1. Joint i precedes link i. Angles are in radians, and all units are SI units.


class Arm(ShownAsTable, eqx.Module):
    """A chain of links in air, fixed at its base.

    Create an arm with a preset (`takeichi_20m`), or your own arm with `chain`. Every array can be
    differentiated, batched and replaced (`giajax.replace`). A part that is None is omitted from the
    model and has no computational cost.

    Arguments:
        links: the rigid links.
        joints: joint axes, springs, dampers and further joint laws.
        air: the air that surrounds the links.
        buoyancy: helium and trim weights; None if the model has no buoyancy.
        point_masses: bodies fixed to links; None for no bodies.
        pneumatics: muscles that drive joints instead of their springs; None for no muscles.
        contact: obstacles around the arm, and the contact law; None for no obstacles.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: gravitational acceleration along negative z, m/s^2.
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
                f"there are {len(self.joints.axes)} joint axes for {self.links.count} links: "
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
        """Stiffness of the spring of each joint, N m/rad; 0 in joints with muscles."""
        own = () if self.pneumatics is None else self.pneumatics.joints
        driven = np.isin(np.arange(self.count) + 1, np.asarray(own))
        return jnp.where(driven, 0, self.joints.stiffness) if own else self.joints.stiffness

    @property
    def joint_laws(self) -> JointLaws:
        """All joint laws: springs, dampers, hysteresis, further laws, and muscles."""
        laws = (*self.joints.dampers, *self.further_laws.laws)
        return JointLaws((Spring(self.spring_stiffness), *laws))

    @property
    def further_laws(self) -> JointLaws:
        """The laws of `joints` and muscles except springs and dampers; only these have states."""
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
            "drag": f"{drag}, in air of density {_in_text(self.air.density)} kg/m^3",
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
    """Each link with everything that it carries, as a rigid body.

    Attributes:
        mass: mass, kg.
        along: distance of the centre of mass from the joint along the link, m.
        transverse, axial: moments of inertia about the centre of mass of an axisymmetric body,
            kg m^2.
        across: coordinates of the centre of mass to the left of and above the link axis, m; None if
            all masses lie on the axis.
        uneven: inertia in addition to that of the axisymmetric body: xx, yy, zz, xy, xz, yz in the
            frame of the link, kg m^2; None if all masses lie on the axis.
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
    """Return the rigid bodies of the links, with helium, trim weights and point masses."""
    links = arm.links
    transverse, axial = links.inertia_transverse, links.inertia_axial
    points = _points(arm)
    if not points:
        return Bodies(links.mass, links.centre_of_mass, transverse, axial, None, None)
    points = [_Point(links.mass, links.centre_of_mass), *points]
    if arm.buoyancy is not None:
        helium = arm.buoyancy.helium_density * links.volume
        # The helium is a uniform cylinder that does not follow the rotation about its own axis.
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
    """Return point masses in the frames of the links, with one value per link in each array."""
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
        # Each link may carry several bodies. Split them into groups with at most one per link.
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
    """Return the upward buoyancy force on each link at its centre, N; None without buoyancy."""
    if arm.buoyancy is None:
        return None
    upwards = arm.air.density * arm.links.volume * arm.gravity
    if arm.buoyancy.imbalance is not None:
        upwards = upwards + arm.buoyancy.imbalance
    return upwards


def net_lift(arm: Arm) -> Float[Array, " link"]:
    """Return the mass that each link can still carry, kg.

    This is the mass of the displaced air minus the mass of the link and all that it carries. It is
    negative if a link is too heavy to float.

    Raises:
        InputError: the arm has no buoyancy.
    """
    if arm.buoyancy is None:
        raise InputError("this arm has no buoyancy: build it with buoyancy=True")
    return arm.air.density * arm.links.volume - bodies(arm).mass


def trimmed(arm: Arm, *, level: bool = False) -> Arm:
    """Return the arm with trim weights that make each link neutrally buoyant.

    They replace the trim weights of the arm.

    Arguments:
        arm: the arm.
        level: whether to place the weights so that each link floats horizontally, with its centre
            of mass at the same position along the link as its lift. Otherwise, the positions of the
            weights remain unchanged.

    Raises:
        InputError: the arm has no buoyancy, a link is too heavy to float, or a weight would have to
            be placed outside its link.
    """
    if arm.buoyancy is None:
        raise InputError("this arm has no buoyancy: build it with buoyancy=True")
    bare = dataclasses.replace(arm.buoyancy, trim_mass=jnp.zeros_like(arm.links.mass))
    weights = net_lift(dataclasses.replace(arm, buoyancy=bare))
    if is_concrete(weights) and np.any(np.asarray(weights) < 0):
        link = int(np.argmin(np.asarray(weights))) + 1
        raise InputError(
            f"link {link} is {-float(weights[link - 1]):.3g} kg too heavy to float, so no trim "
            "weight can balance it: make the link lighter or larger"
        )
    changes = {"trim_mass": weights}
    if level:
        changes["trim_position"] = _level(arm, bare, weights)
    return dataclasses.replace(arm, buoyancy=dataclasses.replace(bare, **changes))


def _level(arm: Arm, bare: Buoyancy, weights: Float[Array, " link"]) -> Float[Array, " link"]:
    """Return the positions of the trim weights at which mass and displaced air are in balance."""
    length = arm.links.length
    other = bodies(dataclasses.replace(arm, buoyancy=bare))
    moment = other.mass * (length / 2 - other.along)
    # A weight of 0 balances no moment, so its position is the centre of the link.
    place = length / 2 + moment / jnp.where(weights > 0, weights, jnp.inf)
    if is_concrete(place) and np.any(np.asarray((place < 0) | (place > length))):
        link = int(np.argmax(np.asarray(abs(place - length / 2) - length / 2))) + 1
        raise InputError(
            f"link {link} would float level only with a trim weight at "
            f"{float(place[link - 1]):.3g} m along its axis, which is outside the link of "
            f"{float(length[link - 1]):.3g} m: give buoyancy.trim_position"
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
    """Create your own arm.

    Values without a neutral default must be given: length, diameter, mass, `joint_axes`, and among
    the parameters `joints.damping` (which may be 0) and, if springs drive such joints,
    `joints.pitch_stiffness` and `joints.yaw_stiffness`. Everything else is absent by default or has
    the default value given here.

    Arguments:
        links: number of links.
        length, diameter, mass: length, m, diameter, m, and mass, kg, of the links; one number for
            all links, or one for each link.
        centre_of_mass: distance of the centre of mass from the joint along the link, m; half of the
            length by default.
        inertia_transverse, inertia_axial: moments of inertia about the centre of mass, kg m^2; by
            default those of a thin-walled tube with the mass, length and diameter of the link.
        inertia: inertia of links that are not axisymmetric, instead of the two moments above: xx,
            yy, zz, xy, xz, yz about the centre of mass in the frame of the link (x along the link,
            z up in the straight arm), kg m^2, shape (6,) or (link, 6). The mass of such a link is
            represented by six point masses.
        joint_axes: "pitch_yaw", or for each joint "pitch", "yaw" or a vector.
        base_rotation: rotation vector of the straight arm, rad, shape (3,).
        gravity: gravitational acceleration along negative z, m/s^2; 0 if buoyancy balances the
            weight.
        air_density: density of the air, kg/m^3; by default that of air at 20 C.
        drag: a drag option of `Air`, a drag law, or the name of a registered law
            (`giajax.register`).
        strip_points, drag_curve, added_mass: see `Air`.
        joint_laws: joint laws in addition to springs, dampers and hysteresis, or their names:
            "hardening", "end_stops", or the name of a registered law.
        wind_field: a wind as a function of position and time (`with_wind`), or the name of a
            registered wind; none by default.
        buoyancy: whether the model includes displaced air, helium and trim weights; without
            gravity, only their masses have an effect.
        trim: whether to add trim weights that make each link neutrally buoyant. Each link then
            floats horizontally, unless `parameters` contains `buoyancy.trim_position`.
        point_masses: bodies fixed to links, such as a camera at the tip.
        muscles: joints driven by pairs of muscles instead of springs: "pitch", "all" or a list of
            joint numbers, starting from 1; none by default.
        pair: joint and muscle law, the same for all joints with muscles; by default braided muscles
            with corrections that are blended over 1 deg about 0.
        contact: obstacles around the arm, and the contact law; none by default.
        parameters: values of parameters by path, in SI units (`giajax parameters` lists the paths).
            A parameter that is disabled by default, such as `air.added_mass_coefficient`, is
            enabled. C_D is 1 by default.

    Raises:
        InputError: a required value is missing, a pair is given without joints, a list does not
            have one value for each link, a number is not finite or not positive although it must
            be, a path or choice is unknown, or a link is too heavy to float.

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
            'a muscle law is given, but no joint has muscles: give muscles="pitch" as well'
        )
    if links < 1:
        raise InputError(f"an arm of {links} links cannot be built: give at least one link")
    values = dict(parameters or {})
    # These axes are a placeholder if none are given. `_check_stated` then reports that they are
    # missing, together with all other missing values.
    axes = named_axes("pitch_yaw" if joint_axes is None else joint_axes, links)
    joints = Joints(axes=axes, laws=_laws_of(joint_laws))
    pneumatics = None if muscles is None else muscles_in(muscles, pair, joints)
    idle = idle_springs(joints, pneumatics)
    given = {"links.length": length, "links.diameter": diameter, "links.mass": mass}
    # A dimension in `parameters` has the same effect as the argument, including on the inertias.
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
                f"{name} has {array.size} values for {links} links: give one number, or {links} "
                "numbers"
            )
        if not np.all(np.isfinite(array)) or not np.all(array > declared.lower):
            raise InputError(
                f"{name} is out of bounds: give finite numbers greater than "
                f"{declared.lower:g} {declared.unit}"
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
        # This searches the metadata of all packages for entry points, so it is done only if needed.
        law = law_named(AbstractDragLaw.registered_as, drag)
    if law is not None:
        if (strip_points, drag_curve) != (3, "constant"):
            raise InputError(
                "strip_points and drag_curve apply only to the built-in drag laws: remove them"
            )
        # The coefficient of eq. (1) is set to its bound, so that no fit frees it.
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
        # The laws that giajax provides are tested in its test suite.
        if not type(each).__module__.startswith("giajax."):
            check_joint_law(each, links)
    if pneumatics is not None:
        arm = dataclasses.replace(arm, joints=dataclasses.replace(arm.joints, **idle))
    return trimmed(arm, level="buoyancy.trim_position" not in values) if trim else arm


def with_wind(arm: Arm, wind: str | AbstractWind | Callable[..., Any]) -> Arm:
    """Return the arm with a wind that is a function of position and time.

    It replaces the wind field of the arm. It is added to the wind of a run and to `air.wind`.

    Arguments:
        arm: the arm.
        wind: a function of positions in the base frame, m, shape (..., 3), and a time, s, that
            returns the velocity of the air there, m/s, in the same shape. It is a plain def or
            lambda, an instance of a class of `AbstractWind`, or the name of a registered wind. As
            with `jax.jit`, the globals of a plain function keep their first values in a process.

    Raises:
        InputError: `check_wind` finds an error at the links of the straight arm, or no wind is
            registered under the name.
    """
    field: Any = wind
    if isinstance(wind, str) and (field := law_named(AbstractWind.registered_as, wind)) is None:
        raise InputError(f"there is no registered wind {wind!r}: register it, or correct the name")
    field = as_wind(field)
    # The positions of all joints and of the tip of the straight arm.
    ends = jnp.concatenate([jnp.zeros_like(arm.links.length[:1]), jnp.cumsum(arm.links.length)])
    turn = rotation_vector_to_quaternion(arm.base_rotation)
    straight = jnp.zeros((3, arm.count + 1), ends.dtype).at[0].set(ends)
    check_wind(field, rotate(turn[:, None], straight).T)
    return dataclasses.replace(arm, air=dataclasses.replace(arm.air, wind_field=field))


def _check_stated(values: Mapping[str, Any], axes: Any, idle: Mapping[str, float]) -> None:
    """Check that all values without a neutral default are given."""
    missing = [
        each.path if each.key is None else f"{each.path} ({each.key.name})"
        for each in NO_NEUTRAL
        if values.get(each.path) is None and each.path.removeprefix("joints.") not in idle
    ]
    missing += ["joint_axes"] if axes is None else []
    if missing:
        raise InputError(
            f"this arm lacks {', '.join(missing)}: give these values (in a file, joints.* in "
            "[arm.parameters], where 0 is permitted), or start from a preset, such as takeichi_20m"
        )


def _laws_of(laws: Sequence[str | AbstractJointLaw]) -> dict[str, AbstractJointLaw]:
    """Return joint laws by name, sorted by name as JAX sorts the keys of a dictionary."""
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
                f"the law {name} is switched on by parameters of the joints: give these "
                "parameters, such as joints.pitch_stiffness or joints.memory.strength, or derive "
                "your own class"
            )
        if name in named:
            raise InputError(
                f"{name} appears twice in joint_laws: derive another class for one of the two"
            )
        named[name] = law
    return dict(sorted(named.items()))


# Fields of `Links` that are arrays and have no argument of `chain`.
_OTHERS = [
    name
    for name in Links.__dataclass_fields__
    if name not in signature(chain).parameters and not declaration(Links, name).each
]


def _tensors(inertia: Any, links: int) -> np.ndarray:
    """Return inertia matrices, shape (link, 3, 3), from six numbers for all links or for each."""
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
    # Parameters with a variable number of elements were set one after the other, so their shapes
    # are consistent only now.
    return checked(arm)


def takeichi_20m(links: int = 20, **changes: Any) -> Arm:
    """Return the 20 m, 20-link helium-balloon arm of Takeichi, Suzumori, Endo and Nabae.

    The arm has alternating pitch and yaw joints. Its links have a length of 0.99 m, a diameter of
    0.30 m and a mass of 0.047 kg (table 2). Drag is computed by eq. (1). There is no gravity,
    because trim weights balance the buoyancy. Stiffnesses, damping and C_D are assumed, because the
    paper does not give them. They are to be estimated by a fit.

    Arguments:
        links: number of links.
        changes: arguments of `chain` that replace these values.

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
    """Return the arm of `takeichi_20m` with the air effects that the paper neglects.

    These are cross-flow drag along the links with C_D as a function of the Reynolds number, added
    mass, gravity and buoyancy. Trim weights 0.15 m below the link axes make each link float
    horizontally. The tip carries the camera of 3 g.

    Arguments:
        links: number of links.
        changes: arguments of `chain` that replace these values.
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
    """Return a planar pendulum of thin rods that hang down, without springs, damping and air.

    The rods have a length of 1 m, a diameter of 2 cm and a mass of 1 kg. All joints have the same
    axis, and all angles are 0 when the pendulum hangs at rest. In a fit, free the damping, or set
    it to a known value.

    Arguments:
        links: number of rods.
        changes: arguments of `chain` that replace these values.

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
"""Presets by name. Each takes the number of links and the arguments of `chain`."""


def preset(name: str, links: int | None = None, **changes: Any) -> Arm:
    """Return the arm of a named preset, with changes.

    Arguments:
        name: name of the preset.
        links: number of links; by default that of the preset.
        changes: arguments of `chain` that replace the values of the preset.

    Raises:
        InputError: there is no such preset, or the number of links is unknown.
    """
    if name not in PRESETS:
        raise InputError(f"there is no arm preset '{name}': use one of {', '.join(PRESETS)}")
    if links is None and name == "chain":
        raise InputError(
            "the number of links of this arm is unknown: give links, or a list with one value "
            "for each link"
        )
    return PRESETS[name](**changes) if links is None else PRESETS[name](links, **changes)
