"""From the TOML vocabulary to an arm and its sensors, and back."""

from inspect import signature
from typing import Any

import jax.numpy as jnp
import numpy as np

from ..arm import MUSCLE_BLEND, Arm, Contact, Pneumatics, PointMasses, chain, named_axes, preset
from ..joint import MUSCLE_LAWS as LAWS, Correction, Joint, JointPair
from ..kinds import DEFAULT_PRESET, ArmSection, PointMass, check_obstacles
from ..parameters import declared, default_free
from ..quantities import BUOYANCY, POINT_MASSES, Declaration
from ..runs import Definition
from ._build import parameter_values
from ._obstacles import entries_of, obstacles_from

# Keys of [arm] that are arguments of `chain`.
_CHOICES = (
    "joint_axes",
    "drag",
    "strip_points",
    "drag_curve",
    "added_mass",
    "buoyancy",
    "trim",
)
_ARGUMENTS = frozenset(signature(chain).parameters)


def arm_from_definition(definition: Definition) -> Arm:
    """The arm that the `[arm]` section of a sidecar, a fit definition or an arm file states.

    What is not in it is that of the preset.

    Raises:
        InputError: an unknown preset or parameter, or lists that do not have one element per
            link.
    """
    section = definition.section(ArmSection)
    check_obstacles(section)
    keys, values = section.contents(), section.values()
    changes: dict[str, Any] = {name: keys[name] for name in _CHOICES if name in keys}
    others = dict(keys.get("parameters") or {})
    for path, value in values.items():
        if (argument := _argument(path)) in _ARGUMENTS:
            changes[argument] = value
        else:
            others.setdefault(path, value)
    if others:
        changes["parameters"] = others
    if "muscles" in keys:
        changes |= {"muscles": keys["muscles"], "pair": _pair(section)}
    if "point_masses" in keys:
        changes["point_masses"] = _point_masses(section.point_masses or [])
    if section.obstacles:
        changes["contact"] = Contact(obstacles=obstacles_from(section.obstacles))
    name = keys.get("preset", DEFAULT_PRESET)
    return preset(name, keys.get("links") or _listed(section), **changes)


def _pair(section: ArmSection) -> JointPair:
    """The pair of muscles that the keys of a section state."""
    blend = (
        MUSCLE_BLEND if section.muscle_blend_deg is None else np.deg2rad(section.muscle_blend_deg)
    )
    correction = Correction(reading=section.muscle_correction or "continuous", blend=blend)
    return JointPair(Joint(correction=correction), LAWS[section.muscle_law or "braided"]())


def _muscle_keys(pneumatics: Pneumatics, arm: Arm) -> dict[str, Any]:
    """The keys that state which muscles an arm has."""
    named = {"pitch": ~arm.joints.is_yaw, "all": np.ones(arm.count, bool)}
    joints = {name: (np.flatnonzero(on) + 1).tolist() for name, on in named.items()}
    own = list(pneumatics.joints)
    correction = pneumatics.joint.correction
    about: dict[str, Any] = {
        "muscles": next((name for name, numbers in joints.items() if numbers == own), own),
        "muscle_law": pneumatics.muscle.name,
        "muscle_correction": correction.reading,
    }
    if correction.blend > 0:
        about["muscle_blend_deg"] = _degrees(correction.blend)
    return about


def _degrees(radians: float) -> float:
    """The degrees that become these radians again, bit for bit."""
    degrees = float(np.rad2deg(radians))
    near = (round(degrees, 12), degrees, np.nextafter(degrees, 0), np.nextafter(degrees, np.inf))
    return next((float(each) for each in near if np.deg2rad(each) == radians), degrees)


def _argument(path: str) -> str:
    """The argument of `chain` for a parameter, if it has one: `mass`, `air_density`."""
    return path.removeprefix("links.").replace(".", "_")


def _listed(section: ArmSection) -> int | None:
    """The number of links of a section that does not state it: the length of its lists."""
    return next((len(value) for value in section.lists().values()), None)


def _point_masses(entries: list[PointMass]) -> PointMasses | None:
    if not entries:
        return None
    bodies = [entry.values() for entry in entries]
    columns = {}
    for declaration in POINT_MASSES:
        row = [values.get(declaration.path, 0.0) for values in bodies]
        if not declaration.optional or any(row):
            columns[_name(declaration)] = jnp.asarray(row, dtype=float)
    return PointMasses(links=tuple(entry.link for entry in entries), **columns)


def _name(declaration: Declaration) -> str:
    return declaration.path.rpartition(".")[2]


def arm_to_definition(arm: Arm) -> dict[str, Any]:
    """The `[arm]` section of an arm: all of its constants, in the TOML vocabulary.

    What a fit frees by default (stiffness, damping, C_D) is not a constant.
    """
    fitted = default_free(arm)
    constants = {path: v for path, v in parameter_values(arm).items() if path not in fitted}
    facts: dict[str, Any] = {
        "links": arm.count,
        **ArmSection.keys_of(constants),
        "joint_axes": _axes(arm),
        "drag": arm.air.drag,
        "strip_points": arm.air.strip_points,
        "drag_curve": arm.air.drag_curve,
        "buoyancy": arm.buoyancy is not None,
    }
    if arm.air.added_mass_coefficient is not None or arm.air.added_mass != "kirchhoff":
        facts["added_mass"] = arm.air.added_mass
    if arm.pneumatics is not None:
        facts |= _muscle_keys(arm.pneumatics, arm)
    if arm.contact is not None:
        facts["obstacles"] = entries_of(arm.contact.obstacles)
    if arm.point_masses is not None:
        facts["point_masses"] = _entries(arm.point_masses)
    keyed = {part.path for parts in ArmSection.quantities.values() for part in parts}
    keyed |= {part.path for part in POINT_MASSES}
    others = {}
    for path, parameter in declared(arm).items():
        if path in keyed or path not in constants:
            continue
        declaration, value = parameter.declaration, np.asarray(constants[path])
        # `chain` hangs trim weights at half a link's length, whatever the declared default.
        usual = declaration.frozen and not declaration.optional
        usual = usual and bool(np.all(value == declaration.default))
        if not usual or path == BUOYANCY.trim_position.path:
            # A list of equal stops is not one stop.
            others[path] = value.tolist() if declaration.any_number else _plain(value)
    if others:
        facts["parameters"] = others
    return facts


def _plain(values: Any) -> Any:
    """One number where all are the same."""
    values = np.asarray(values, dtype=float)
    if values.ndim == 0:
        return float(values)
    return float(values[0]) if np.all(values == values[0]) else values.tolist()


def _entries(fixed: PointMasses) -> list[dict[str, Any]]:
    def row(declaration: Declaration) -> Any:
        value = getattr(fixed, _name(declaration))
        return np.broadcast_to(0.0 if value is None else np.asarray(value), len(fixed.links))

    rows = {declaration.path: row(declaration) for declaration in POINT_MASSES}
    if fixed.drag_area is None:
        # As earlier versions wrote it, so that a result of theirs is of the same configuration.
        del rows[POINT_MASSES.drag_area.path]
    return [
        {"link": link, **PointMass.keys_of({path: row[body] for path, row in rows.items()})}
        for body, link in enumerate(fixed.links)
    ]


def _axes(arm: Arm) -> str | list[list[float]]:
    if arm.joints.axes == named_axes("pitch_yaw", arm.count):
        return "pitch_yaw"
    return [list(axis) for axis in arm.joints.axes]
