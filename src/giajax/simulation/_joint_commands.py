"""Commands that move single joints of a straight arm."""

from collections.abc import Mapping

import numpy as np

from .._errors import InputError
from ._signal import Signal, ramps, steps


def joint_steps(joints: int, angles: Mapping[int, float], *, time: float = 0.0) -> Signal:
    """A command that steps at one time from the straight arm to other angles.

    Arguments:
        joints: number of joints of the arm.
        angles: commanded angle by joint number (1 is the base joint), rad.
        time: of the step, s.

    Returns:
        The command, in rad, with one column for each joint.

    Example:
        >>> import giajax
        >>> command = giajax.joint_steps(20, {1: 0.5236}, time=0.5)
    """
    target = _target(joints, angles)
    return steps([min(0.0, time) - 1.0, time], [np.zeros(joints), target])


def joint_ramps(
    joints: int, angles: Mapping[int, float], *, start: float = 0.0, duration: float = 1.0
) -> Signal:
    """A command that moves linearly from the straight arm to other angles.

    Arguments:
        joints: number of joints of the arm.
        angles: commanded angle at the end by joint number (1 is the base joint), rad.
        start, duration: of the movement, s.

    Returns:
        The command, in rad, with one column for each joint.
    """
    if not duration > 0:
        raise InputError(
            f"a ramp lasts {duration} s: give a positive duration, or use joint_steps for a step"
        )
    return ramps([start, start + duration], [np.zeros(joints), _target(joints, angles)])


def _target(joints: int, angles: Mapping[int, float]) -> np.ndarray:
    target = np.zeros(joints)
    for joint, angle in angles.items():
        if not 1 <= joint <= joints:
            raise InputError(f"joint {joint} is not in the arm: give a number from 1 to {joints}")
        target[joint - 1] = angle
    return target
