"""A scene as a picture: what a model looks like at one sample, from one side."""

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from ..models import Block, Scene
from ._style import BLUE, GREY, INK, LIGHT

_SLACK = (0, (2, 2))
_AXIS = (0, (6, 3))


def draw_scene(
    panel: Axes,
    scene: Scene,
    sample: int,
    *,
    axes: str = "xz",
    colours: Mapping[str, str] | None = None,
    widths: Mapping[str, float] | None = None,
) -> None:
    """Draw one sample of a scene, to scale: bodies in grey, threads, and markers as dots.

    Arguments:
        panel: where.
        scene: what a model's `scene` gives.
        sample: which sample.
        axes: which two coordinates are seen: "xz" from the side, "xy" from above.
        colours: of lines by name; grey for bodies and blue for threads by default.
        widths: of threads by name, points; 1.4 by default.
    """
    seen = ["xyz".index(name) for name in axes]
    for line in scene.lines:
        points = line.points[sample][:, seen]
        body = bool(np.any(line.radii > 0))
        colour = (colours or {}).get(line.name, GREY if body else BLUE)
        if body:
            outline = _outline(points, line.radii)
            panel.add_patch(Polygon(outline, closed=True, color=colour, alpha=0.22, linewidth=0))
            panel.plot(*points.T, color=colour, linewidth=0.7, linestyle=_AXIS)
            continue
        hangs = line.loose is not None and bool(line.loose[sample])
        width = (widths or {}).get(line.name, 1.4)
        panel.plot(*points.T, color=colour, linewidth=width, linestyle=_SLACK if hangs else "-")
    for marker in scene.markers.values():
        panel.plot(*marker[sample][seen], "o", color=INK, markersize=2.6, zorder=5)
    panel.set_aspect("equal")


def draw_blocks(panel: Axes, blocks: Sequence[Block], *, axes: str = "xz") -> None:
    """Draw what stands around, as it is seen from one side; the limits of the panel stay.

    Arguments:
        panel: where, with its limits set.
        blocks: of a scene.
        axes: which two coordinates are seen, as of `draw_scene`.
    """
    seen, limits = ["xyz".index(name) for name in axes], (panel.get_xlim(), panel.get_ylim())
    signs = np.stack(np.meshgrid(*[[-0.5, 0.5]] * 3), axis=-1).reshape(-1, 3)
    for block in blocks:
        corners = (block.centre + (signs * block.size) @ block.axes.T)[:, seen]
        outline = corners[ConvexHull(corners).vertices]
        panel.add_patch(
            Polygon(outline, closed=True, facecolor=LIGHT, edgecolor=GREY, linewidth=0.5, zorder=0)
        )
    panel.set_xlim(limits[0])
    panel.set_ylim(limits[1])


def _outline(points: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Both edges of a round body about a polyline, shape (2 point, 2)."""
    steps = np.diff(points, axis=0)
    steps = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    # A body that is seen along its axis has no direction in the picture: any will do.
    along = np.where(lengths > 0, steps / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0])
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) * radii[:, None]
    return np.concatenate([points + across, (points - across)[::-1]])
