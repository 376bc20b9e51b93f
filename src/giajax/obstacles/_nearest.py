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
    first of them, and the distance has a kink. Along a line the distance is convex.

    Arguments:
        x: points in the frames of the boxes, m.
        half: half of the sizes of the boxes, m.
        shared: 1 for faces that are shared with other boxes, else 0: lower ones, upper ones.

    Returns:
        Distance, m, and normal.
    """
    outside = jnp.maximum(jnp.abs(x) - half, 0)
    length = safe_norm(outside)
    out = length > 0
    # A shared face is far away from everything inside. Upper faces first, then lower ones.
    depth = jnp.concatenate([x - half - 1e6 * shared[1], -x - half - 1e6 * shared[0]])
    face = jnp.argmax(depth, axis=0)
    inside = jnp.max(depth, axis=0)
    faces = np.arange(3).reshape(3, *(1,) * (x.ndim - 1))
    axis = (face[None] == faces).astype(x.dtype) - (face[None] == faces + 3).astype(x.dtype)
    pointing = jnp.sign(x) * outside / jnp.where(out, length, 1)[None]
    return Nearest(jnp.where(out, length, inside), jnp.where(out[None], pointing, axis))
