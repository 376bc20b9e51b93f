"""From the TOML vocabulary to an arm and its sensors, and back."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..arm import Arm, PointMasses, named_axes, preset
from ..kinds import DEFAULT_PRESET, ArmSection, SensorsSection
from ..parameters import declared, default_free, replace
from ..runs import Definition
from ._sensors import Sensors

# Key of [arm] -> argument of `chain` and path of the parameter.
_ARRAYS = {
    "link_length_m": "length",
    "link_diameter_m": "diameter",
    "link_mass_kg": "mass",
    "link_centre_of_mass_m": "centre_of_mass",
    "link_inertia_transverse_kg_m2": "inertia_transverse",
    "link_inertia_axial_kg_m2": "inertia_axial",
}
_PLAIN = {
    "joint_axes": "joint_axes",
    "air_density_kg_per_m3": "air_density",
    "gravity_m_per_s2": "gravity",
    "drag": "drag",
    "strip_points": "strip_points",
    "drag_curve": "drag_curve",
    "buoyancy": "buoyancy",
    "trim": "trim",
    "parameters": "parameters",
}
# Parameters that have a key of their own.
_KEYED = (
    *(f"links.{name}" for name in _ARRAYS.values()),
    "air.density",
    "base_rotation",
    "gravity",
    "point_masses.mass",
    "point_masses.position",
    "point_masses.left",
    "point_masses.up",
)

# Key of [sensors] -> path of the parameter and what one of the key's unit is in SI.
_SENSORS = {
    "camera_rotation_deg": ("camera.rotation", np.pi / 180),
    "camera_origin_m": ("camera.origin", 1.0),
    "camera_scale": ("camera.scale", 1.0),
    "camera_delay_s": ("camera.delay", 1.0),
    "marker_along_m": ("marker.along", 1.0),
    "marker_left_m": ("marker.left", 1.0),
    "marker_up_m": ("marker.up", 1.0),
    "marker_tip_m": ("marker.tip", 1.0),
    "encoder_offset_deg": ("encoder.offset", np.pi / 180),
    "encoder_scale": ("encoder.scale", 1.0),
    "encoder_delay_s": ("encoder.delay", 1.0),
}


def arm_from_definition(definition: Definition) -> Arm:
    """The arm that the `[arm]` section of a sidecar, a fit definition or an arm file states.

    What is not stated is that of the preset.

    Raises:
        InputError: an unknown preset or parameter, or lists that do not have one element per
            link.
    """
    given = dict(definition.section(ArmSection).given())
    name = given.pop("preset", DEFAULT_PRESET)
    links = given.pop("links", None) or _listed(given)
    changes: dict[str, Any] = {
        argument: given.pop(key) for key, argument in (_ARRAYS | _PLAIN).items() if key in given
    }
    if "base_rotation_deg" in given:
        changes["base_rotation"] = np.deg2rad(given.pop("base_rotation_deg"))
    if "point_masses" in given:
        changes["point_masses"] = _point_masses(given.pop("point_masses"))
    if given:
        raise InputError(f"the key {next(iter(given))} of [arm] is not known to the arm model")
    return preset(name, links, **changes)


def _listed(given: dict[str, Any]) -> int | None:
    lengths = [
        len(value)
        for key, value in given.items()
        if isinstance(value, list) and key not in ("base_rotation_deg", "point_masses")
    ]
    return lengths[0] if lengths else None


def _point_masses(entries: list[dict[str, Any]]) -> PointMasses | None:
    if not entries:
        return None

    def row(key: str) -> Any:
        return jnp.asarray([float(entry.get(key, 0.0)) for entry in entries])

    def off_axis(key: str) -> Any:
        return row(key) if any(entry.get(key) for entry in entries) else None

    return PointMasses(
        links=tuple(entry["link"] for entry in entries),
        mass=row("mass_kg"),
        position=row("position_m"),
        left=off_axis("left_m"),
        up=off_axis("up_m"),
    )


def arm_to_definition(arm: Arm) -> dict[str, Any]:
    """The `[arm]` section of an arm: all of its constants, in the TOML vocabulary.

    What a fit frees by default (stiffness, damping, C_D) is not a constant.
    """
    stated: dict[str, Any] = {
        "links": arm.count,
        **{key: _plain(getattr(arm.links, name)) for key, name in _ARRAYS.items()},
        "joint_axes": _axes(arm),
        "base_rotation_deg": np.rad2deg(np.asarray(arm.base_rotation, dtype=float)).tolist(),
        "air_density_kg_per_m3": float(arm.air.density),
        "gravity_m_per_s2": float(arm.gravity),
        "drag": arm.air.drag,
        "strip_points": arm.air.strip_points,
        "drag_curve": arm.air.drag_curve,
        "buoyancy": arm.buoyancy is not None,
    }
    if arm.point_masses is not None:
        stated["point_masses"] = _entries(arm.point_masses)
    fitted = default_free(arm)
    others = {}
    for path, parameter in declared(arm).items():
        said, value = parameter.declaration, np.asarray(parameter.value(arm), dtype=float)
        # `chain` hangs trim weights at half a link's length, whatever the declared default.
        usual = said.frozen and not said.optional and bool(np.all(value == said.default))
        usual = usual and path != "buoyancy.trim_position"
        if path not in _KEYED and path not in fitted and not usual:
            others[path] = _plain(value)
    if others:
        stated["parameters"] = others
    return stated


def _plain(values: Any) -> Any:
    """One number where all are the same."""
    values = np.asarray(values, dtype=float)
    if values.ndim == 0:
        return float(values)
    return float(values[0]) if np.all(values == values[0]) else values.tolist()


def _entries(fixed: PointMasses) -> list[dict[str, Any]]:
    count = len(fixed.links)

    def row(value: Any) -> list[float]:
        return np.broadcast_to(0.0 if value is None else np.asarray(value), count).tolist()

    values = (fixed.mass, fixed.position, fixed.left, fixed.up)
    return [
        {"link": link, "mass_kg": mass, "position_m": x, "left_m": left, "up_m": up}
        for link, mass, x, left, up in zip(fixed.links, *map(row, values), strict=True)
    ]


def _axes(arm: Arm) -> str | list[list[float]]:
    if arm.joints.axes == named_axes("pitch_yaw", arm.count):
        return "pitch_yaw"
    return [list(axis) for axis in arm.joints.axes]


def sensors_from_definition(definition: Definition) -> Sensors:
    """What the `[sensors]` section states; what it does not state is left out."""
    given = definition.section(SensorsSection).given()
    known = {_SENSORS[key]: value for key, value in given.items() if value is not None}
    return replace(Sensors(), {path: np.multiply(v, si) for (path, si), v in known.items()})


def sensors_to_definition(sensors: Sensors) -> dict[str, Any]:
    """The `[sensors]` section: what the sensors do not leave out, in the TOML vocabulary."""
    on = declared(sensors)
    return {
        key: (np.asarray(on[path].value(sensors), dtype=float) / si).tolist()
        for key, (path, si) in _SENSORS.items()
        if path in on
    }
