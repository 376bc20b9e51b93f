"""From the TOML vocabulary to an arm, and back."""

from typing import Any

import numpy as np

from .._errors import InputError
from ..arm import Arm, chain, named_axes, preset
from ..runs import Definition

_ARRAYS = {
    "link_length_m": "length",
    "link_diameter_m": "diameter",
    "link_mass_kg": "mass",
    "link_centre_of_mass_m": "centre_of_mass",
    "link_inertia_transverse_kg_m2": "inertia_transverse",
    "link_inertia_axial_kg_m2": "inertia_axial",
}


def arm_from_definition(definition: Definition) -> Arm:
    """The arm that the `[arm]` section of a sidecar, a fit definition or an arm file states.

    What is not stated is that of the preset.

    Raises:
        InputError: an unknown preset, or lists that do not have one element per link.
    """
    given = dict(definition.arm.given())
    base = preset(given.pop("preset", "takeichi_20m"))
    links = given.pop("links", None) or _listed(given) or base.count
    arguments: dict[str, Any] = {
        argument: given.pop(key) for key, argument in _ARRAYS.items() if key in given
    }
    if "base_rotation_deg" in given:
        arguments["base_rotation"] = np.deg2rad(given.pop("base_rotation_deg"))
    if "gravity_m_per_s2" in given:
        arguments["gravity"] = given.pop("gravity_m_per_s2")
    if "air_density_kg_per_m3" in given:
        arguments["air_density"] = given.pop("air_density_kg_per_m3")
    if "joint_axes" in given:
        arguments["joint_axes"] = given.pop("joint_axes")
    if given:
        raise InputError(f"the key {next(iter(given))} of [arm] is not known to the arm model")
    return chain(links, **arguments)


def _listed(given: dict[str, Any]) -> int | None:
    lengths = [
        len(value)
        for key, value in given.items()
        if isinstance(value, list) and key != "base_rotation_deg"
    ]
    return lengths[0] if lengths else None


def arm_to_definition(arm: Arm) -> dict[str, Any]:
    """The `[arm]` section of an arm: all of its constants, in the TOML vocabulary."""

    def plain(values: Any) -> Any:
        values = np.asarray(values, dtype=float)
        return float(values[0]) if np.all(values == values[0]) else values.tolist()

    return {
        "links": arm.count,
        **{key: plain(getattr(arm.links, name)) for key, name in _ARRAYS.items()},
        "joint_axes": _axes(arm),
        "base_rotation_deg": np.rad2deg(np.asarray(arm.base_rotation, dtype=float)).tolist(),
        "air_density_kg_per_m3": float(arm.air.density),
        "gravity_m_per_s2": float(arm.gravity),
    }


def _axes(arm: Arm) -> str | list[list[float]]:
    if arm.joints.axes == named_axes("pitch_yaw", arm.count):
        return "pitch_yaw"
    return [list(axis) for axis in arm.joints.axes]
