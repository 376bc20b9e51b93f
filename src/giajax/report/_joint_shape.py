"""The joint itself at some bending angles: links, muscle, wire and contact points, to scale."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..joint import BRANCHES, Joint, muscle_state
from ..models import Scene, joint_scene
from ._scene import draw_scene
from ._style import BLUE, DEGREE, GREEN, GREY, INK, MINUS, new_figure, plain

_DRAWN = (60.0, 30.0, 10.0, 2.0, -2.0, -10.0, -30.0, -60.0)

_COLOURS = {"balloon": GREY, "muscle": BLUE, "wire": GREEN}
_WIDTHS = {"muscle": 2.0, "wire": 1.4}

# Letters at the left and below their points, so that none lies on another.
_LEFT, _BELOW = frozenset("AMBP"), frozenset("EBD")


def joint_figure(joint: Joint, degrees: Sequence[float] = _DRAWN) -> Figure:
    """The joint at some bending angles: links, muscle, wire and contact points, to scale.

    One muscle is drawn, on +y: the inner one at positive angles, the outer one at negative ones.

    Arguments:
        joint: the joint.
        degrees: bending angles, deg.

    Returns:
        The picture.
    """
    columns = 2 if len(degrees) > 1 else 1
    rows = -(-len(degrees) // columns)
    figure = new_figure(11, 2.35 * rows + 0.5, "One muscle (blue) and its wire at rest, to scale")
    grid = figure.subplots(rows, columns, squeeze=False)
    scene = joint_scene(joint.geometry, np.deg2rad(degrees))
    # Down the columns, so that one shows the inner and one the outer muscle.
    for index, panel in enumerate(grid.T.flat):
        if index >= len(degrees):
            panel.set_visible(False)
            continue
        _draw_joint(panel, joint, scene, index, degrees[index])
    handles = [
        Line2D([], [], color=BLUE, linewidth=2, label="muscle"),
        Line2D([], [], color=GREEN, linewidth=1.4, label="wire, taut"),
        Line2D([], [], color=GREEN, linewidth=1.4, linestyle=(0, (2, 2)), label="wire, slack"),
        Line2D([], [], color=GREY, linewidth=6, alpha=0.3, label="balloon"),
    ]
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False
    )
    return figure


def joint_points(joint: Joint, angle: float) -> dict[str, np.ndarray]:
    """Where the lettered points of figs 7 and 8 are at a bending angle.

    Arguments:
        joint: the joint.
        angle: bending angle of the muscle, rad.

    Returns:
        Points in the frame of the bisector, m, each of shape (2,): A, B, C, D, E and H of an
        inner muscle; M, P, O, Q, N, B, D and E of an outer one.
    """
    markers = joint_scene(joint.geometry, [angle]).markers
    points = {name: at[0, :2] for name, at in markers.items()}
    return {name: point for name, point in points.items() if np.all(np.isfinite(point))}


def _draw_joint(panel: Axes, joint: Joint, scene: Scene, sample: int, degrees: float) -> None:
    angle = np.deg2rad(degrees)
    draw_scene(panel, scene, sample, axes="xy", colours=_COLOURS, widths=_WIDTHS)
    for name, points in scene.markers.items():
        point = points[sample, :2]
        if not np.all(np.isfinite(point)):
            continue
        left = name in _LEFT
        panel.annotate(
            name,
            (point[0], point[1]),
            xytext=(-3 if left else 3, -3 if name in _BELOW else 3),
            textcoords="offset points",
            fontsize=7.5,
            color=INK,
            ha="right" if left else "left",
            va="top" if name in _BELOW else "bottom",
        )
    state = muscle_state(joint, angle)
    force = f"{float(state.force):.2f}".replace("-", MINUS)
    shown = f"{degrees:g}".replace("-", MINUS)
    branch = BRANCHES[int(state.branch)]
    plain(
        panel, f"{shown}{DEGREE}: {branch}; contraction {float(state.contraction):.3f}, {force} N"
    )
    panel.set_xlim(-1.02, 1.02)
    height = float(np.sin(angle / 2))
    panel.set_ylim(min(-0.22, height - 0.18), max(0.34, height + 0.3))
