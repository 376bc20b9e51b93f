"""Pressures of the muscles of an arm in a run: which columns there may be."""

from collections.abc import Callable

import numpy as np

from .._errors import InputError
from ._arm_sections import ArmSection
from ._content import Content, Wording

PRESSURES = ("joint_pressure_first", "joint_pressure_second")
"""Rows of the column table: of the muscle towards which a positive angle bends, and the other."""


def check_pressures(content: Content, wording: Wording) -> None:
    """Both muscles of a joint, pressures that there are, and no other command of that joint."""
    names = {(channel.kind, channel.index): channel for channel in content.channels.values()}
    for (kind, joint), channel in names.items():
        if kind not in PRESSURES:
            continue
        (other,) = (row for row in PRESSURES if row != kind)
        if (other, joint) not in names:
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is there without that of the joint's "
                f"other muscle: add the column joint{joint:02d}_{other.removeprefix('joint_')}_kPa"
            )
        if ("joint_command", joint) in names:
            raise InputError(
                f"{wording.source}: joint {joint} has a command and pressures, but one of them "
                "moves it: remove the column of the other"
            )
        low = np.flatnonzero(content.values[channel.name] < 0)
        if low.size:
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is below 0 in {wording.at(low[0])}: give "
                "the pressure above the surroundings"
            )
        if (joints := _with_muscles(content.definition.section(ArmSection))) and not joints(joint):
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is there, but joint {joint} has no "
                "muscles: correct the name, or muscles in [arm]"
            )


def _with_muscles(section: ArmSection) -> Callable[[int | None], bool] | None:
    """Whether a joint has muscles; None where it is not known here."""
    muscles, axes = section.muscles, section.joint_axes
    if isinstance(muscles, list):
        return lambda joint: joint in muscles
    if muscles != "pitch":
        return None
    if axes in (None, "pitch_yaw"):
        return lambda joint: joint is not None and joint % 2 == 1
    return lambda joint: joint is not None and axes[joint - 1 : joint] != ["yaw"]
