"""One muscle of a joint against its bending angle: figs 9 and 10 of the paper."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..joint import BRANCHES, LARGEST_ANGLE, Correction, Joint, muscle_state
from ._joint_panels import angle_axis, shade_branches
from ._style import BLUE, VERMILLION, new_figure, plain


def angle_table(joint: Joint, *, corrected: bool, step_deg: float = 0.5) -> dict[str, np.ndarray]:
    """Everything about one muscle against its bending angle: the numbers of figs 9 and 10.

    Arguments:
        joint: the joint.
        corrected: with its corrections (fig. 10), or with none (fig. 9).
        step_deg: between two angles, deg.

    Returns:
        Columns of equal length, in the units that their names say. The angle 0 is there twice,
        as the outer and as the inner muscle.
    """
    if not corrected:
        joint = Joint(joint.geometry, Correction(reading="none"), joint.torque)
    end = np.rad2deg(LARGEST_ANGLE)
    sizes = np.linspace(0, end, round(end / step_deg) + 1)
    columns: dict[str, list[np.ndarray]] = {}
    for side, degrees in (("outer", -sizes[::-1]), ("inner", sizes)):
        state = muscle_state(joint, np.deg2rad(degrees), side=side)
        for name, values in {
            "angle_deg": degrees + 0.0,
            "side": np.full(len(degrees), side),
            "torque_N_m": state.torque,
            "contraction": state.contraction,
            "force_N": state.force,
            "wire_tension_N": state.wire_tension,
            "wire_slack_m": state.path.wire_slack,
            "push_x_N": state.push_x,
            "push_y_N": state.push_y,
            "branch": np.asarray(BRANCHES)[np.asarray(state.branch)],
        }.items():
            columns.setdefault(name, []).append(np.asarray(values))
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def angle_figure(joint: Joint, *, corrected: bool) -> Figure:
    """Contraction and force of one muscle against its bending angle: figs 9 and 10 of the paper.

    The grey band is where the muscle runs straight.

    Arguments:
        joint: the joint.
        corrected: with its corrections (fig. 10), or with none (fig. 9).

    Returns:
        The picture.
    """
    table = angle_table(joint, corrected=corrected)
    what = "with alpha and beta" if corrected else "without corrections"
    title = f"One muscle under {float(joint.torque):g} N m, {what}"
    figure = new_figure(10, 3.9, title)
    axes = figure.subplots(1, 2)
    for panel, name, label in zip(
        axes, ("contraction", "force_N"), ("contraction", "force (N)"), strict=True
    ):
        shade_branches(panel, joint)
        for side, colour in (("outer", VERMILLION), ("inner", BLUE)):
            rows = table["side"] == side
            panel.plot(table["angle_deg"][rows], table[name][rows], color=colour, linewidth=1.6)
        plain(panel, label)
        angle_axis(panel, "bending angle of the muscle")
        panel.set_ylim(bottom=0)
    handles = [
        Line2D([], [], color=BLUE, linewidth=1.6, label="inner muscle"),
        Line2D([], [], color=VERMILLION, linewidth=1.6, label="outer muscle"),
    ]
    figure.legend(
        handles=handles, loc="outside upper right", ncols=len(handles), fontsize=8, frameon=False
    )
    return figure
