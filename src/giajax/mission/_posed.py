"""Where a camera is that sees four corners of a plane."""

import jax.numpy as jnp

from .._maths import cross, safe_norm
from .._typing import Array, Float
from ..models import Pinhole, View
from ._opening import Opening


def posed(camera: Pinhole, opening: Opening, pixels: Float[Array, "4 2"]) -> View:
    """The view of a camera that sees all corners of an opening: four points of a plane.

    The homography from the plane to the picture has two axes of the plane and its origin, as the
    camera has them, as its columns (Zhang, IEEE PAMI 22 (2000) 1330).
    """
    rays = camera.directions(pixels)
    flat = opening.local(opening.corners)[:, 1:]
    x, y = rays[:, 0] / rays[:, 2], rays[:, 1] / rays[:, 2]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    u, v = flat.T
    rows = jnp.concatenate(
        [
            jnp.stack([u, v, one, zero, zero, zero, -x * u, -x * v], axis=1),
            jnp.stack([zero, zero, zero, u, v, one, -y * u, -y * v], axis=1),
        ]
    )
    found = jnp.linalg.solve(rows, jnp.concatenate([x, y]))
    plane = jnp.concatenate([found, jnp.ones(1, found.dtype)]).reshape(3, 3)
    scale = 2 / (safe_norm(plane[:, 0]) + safe_norm(plane[:, 1]))
    plane = scale * plane * jnp.sign(plane[2, 2])
    first = plane[:, 0] / safe_norm(plane[:, 0])
    second = plane[:, 1] - jnp.sum(first * plane[:, 1]) * first
    second = second / safe_norm(second)
    # Columns: outwards, to the left and up, in the camera's frame.
    turn = jnp.stack([cross(first, second), first, second], axis=1)
    axes = opening.frame @ turn.T
    return View(opening.centre - axes @ plane[:, 2], axes)
