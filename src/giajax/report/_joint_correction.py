"""Alpha and beta of a joint, in both readings of the paper."""

import dataclasses

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..joint import LARGEST_ANGLE, Joint, muscle_state
from ._joint_panels import angle_axis
from ._style import BLUE, GREY, INK, VERMILLION, new_figure, plain


def correction_table(
    joint: Joint, *, reading: str, step_deg: float = 0.05
) -> dict[str, np.ndarray]:
    """Alpha and beta of a joint against the bending angle of a muscle.

    Arguments:
        joint: the joint, whose own alpha and beta these are.
        reading: of beta, "continuous" or "printed".
        step_deg: between two angles, deg.

    Returns:
        Columns of equal length, in the units that their names say. The angle 0 is there twice.
    """
    correction = dataclasses.replace(joint.correction, reading=reading)
    form = dataclasses.replace(joint, correction=correction)
    end = np.rad2deg(LARGEST_ANGLE)
    sizes = np.linspace(0, end, round(end / step_deg) + 1)
    columns: dict[str, list[np.ndarray]] = {}
    for side, degrees in (("outer", -sizes[::-1]), ("inner", sizes)):
        torque = muscle_state(form, np.deg2rad(degrees), side=side).torque
        for name, values in {
            "reading": np.full(len(degrees), reading),
            "side": np.full(len(degrees), side),
            "angle_deg": degrees + 0.0,
            "added_torque_N_m": np.asarray(torque) - float(joint.torque),
        }.items():
            columns.setdefault(name, []).append(values)
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def correction_figure(joint: Joint) -> Figure:
    """Alpha and beta of a joint in both readings of the paper: the erratum."""
    figure = new_figure(8, 3.6, "Corrections: with the size of the angle, and as printed")
    panel = figure.subplots()
    end = np.rad2deg(LARGEST_ANGLE)
    for reading, colour, style in (("printed", GREY, (0, (3, 2))), ("continuous", VERMILLION, "-")):
        table = correction_table(joint, reading=reading)
        for side in ("outer", "inner"):
            rows = table["side"] == side
            panel.plot(
                table["angle_deg"][rows],
                table["added_torque_N_m"][rows],
                color=BLUE if side == "inner" and reading == "continuous" else colour,
                linestyle=style,
                linewidth=1.4,
            )
    panel.axhline(-float(joint.torque), color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    panel.text(end - 1, -float(joint.torque), "below this the muscle would have to push",
               fontsize=8, color=INK, ha="right", va="bottom")  # fmt: skip
    plain(panel, "added torque (N m)")
    angle_axis(panel, "bending angle of the muscle")
    handles = [
        Line2D([], [], color=BLUE, label="alpha"),
        Line2D([], [], color=VERMILLION, label="beta, continuous"),
        Line2D([], [], color=GREY, linestyle=(0, (3, 2)), label="beta, as printed"),
    ]
    panel.legend(handles=handles, fontsize=8, frameon=False, loc="lower center")
    return figure
