"""The boxes of all obstacles, in rows."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._maths import rotate
from .._typing import Array, Bool, Float
from ._shapes import AbstractObstacle


class Solids(NamedTuple):
    """The boxes of several obstacles.

    Attributes:
        centre: in the base frame, m, shape (3, box).
        half: half of the sizes, m, shape (3, box).
        frame: unit vectors along the sizes in the base frame, as columns: [:, k, box] is the
            k-th.
        shared: whether a face is shared with another box: of the lower and the upper faces across
            each direction, shape (2, 3, box); numbers, and no part of what is traced.
    """

    centre: Float[Array, "3 box"]
    half: Float[Array, "3 box"]
    frame: Float[Array, "3 3 box"]
    shared: Bool[np.ndarray, "2 3 box"]


def solids(obstacles: Sequence[AbstractObstacle]) -> Solids:
    """The boxes of obstacles.

    Arguments:
        obstacles: at least one.
    """
    centres, halves, frames, shared = [], [], [], []
    for obstacle in obstacles:
        turn = obstacle.turn()
        frame = jnp.stack([rotate(turn, axis) for axis in jnp.eye(3, dtype=turn.dtype)], axis=1)
        for part in obstacle.parts():
            centres.append(obstacle.centre + frame @ part.centre)
            halves.append(part.half)
            frames.append(frame)
            shared.append(part.shared)
    return Solids(
        jnp.stack(centres, axis=-1),
        jnp.stack(halves, axis=-1),
        jnp.stack(frames, axis=-1),
        np.moveaxis(np.asarray(shared), 0, -1),
    )


def owners(obstacles: Sequence[AbstractObstacle]) -> np.ndarray:
    """The index of the obstacle that each box belongs to, shape (box,)."""
    return np.repeat(np.arange(len(obstacles)), [len(each.parts()) for each in obstacles])
