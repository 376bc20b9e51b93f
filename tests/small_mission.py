"""A mission of a short arm that brings its tip in within half a minute: quick to compile."""

import functools
import tomllib

from giajax import Definition
from giajax.apps.mission import Mission

FILE = """
model = "arm"

[arm]
preset = "takeichi_20m"
links = 8
trim = true
base_rotation_deg = [0.0, -90.0, 0.0]

[arm.parameters]
"joints.memory.strength" = 0.05

[[arm.obstacles]]
shape = "wall"
name = "roof"
centre_m = [4.0, 0.0, 1.9]
opening_m = [2.0, 2.0]
margins_m = [1.0, 1.0, 1.0, 1.0]
thickness_m = 0.2
rotation_deg = [0.0, -90.0, 0.0]

[camera.tip]
mount = "tip"
size_px = [640, 480]
focal_length_px = 200.0
centre_px = [319.5, 239.5]
rotation_deg = [0.0, 35.0, 0.0]

[mission]
limit_s = 100.0

[mission.operator]
latency_s = 0.4
approach = {joints = [1, 3, 5, 7], angles_deg = [-8.0, -13.0, -32.0, -55.0]}

[mission.spread]
"joints.pitch_stiffness" = 0.2
"""


def small_mission(controller: str = "mpc", **changes: object) -> Mission:
    """Return the mission with other values of its file, e.g. `mission__limit_s=20.0`."""
    return mission_of(FILE, controller, changes)


def mission_of(text: str, controller: str, changes: dict[str, object]) -> Mission:
    """Return the mission of a file, with other values."""
    data = tomllib.loads(text)
    for path, value in changes.items():
        *sections, key = path.split("__")
        functools.reduce(lambda table, name: table[name], sections, data)[key] = value
    return Mission.from_definition(Definition.parse(data), controller=controller)
