"""A scene as a picture: what a model looks like at one sample, from one side."""

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from ..models import Scene
from ._style import BLUE, GREY, INK

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


def _outline(points: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """Both edges of a round body about a polyline, shape (2 point, 2)."""
    steps = np.diff(points, axis=0)
    steps = np.concatenate([steps[:1], steps[:-1] + steps[1:], steps[-1:]])
    lengths = np.linalg.norm(steps, axis=1, keepdims=True)
    # A body that is seen along its axis has no direction in the picture: any will do.
    along = np.where(lengths > 0, steps / np.where(lengths > 0, lengths, 1.0), [1.0, 0.0])
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) * radii[:, None]
    return np.concatenate([points + across, (points - across)[::-1]])
