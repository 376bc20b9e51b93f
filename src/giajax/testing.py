"""Checks of user-defined classes, one line per test; problems are reported as `InputError`."""

from .fitting import check_loss as check_loss
from .mechanics.arm import (
    check_drag_law as check_drag_law,
    check_joint_law as check_joint_law,
    check_wind as check_wind,
)
