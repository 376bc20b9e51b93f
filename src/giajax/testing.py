"""Checks of classes of one's own, each one line of a test: what is wrong is an `InputError`."""

from .fitting import check_loss as check_loss
from .mechanics.arm import (
    check_drag_law as check_drag_law,
    check_joint_law as check_joint_law,
    check_wind as check_wind,
)
