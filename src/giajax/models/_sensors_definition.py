"""From the TOML vocabulary to the sensors of an arm, its cameras and landmarks, and back."""

from typing import Any

import jax.numpy as jnp

from .._errors import InputError
from ..kinds import (
    CamerasSection,
    LandmarksSection,
    PinholeSection,
    SensorsSection,
    sections_of_cameras,
)
from ..parameters import replace
from ..runs import Definition
from ._build import parameter_values
from ._pinhole import Pinhole
from ._sensors import Camera, Landmark, Sensors

SECTIONS = ("sensors", "camera", "landmark")


def sensors_from_definition(definition: Definition) -> Sensors:
    """What `[sensors]`, `[camera]` and `[landmark]` state; what they do not state is left out.

    Raises:
        InputError: a camera without what it cannot be without.
    """
    cameras, marks = definition.section(CamerasSection), definition.section(LandmarksSection)
    sensors = Sensors(
        camera=Camera(pinholes={name: _pinhole(name, of) for name, of in cameras.named().items()}),
        landmark={name: Landmark() for name in marks.named()},
    )
    stated = definition.section(SensorsSection).values() | cameras.values() | marks.values()
    return replace(sensors, stated)


def _pinhole(name: str, section: PinholeSection) -> Pinhole:
    """The camera of a section, apart from the values of its parameters."""
    keys = section.contents()
    needed = ["size_px", "focal_length_px"]
    if keys.get("mount", "room") == "room":
        needed += ["position_m", "rotation_deg"]
    for key in needed:
        if keys.get(key) is None:
            raise InputError(
                f"[camera.{name}] does not state {key}: give it, as well as it is known (a fit can "
                "find what is not whole pixels)"
            )
    width, height = keys["size_px"]
    # The middle of the picture, where the middle of its first pixel is (0, 0).
    return Pinhole(
        mount=keys.get("mount", "room"),
        size=(width, height),
        centre=jnp.array([(width - 1) / 2, (height - 1) / 2]),
    )


def sensors_to_definition(sensors: Sensors) -> dict[str, dict[str, Any]]:
    """`[sensors]`, `[camera]` and `[landmark]`: what the sensors do not leave out, as in files."""
    values = parameter_values(sensors)
    errors = SensorsSection.keys_of(values)
    sections = {**({"sensors": errors} if errors else {}), **sections_of_cameras(values)}
    for name, camera in sensors.camera.pinholes.items():
        about = {"mount": camera.mount, "size_px": list(camera.size)}
        sections["camera"][name] = about | sections["camera"][name]
    return sections
