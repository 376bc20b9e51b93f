"""Convert between sections of a file and an arm with its sensors and obstacles."""

import dataclasses
from collections.abc import Mapping, Sequence
from inspect import signature
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..mechanics.arm import (
    MUSCLE_BLEND,
    AbstractDragLaw,
    AbstractJointLaw,
    AbstractWind,
    Arm,
    Contact,
    Pneumatics,
    PointMasses,
    chain,
    named_axes,
    preset,
    structural_points,
)
from ..mechanics.joint import MUSCLE_LAWS as LAWS, Correction, Joint, JointPair
from ..mechanics.obstacles import AbstractObstacle, Box, Plane, WallWithOpening
from ..recordings import Definition, Run
from ..runtime.plugins import name_of, registered
from ..runtime.text import InputError
from ..schema import (
    BUOYANCY,
    DEFAULT_PRESET,
    LINKS,
    NO_NEUTRAL,
    POINT_MASSES,
    ArmSection,
    CamerasSection,
    Declaration,
    LandmarksSection,
    Obstacle,
    PinholeSection,
    PointMass,
    Section,
    SensorsSection,
    check_obstacles,
    sections_of_cameras,
)
from ..schema.parameters import DECLARED, declared, default_free, replace
from ._arm_sensors import Camera, Landmark, Sensors, sensor_named
from ._cameras import Pinhole
from ._protocol import parameter_values


def _obstacle(entry: Obstacle) -> AbstractObstacle:
    """Return the obstacle of an entry of `[[arm.obstacles]]`."""
    about: dict[str, Any] = {"centre": entry.centre_m, "name": entry.name}
    if entry.shape == "plane":
        return Plane(**about | {"normal": entry.normal})
    about["rotation"] = np.deg2rad(entry.rotation_deg or [0.0, 0.0, 0.0])
    if entry.shape == "box":
        return Box(**about | {"size": entry.size_m})
    about |= {"opening": entry.opening_m, "margins": entry.margins_m}
    return WallWithOpening(**about | {"thickness": entry.thickness_m})


def _entry(obstacle: AbstractObstacle) -> dict[str, Any]:
    """Return the entry of `[[arm.obstacles]]` for an obstacle."""

    def numbers(**values: Any) -> dict[str, Any]:
        return {name: np.asarray(value, dtype=float).tolist() for name, value in values.items()}

    about: dict[str, Any] = {"name": obstacle.name, **numbers(centre_m=obstacle.centre)}
    if isinstance(obstacle, Plane):
        return {"shape": "plane", **about, **numbers(normal=obstacle.normal)}
    if isinstance(obstacle, Box):
        shape, sizes = "box", numbers(size_m=obstacle.size)
    elif isinstance(obstacle, WallWithOpening):
        parts = {"opening_m": obstacle.opening, "margins_m": obstacle.margins}
        shape, sizes = "wall", numbers(**parts, thickness_m=obstacle.thickness)
    else:
        raise TypeError(
            f"an obstacle of the type {type(obstacle).__name__} cannot be written to a file"
        )
    turn = numbers(rotation_deg=np.rad2deg(np.asarray(obstacle.rotation)))
    return {"shape": shape, **about, **sizes, **turn}


SECTIONS = ("sensors", "camera", "landmark")


def sensors_from_definition(definition: Definition) -> Sensors:
    """Return the sensors of `[sensors]`, `[camera]` and `[landmark]`, without any others.

    Raises:
        InputError: a camera lacks a required key.
    """
    cameras, marks = definition.section(CamerasSection), definition.section(LandmarksSection)
    section = definition.section(SensorsSection)
    sensors = Sensors(
        camera=Camera(pinholes={name: _pinhole(name, of) for name, of in cameras.named().items()}),
        landmark={name: Landmark() for name in marks.named()},
        sensor={name: sensor_named(name) for name in sorted(section.own or {})},
    )
    stated = section.values() | cameras.values() | marks.values()
    return replace(sensors, stated)


def _pinhole(name: str, section: PinholeSection) -> Pinhole:
    """Return the camera of a section, without the values of its parameters."""
    keys = section.contents()
    needed = ["size_px", "focal_length_px"]
    if keys.get("mount", "room") == "room":
        needed += ["position_m", "rotation_deg"]
    for key in needed:
        if keys.get(key) is None:
            raise InputError(
                f"[camera.{name}] has no {key}: give the best known value (a fit can estimate "
                "everything except size_px)"
            )
    width, height = keys["size_px"]
    # The centre of the image, if the centre of its first pixel is (0, 0).
    return Pinhole(
        mount=keys.get("mount", "room"),
        size=(width, height),
        centre=jnp.array([(width - 1) / 2, (height - 1) / 2]),
    )


