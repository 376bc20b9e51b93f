"""Axes of the joints, by name or as vectors."""

from collections.abc import Sequence

import numpy as np

from .._errors import InputError

Axis = tuple[float, float, float]

PITCH: Axis = (0.0, -1.0, 0.0)
"""Axis of a pitch joint: a positive angle raises the arm."""

YAW: Axis = (0.0, 0.0, 1.0)
"""Axis of a yaw joint: a positive angle turns the arm to the left."""


def named_axes(axes: str | Sequence[str | Sequence[float]], count: int) -> tuple[Axis, ...]:
    """Unit axes of the joints from their names.

    Arguments:
        axes: "pitch_yaw" (odd joints pitch, even joints yaw) or, for each joint, "pitch", "yaw"
            or a vector, which is normalised.
        count: number of joints.

    Returns:
        One unit vector (x, y, z) for each joint, in the frame of the straight arm.

    Raises:
        InputError: an unknown name, a zero vector, or a list of another length.
    """
    if axes == "pitch_yaw":
        return tuple(YAW if joint % 2 else PITCH for joint in range(count))
    if isinstance(axes, str) or len(axes) != count:
        raise InputError(
            f'joint_axes is {axes!r}: give "pitch_yaw" or a list of {count} axes, '
            'each "pitch", "yaw" or [x, y, z]'
        )
    return tuple(_unit_axis(axis) for axis in axes)


def _unit_axis(axis: str | Sequence[float]) -> Axis:
    if isinstance(axis, str):
        try:
            return {"pitch": PITCH, "yaw": YAW}[axis]
        except KeyError:
            raise InputError(
                f'the joint axis {axis!r} is unknown: use "pitch", "yaw" or [x, y, z]'
            ) from None
    vector = np.asarray(axis, dtype=float)
    norm = np.linalg.norm(vector)
    if vector.shape != (3,) or not norm > 0:
        raise InputError(
            f"the joint axis {list(axis)} is no direction: give three numbers, not all zero"
        )
    # A unit vector stays as it is, so that an arm comes back from its file bit for bit.
    unit = vector if abs(norm - 1) < 1e-15 else vector / norm
    x, y, z = (float(component) for component in unit)
    return x, y, z
