"""What scenes are drawn of: their sizes, and the pieces of their lines."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .._typing import Float
from ..models import Block, Scene
from ._show import Show

# Of a box without an end so much is drawn beyond the scene, and below its surface, in extents.
_GROUND, _PLATE = 0.6, 0.02

# In extents: what is larger has no end that anybody sees.
_ENDLESS = 5.0


class Scale(NamedTuple):
    """Sizes that all shows of a stage have in common.

    Attributes:
        extent: of everything, m.
        force: that the longest arrow stands for, N.
        pressure: of the brightest muscle, Pa.
    """

    extent: float
    force: float
    pressure: float


def scale_of(shows: Sequence[Show]) -> Scale:
    """The sizes of what belongs to some shows."""
    low, high = bounds(shows)
    arrows = [arrows for show in shows for arrows in show.scene.arrows]
    force = max((_largest(np.linalg.norm(each.vectors, axis=-1)) for each in arrows), default=0.0)
    lines = [line for show in shows for line in show.scene.lines if line.pressure is not None]
    pressure = max((_largest(line.pressure) for line in lines), default=0.0)
    return Scale(float(np.max(high - low)) or 1.0, force, pressure)


def _largest(values: Any) -> float:
    return float(np.nanmax(values, initial=0.0))


def bounds(shows: Sequence[Show]) -> Float[np.ndarray, "2 3"]:
    """Least and greatest coordinates of what moves in some shows, m."""
    extents = np.stack([show.scene.extent() for show in shows])
    return np.stack([extents[:, 0].min(axis=0), extents[:, 1].max(axis=0)])


def cut(centre: Any, size: Any, axes: Any, low: Any, high: Any) -> tuple[np.ndarray, np.ndarray]:
    """Of a box that is far larger than a scene, the part about it.

    Arguments:
        centre, size, axes: of the box, as of a `Block`.
        low, high: least and greatest coordinates of the scene, m.

    Returns:
        Centre and size of that part, m.
    """
    extent = float(np.max(high - low))
    middle = axes.T @ ((low + high) / 2 - centre)
    reach = np.abs(axes.T) @ ((high - low) / 2)
    # Of ground that the scene is above, a thin plate will do.
    above = np.abs(middle) > size / 2
    room = np.where(above, _PLATE, _GROUND) * extent
    near = np.where(above, np.sign(middle) * size / 2, middle - reach)
    far = np.where(above, near, middle + reach)
    endless = size > _ENDLESS * extent
    least = np.where(endless, np.maximum(-size / 2, near - room), -size / 2)
    most = np.where(endless, np.minimum(size / 2, far + room), size / 2)
    return centre + axes @ ((least + most) / 2), most - least


def ends(block: Block, extent: float) -> Float[np.ndarray, "2 3"] | None:
    """Least and greatest coordinates of a box, m; None of one without an end."""
    if np.any(block.size > _ENDLESS * extent):
        return None
    reach = np.abs(block.axes) @ block.size / 2
    return np.stack([block.centre - reach, block.centre + reach])


def segments(scene: Scene, sample: int, *, bodies: bool) -> tuple[np.ndarray, ...]:
    """Starts, ends and radii of the pieces of bodies, or of threads."""
    starts, ends, radii = [], [], []
    for line in scene.lines:
        if bool(np.any(line.radii > 0)) is bodies:
            points = line.points[sample]
            starts.append(points[:-1])
            ends.append(points[1:])
            radii.append((line.radii[1:] + line.radii[:-1]) / 2)
    if not starts:
        return np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0)
    return np.concatenate(starts), np.concatenate(ends), np.concatenate(radii)


def joints(scene: Scene, sample: int) -> tuple[np.ndarray, np.ndarray]:
    """Where the links of an arm begin, and their radii."""
    links = [line for line in scene.lines if line.name == "link"]
    points = np.array([line.points[sample, 0] for line in links]).reshape(-1, 3)
    return points, np.array([line.radii[0] for line in links])
