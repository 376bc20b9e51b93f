"""Triangles and turns of the few shapes that a scene is drawn with."""

from typing import NamedTuple

import numpy as np

from .._typing import Float, Int

_ROUND = 24


class Mesh(NamedTuple):
    """A triangle mesh.

    Attributes:
        vertices: shape (vertex, 3).
        faces: indices of vertices, counterclockwise from outside, shape (face, 3).
    """

    vertices: Float[np.ndarray, "vertex 3"]
    faces: Int[np.ndarray, "face 3"]


def tube() -> Mesh:
    """A cylinder about the x axis from -1/2 to 1/2, of radius 1, with ends that are drawn in."""
    return _turned([(-0.5, 0.0), (-0.5, 0.7), (-0.47, 1.0), (0.47, 1.0), (0.5, 0.7), (0.5, 0.0)])


def ball() -> Mesh:
    """A sphere of radius 1."""
    places = np.linspace(-np.pi / 2, np.pi / 2, _ROUND // 2)
    return _turned([(float(np.sin(place)), float(np.cos(place))) for place in places])


def brick() -> Mesh:
    """A box from -1/2 to 1/2 along each axis, with corners of its own for each face."""
    corners: list[np.ndarray] = []
    faces: list[tuple[int, int, int]] = []
    for axis in range(3):
        for side in (-1.0, 1.0):
            across = np.roll(np.eye(3), axis, axis=1)
            ahead, right, up = across[0] * side, across[1] * side, across[2]
            first = len(corners)
            corners += [
                (ahead + a * right + b * up) / 2 for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))
            ]
            faces += [(first, first + 1, first + 2), (first, first + 2, first + 3)]
    return Mesh(np.array(corners), np.array(faces))


def _turned(outline: list[tuple[float, float]]) -> Mesh:
    """A body of revolution about x from pairs of x and radius."""
    turns = 2 * np.pi * np.arange(_ROUND) / _ROUND
    rings = [
        np.stack([np.full(_ROUND, x), radius * np.cos(turns), radius * np.sin(turns)], axis=1)
        for x, radius in outline
    ]
    here = np.arange(_ROUND)
    after = np.roll(here, -1)
    faces = []
    for index in range(len(outline) - 1):
        near, far = index * _ROUND, (index + 1) * _ROUND
        faces.append(np.stack([near + here, far + after, far + here], axis=1))
        faces.append(np.stack([near + here, near + after, far + after], axis=1))
    return Mesh(np.concatenate(rings), np.concatenate(faces))


def turns_to(directions: Float[np.ndarray, "row 3"]) -> Float[np.ndarray, "row 4"]:
    """Unit quaternions (w, x, y, z) of the shortest turns from the x axis to directions.

    Arguments:
        directions: of any length but 0; where it is 0 nothing is turned.
    """
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    ahead = np.where(lengths > 0, directions / np.where(lengths > 0, lengths, 1), [1.0, 0.0, 0.0])
    x, y, z = ahead.T
    turns = np.stack([1 + x, np.zeros_like(x), -z, y], axis=1)
    # Straight back every turn by half a circle is as short.
    turns[np.linalg.norm(turns, axis=1) < 1e-8] = [0.0, 0.0, 0.0, 1.0]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return turns
