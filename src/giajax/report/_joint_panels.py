"""What the pictures of a joint share: an axis of angles, and its branches in grey."""

import numpy as np
from matplotlib.axes import Axes

from ..joint import LARGEST_ANGLE, Joint, branch_angles
from ._style import DEGREE, LIGHT


def shade_branches(panel: Axes, joint: Joint) -> None:
    """The window about 0 in which the muscle runs straight."""
    taut, wrapped = np.rad2deg(branch_angles(joint.geometry))
    end = np.rad2deg(LARGEST_ANGLE)
    lower, upper = np.nan_to_num(wrapped, nan=-end), np.nan_to_num(taut, nan=end)
    panel.axvspan(lower, upper, color=LIGHT, linewidth=0, zorder=0)


def angle_axis(panel: Axes, name: str) -> None:
    """From the one end of the joint to the other."""
    end = np.rad2deg(LARGEST_ANGLE)
    panel.set_xlim(-end, end)
    panel.set_xticks(np.arange(-end, end + 1, 20))
    panel.set_xlabel(f"{name} ({DEGREE})")
