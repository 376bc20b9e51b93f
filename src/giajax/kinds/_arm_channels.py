"""The channels of an arm."""

from ._arm_pressures import PRESSURES
from ._kind import ChannelKind

DEFAULT_PRESET = "takeichi_20m"
DEFAULT_LINKS = 20

CHANNELS = (
    ChannelKind("joint_command", "jointNN_command", "angle", "input"),
    ChannelKind("joint_angle", "jointNN_angle", "angle", "output", noise="angle_deg"),
    ChannelKind("joint_rate", "jointNN_rate", "angular_velocity", "output", noise="rate_deg_per_s"),
    ChannelKind("joint_torque", "jointNN_torque", "torque", "input"),
    ChannelKind("joint_pressure_first", "jointNN_pressure_first", "pressure", "input"),
    ChannelKind("joint_pressure_second", "jointNN_pressure_second", "pressure", "input"),
    ChannelKind("link_angle", "linkNN_angle", "angle", "output", noise="angle_deg"),
    ChannelKind("link_position", "linkNN_x", "length", "output", noise="position_m"),
    ChannelKind("link_pixel", "linkNN_u", "pixel", "output", noise="pixel_px"),
    ChannelKind("tip_position", "tip_x", "length", "output", noise="position_m"),
    ChannelKind("tip_pixel", "tip_u", "pixel", "output", noise="pixel_px"),
    ChannelKind("mark_pixel", "markNN_u", "pixel", "output", noise="pixel_px"),
    ChannelKind("wind", "wind_x", "velocity", "surroundings"),
    ChannelKind("link_wind", "linkNN_wind_x", "velocity", "surroundings"),
)
PIXELS = frozenset({"link_pixel", "tip_pixel", "mark_pixel"})
"""Rows of what cameras with a lens show."""

WINDS = ("wind", "link_wind")
COMMANDS = ("joint_command", "joint_torque", *PRESSURES)
