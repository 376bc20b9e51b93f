"""What of a box is nearest to points: a face, an edge or a corner."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from .._maths import safe_norm
from .._typing import Array, Float


class Nearest(NamedTuple):
    """The surface of boxes as seen from points.

    Attributes:
        distance: to the surface, m; negative inside.
        normal: unit vector from the nearest point of the surface, in the frame of the box.
    """

    distance: Float[Array, "*shape"]
    normal: Float[Array, "3 *shape"]


def nearest(
    x: Float[Array, "3 *shape"],
    half: Float[Array, "3 *#shape"],
    shared: Float[Array, "2 3 *#shape"],
) -> Nearest:
    """The nearest of the surface of boxes.

    Inside, it is that of the faces that are not shared. Where several are equally near, it is the
    first of them, and the distance has a kink.

    Arguments:
        x: points in the frames of the boxes, m.
        half: half of the sizes of the boxes, m.
        shared: 1 for faces that are shared with other boxes, else 0: lower ones, upper ones.

    Returns:
        Distance, m, and normal.
    """
    beyond = jnp.abs(x) - half
    outside = jnp.maximum(beyond, 0)
    length = safe_norm(outside)
    out = length > 0
    # A shared face is far away from everything inside.
    far = jnp.where(x < 0, shared[0], shared[1]) * 1e6
    depth = beyond - far
    face = jnp.argmax(depth, axis=0)
    inside = jnp.max(depth, axis=0)
    sign = jnp.where(x < 0, -1.0, 1.0).astype(x.dtype)
    axis = (np.arange(3).reshape(3, *(1,) * (x.ndim - 1)) == face[None]).astype(x.dtype)
    pointing = jnp.where(out[None], outside / jnp.where(out, length, 1)[None], axis)
    return Nearest(jnp.where(out, length, inside), sign * pointing)
