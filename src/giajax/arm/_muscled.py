"""Joints with muscles, by a name or by their numbers."""

import dataclasses
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from .._errors import InputError
from ..joint import JointPair
from ._joints import Joints
from ._pneumatics import Pneumatics


def muscles_in(muscles: str | Sequence[int], pair: JointPair | None, joints: Joints) -> Pneumatics:
    """Muscles in the joints of a name or of these numbers."""
    named = {"pitch": ~joints.is_yaw, "all": np.ones(len(joints.axes), bool)}
    if isinstance(muscles, str) and muscles in named:
        numbers = np.flatnonzero(named[muscles]) + 1
    else:
        numbers = np.asarray(muscles)
    if numbers.ndim != 1 or numbers.dtype.kind not in "iu":
        raise InputError(
            f'muscles is {muscles!r}: use "pitch", "all" or a list of numbers of joints'
        )
    chosen = tuple(numbers.tolist())
    if pair is None:
        return Pneumatics(chosen)
    return Pneumatics(chosen, joint=pair.joint, muscle=pair.muscle)


def without_idle_springs(joints: Joints, pneumatics: Pneumatics) -> Joints:
    """Joints in which a stiffness that no spring has is 0, so that no fit looks for it."""
    sprung = np.setdiff1d(np.arange(len(joints.axes)), np.asarray(pneumatics.joints) - 1)
    yaws = joints.is_yaw[sprung]
    none = jnp.zeros(())
    return dataclasses.replace(
        joints,
        pitch_stiffness=joints.pitch_stiffness if np.any(~yaws) else none,
        yaw_stiffness=joints.yaw_stiffness if np.any(yaws) else none,
    )