def sensors_to_definition(sensors: Sensors) -> dict[str, dict[str, Any]]:
    """Return `[sensors]`, `[camera]` and `[landmark]` for the sensors, in the form of files."""
    values = parameter_values(sensors)
    errors = SensorsSection.keys_of(values)
    for name, each in sensors.sensor.items():
        if registered(each.registered_as, name) is not type(each):
            raise InputError(
                f"there is no registered sensor {name}, so a result could not refer to it: call "
                "giajax.register with its class"
            )
        _check_fields(each, f"sensor {name}")
    if sensors.sensor:
        errors["own"] = {name: _constants(of) for name, of in sensors.sensor.items()}
    sections = {**({"sensors": errors} if errors else {}), **sections_of_cameras(values)}
    for name, camera in sensors.camera.pinholes.items():
        about = {"mount": camera.mount, "size_px": list(camera.size)}
        sections["camera"][name] = about | sections["camera"][name]
    return sections


# Keys of [arm] that are arguments of `chain`.
_CHOICES = ("joint_axes", "drag", "strip_points", "drag_curve", "added_mass", "joint_laws",
            "buoyancy", "trim", "wind_field")  # fmt: skip
_ARGUMENTS = frozenset(signature(chain).parameters)


def arm_from_definition(definition: Definition) -> Arm:
    """Return the arm of the `[arm]` section of a sidecar, a fit definition or an arm file.

    Keys that are missing have the values of the preset.

    Raises:
        InputError: a preset or parameter is unknown, or a list does not have one element per link.
    """
    section = definition.section(ArmSection)
    check_obstacles(section)
    keys, values = section.contents(), section.values()
    changes: dict[str, Any] = {name: keys[name] for name in _CHOICES if name in keys}
    others = dict(keys.get("parameters") or {})
    for path, value in values.items():
        # Matches names such as `mass` and `air_density`.
        if (argument := path.removeprefix("links.").replace(".", "_")) in _ARGUMENTS:
            changes[argument] = value
        else:
            others.setdefault(path, value)
    if others:
        changes["parameters"] = others
    # If the section does not give the number of links, the length of its lists is used.
    listed = next((len(value) for value in section.lists().values()), None)
    entries = section.point_masses or []
    stated = "link_inertia_kg_m2" in keys
    if entries and "mass" in changes:
        count = keys.get("links") or listed or 1
        mass = np.broadcast_to(changes["mass"], count).copy()
        entries, changes["mass"] = _points_beside(entries, mass, inertia_stated=stated)
    if stated:
        changes["inertia"] = keys["link_inertia_kg_m2"]
        # Sidecars written by giajax contain these inertias, too.
        changes |= {"inertia_transverse": None, "inertia_axial": None}
    if "muscles" in keys:
        changes |= {"muscles": keys["muscles"], "pair": _pair(section)}
    if "point_masses" in keys:
        changes["point_masses"] = _point_masses(entries)
    if section.obstacles:
        changes["contact"] = Contact(obstacles=tuple(map(_obstacle, section.obstacles)))
    name = keys.get("preset", DEFAULT_PRESET)
    return preset(name, keys.get("links") or listed, **changes)


def _pair(section: ArmSection) -> JointPair:
    """Return the pair of muscles that the keys of a section specify."""
    stated = section.muscle_blend_deg
    blend = MUSCLE_BLEND if stated is None else np.deg2rad(stated)
    correction = Correction(reading=section.muscle_correction or "continuous", blend=blend)
    return JointPair(Joint(correction=correction), LAWS[section.muscle_law or "braided"]())


def _muscle_keys(pneumatics: Pneumatics, arm: Arm) -> dict[str, Any]:
    """Return the keys that specify the muscles of an arm."""
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
    """Convert to degrees that convert back to exactly the same radians, if there are any."""
    degrees = float(np.rad2deg(radians))
    near = (round(degrees, 12), degrees, np.nextafter(degrees, 0), np.nextafter(degrees, np.inf))
    return next((float(each) for each in near if np.deg2rad(each) == radians), degrees)


def _points_beside(
    entries: list[PointMass], mass: np.ndarray, *, inertia_stated: bool
) -> tuple[list[PointMass], np.ndarray]:
    """Return the point masses apart from the links, and the link masses, for a given inertia.

    Sidecars written by giajax contain links that are not round as point masses. A given inertia
    replaces these.
    """
    links = np.array([entry.link for entry in entries])
    masses = np.array([float(entry.values()[POINT_MASSES.mass.path]) for entry in entries])
    bare = structural_points(mass, links.tolist(), masses)
    own = bare | np.array([bool(entry.structural) for entry in entries])
    if inertia_stated:
        np.add.at(mass, links[bare] - 1, masses[bare])
        return [entry for entry, is_link in zip(entries, own, strict=True) if not is_link], mass
    if np.any(own & ~bare):
        raise InputError(
            f"arm.link_mass_kg gives link {links[own & ~bare][0]} a mass, but its structural "
            "point_masses already contain this mass: give link_inertia_kg_m2 too, or remove these "
            "points"
        )
    return entries, mass


