"""One joint at rest as files: pictures, and the numbers in them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..joint import LARGEST_ANGLE, JointPair
from ._csv import to_csv
from ._joint_angle import angle_figure, angle_table
from ._joint_correction import correction_figure, correction_table
from ._joint_equilibria import equilibria_figure, equilibria_table
from ._joint_shape import joint_figure, joint_points
from ._style import to_png

JOINT_FILES = (
    "fig09.png",
    "fig09.csv",
    "fig10.png",
    "fig10.csv",
    "corrections.png",
    "corrections.csv",
    "joint.png",
    "points.csv",
    "equilibria.png",
    "equilibria.csv",
)
"""What `joint_files` makes."""


def joint_files(pair: JointPair, degrees: Sequence[float], target: float) -> dict[str, bytes]:
    """Pictures (PNG) and numbers (CSV) of a joint, by the names of `JOINT_FILES`.

    Arguments:
        pair: joint and muscles.
        degrees: angles at which the joint is drawn, deg.
        target: angle whose two pressures are drawn, deg.

    Returns:
        Contents by name of the file.
    """
    joint = pair.joint
    readings = [correction_table(joint, reading=name) for name in ("continuous", "printed")]
    corrections = {name: np.concatenate([each[name] for each in readings]) for name in readings[0]}
    # A joint bends from -60 to 60 deg: in whole degrees.
    end = round(float(np.rad2deg(LARGEST_ANGLE)))
    holding, _ = equilibria_table(pair, np.linspace(-end, end, 2 * end + 1))
    points: dict[str, list[Any]] = {"angle_deg": [], "point": [], "x_m": [], "y_m": []}
    for angle in degrees:
        for name, (x, y) in joint_points(joint, np.deg2rad(angle)).items():
            for column, cell in zip(points.values(), (angle, name, x, y), strict=True):
                column.append(cell)
    return {
        "fig09.png": to_png(angle_figure(joint, corrected=False)),
        "fig09.csv": to_csv(angle_table(joint, corrected=False)),
        "fig10.png": to_png(angle_figure(joint, corrected=True)),
        "fig10.csv": to_csv(angle_table(joint, corrected=True)),
        "corrections.png": to_png(correction_figure(joint)),
        "corrections.csv": to_csv(corrections),
        "joint.png": to_png(joint_figure(joint, degrees)),
        "points.csv": to_csv(points),
        "equilibria.png": to_png(equilibria_figure(pair, holding, target)),
        "equilibria.csv": to_csv(holding),
    }
