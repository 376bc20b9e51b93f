"""Pressures of the muscles of an arm in a run: which columns there may be."""

import numpy as np

from .._errors import InputError
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