def _point_masses(entries: list[PointMass]) -> PointMasses | None:
    if not entries:
        return None
    bodies = [entry.values() for entry in entries]
    columns = {}
    for declaration in POINT_MASSES:
        row = [values.get(declaration.path, 0.0) for values in bodies]
        if not declaration.optional or any(row):
            columns[declaration.path.rpartition(".")[2]] = jnp.asarray(row, dtype=float)
    return PointMasses(links=tuple(entry.link for entry in entries), **columns)


def _constants(part: eqx.Module) -> dict[str, Any]:
    """Return values by path of the parameters that a fit does not free by default."""
    fitted = default_free(part)
    return {path: v for path, v in parameter_values(part).items() if path not in fitted}


def arm_to_definition(arm: Arm) -> dict[str, Any]:
    """Return the `[arm]` section of an arm: all of its constants, in the TOML vocabulary.

    Parameters that a fit frees by default (stiffness, damping, C_D) are not constants.
    """
    constants = _constants(arm)
    usual_axes = arm.joints.axes == named_axes("pitch_yaw", arm.count)
    facts: dict[str, Any] = {
        "links": arm.count,
        **ArmSection.keys_of(constants),
        "joint_axes": "pitch_yaw" if usual_axes else [list(axis) for axis in arm.joints.axes],
        "drag": arm.air.drag if arm.air.law is None else _law_name(arm.air.law),
        "strip_points": arm.air.strip_points,
        "drag_curve": arm.air.drag_curve,
        "buoyancy": arm.buoyancy is not None,
    }
    pressure = np.asarray(arm.links.pressure)
    if pressure.ndim == 0 and pressure == LINKS.pressure.default and LINKS.pressure.key is not None:
        # Earlier versions did not write this constant, and their results must compare as equal.
        del facts[LINKS.pressure.key.name]
    if arm.air.added_mass_coefficient is not None or arm.air.added_mass != "kirchhoff":
        facts["added_mass"] = arm.air.added_mass
    if arm.joints.laws:
        facts["joint_laws"] = list(map(_law_name, arm.joints.laws.values()))
    if arm.air.wind_field is not None:
        facts["wind_field"] = _law_name(arm.air.wind_field)
    if arm.pneumatics is not None:
        facts |= _muscle_keys(arm.pneumatics, arm)
    if arm.contact is not None:
        facts["obstacles"] = list(map(_entry, arm.contact.obstacles))
    if arm.point_masses is not None:
        facts["point_masses"] = _entries(arm.point_masses, np.asarray(arm.links.mass))
    keyed = {part.path for parts in ArmSection.quantities.values() for part in parts}
    keyed |= {part.path for part in POINT_MASSES}
    others = {}
    for path, parameter in declared(arm).items():
        if path in keyed or path not in constants:
            continue
        declaration, value = parameter.declaration, np.asarray(constants[path])
        # `chain` attaches trim weights at half the length of a link, unlike the declared default.
        usual = declaration.frozen and not declaration.optional
        usual = usual and bool(np.all(value == declaration.default))
        if not usual or path == BUOYANCY.trim_position.path:
            # A list of equal stops must stay a list, because its length is the number of stops.
            others[path] = value.tolist() if declaration.any_number else _plain(value)
    if others:
        facts["parameters"] = others
    return facts


def preset_of(arm: Arm | Definition) -> dict[str, Any]:
    """Return the preset and parameters that `[arm]` needs as the initial guess of a fit.

    They complete `arm_to_definition`, which contains only constants. For the arm in the paper the
    initial guess is its preset. Any other arm starts from its own values.
    """
    if isinstance(arm, Definition):
        name = arm.section(ArmSection).preset or DEFAULT_PRESET
        # The presets of the arm in the paper differ only in constants.
        if name.startswith(DEFAULT_PRESET):
            return {"preset": DEFAULT_PRESET}
        arm = arm_from_definition(arm)
    values = parameter_values(arm)
    needed = [each.path for each in NO_NEUTRAL if each.path.startswith("joints.")]
    paths = dict.fromkeys([*needed, *default_free(arm)])
    return {
        "preset": "chain",
        "parameters": {path: np.asarray(values[path]).tolist() for path in paths},
    }


def _law_name(law: AbstractDragLaw | AbstractJointLaw | AbstractWind) -> str:
    """Return the name of a registered law in files; it must be defined by its parameters alone."""
    name, role = name_of(type(law)), law.registered_as
    what = f"wind {name}" if role == "wind" else f"{role} law {name}"
    if registered(role, name) is not type(law):
        raise InputError(
            f"the {what} is not registered, so a result could not refer to it: call "
            "giajax.register with its "
            f"class{' (for a plain function, write a class)' * (role == 'wind')}"
        )
    _check_fields(law, what)
    return name


def _check_fields(part: Any, what: str) -> None:
    """Refuse a part with a field, other than a parameter, that differs from its default."""
    for field in dataclasses.fields(part):
        value = getattr(part, field.name)
        if DECLARED not in field.metadata and value != field.default:
            raise InputError(
                f"the {what} has {field.name} = {value!r}, which cannot be written to a file: "
                "define a separate class with this default value"
            )


def _plain(values: Any) -> Any:
    """Return one number if all values are equal, otherwise a list."""
    values = np.asarray(values, dtype=float)
    if values.ndim == 0:
        return float(values)
    return float(values[0]) if np.all(values == values[0]) else values.tolist()


def _entries(fixed: PointMasses, mass: np.ndarray) -> list[dict[str, Any]]:
    def row(declaration: Declaration) -> Any:
        value = getattr(fixed, declaration.path.rpartition(".")[2])
        return np.broadcast_to(0.0 if value is None else np.asarray(value), len(fixed.links))

    rows = {declaration.path: row(declaration) for declaration in POINT_MASSES}
    if fixed.drag_area is None:
        # Earlier versions omitted this row if there was no drag, and results must compare as equal.
        del rows[POINT_MASSES.drag_area.path]
    own = structural_points(mass, fixed.links, rows[POINT_MASSES.mass.path])
    return [
        {"link": link, **PointMass.keys_of({path: row[body] for path, row in rows.items()})}
        | ({"structural": True} if own[body] else {})
        for body, link in enumerate(fixed.links)
    ]


S = TypeVar("S", bound=Section)

_SECTIONS = (ArmSection, SensorsSection, CamerasSection, LandmarksSection)


def agreed_parts(runs: Sequence[Run]) -> tuple[Arm, Sensors]:
    """Return the arm and the sensors of some runs, whose sidecars must agree.

    Raises:
        InputError: the sidecars disagree in [arm], [sensors], [camera] or [landmark].
    """
    first, *others = runs
    try:
        arm = arm_from_definition(first.definition)
    except InputError as error:
        raise InputError(f"the arm of {first.path or first.name}: {error}") from None
    sensors = sensors_from_definition(first.definition)
    sections = [first.definition.section(of) for of in _SECTIONS]
    for other in others:
        if [other.definition.section(type(of)) for of in sections] == sections:
            continue
        ours, theirs = (
            {"arm": arm_to_definition(an_arm), **sensors_to_definition(its)}
            for an_arm, its in (
                (arm, sensors),
                (arm_from_definition(other.definition), sensors_from_definition(other.definition)),
            )
        )
        for name in ("arm", *SECTIONS):
            check_agreement(name, (first, ours.get(name, {})), (other, theirs.get(name, {})))
    channels = [channel for run in runs for channel in run.channels.values()]
    return arm, sensors.with_rows(channel.kind for channel in channels)


def agreed_section(runs: Sequence[Run], name: str, of: type[S]) -> S:
    """Return the section of the given name and class, which must be equal in all sidecars.

    Raises:
        InputError: the sidecars disagree in this section.
    """
    first, *others = runs
    section = first.definition.section(of)
    for other in others:
        if other.definition.section(of) != section:
            raise InputError(
                f"the sidecars of '{first.name}' and '{other.name}' disagree in [{name}]: "
                "correct one, or fit the runs separately"
            )
    return section


def check_agreement(
    section: str, first: tuple[Run, Mapping[str, Any]], other: tuple[Run, Mapping[str, Any]]
) -> None:
    """Refuse two runs whose sidecars differ in a key of a section; None means a missing key.

    Raises:
        InputError: a key differs; the message names the runs, the key and both values.
    """
    (one, ours), (two, theirs) = first, other
    for key in {**ours, **theirs}:
        if ours.get(key) != theirs.get(key):
            both = " and ".join(
                "nothing" if values.get(key) is None else str(values[key])
                for values in (ours, theirs)
            )
            raise InputError(
                f"the sidecars of '{one.name}' and '{two.name}' disagree in [{section}] "
                f"{key} ({both}): correct one, or fit the runs separately"
            )
