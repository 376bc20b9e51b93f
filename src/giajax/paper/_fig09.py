"""Figs 9 and 10: contraction and force of a muscle against the angle of its joint."""

from typing import Any

import numpy as np

from ..joint import Joint
from ..report import DEGREE, angle_figure, angle_table
from ._reproduced import Reproduced, Sources

# Where the text says something: at the ends, where balloons begin to touch, about 0.
ANGLES = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)

_ASSUMED = (
    "where muscle, wire and bush are fixed, and the lengths of wire (0.34 m) and muscle (1.96 m): "
    "the paper gives no coordinates."
)
_NOT_DRAWN = "nothing; the paper's measured points are not in its text, and none are drawn."


def fig09() -> Reproduced:
    """Fig. 9: the model without corrections."""
    sources = Sources(
        "eqs (2) to (11) with alpha = beta = 0, and the torque of 0.3 N m.", _ASSUMED, _NOT_DRAWN
    )
    return _reproduced("Fig. 9", sources, corrected=False)


def fig10() -> Reproduced:
    """Fig. 10: the model with alpha and beta."""
    sources = Sources(
        "eqs (2) to (11), the torque of 0.3 N m, alpha, and beta, which is read with "
        f"|theta|: as printed it jumps at 0{DEGREE} and 20{DEGREE}.",
        _ASSUMED,
        _NOT_DRAWN,
    )
    return _reproduced("Fig. 10", sources, corrected=True)


def _reproduced(name: str, sources: Sources, *, corrected: bool) -> Reproduced:
    joint = Joint()
    table = angle_table(joint, corrected=corrected)
    figure = angle_figure(joint, corrected=corrected)
    title = f"{name}: {figure.get_suptitle()[0].lower()}{figure.get_suptitle()[1:]}"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    rows: list[tuple[Any, ...]] = []
    for angle in ANGLES:
        row = int(np.argmin(np.abs(table["angle_deg"] - angle)))
        rows.append(
            (
                f"{angle:g}",
                str(table["side"][row]),
                round(float(table["contraction"][row]), 4),
                round(float(table["force_N"][row]), 3),
                str(table["branch"][row]),
            )
        )
    headings = ("angle, deg", "muscle", "contraction", "force, N", "branch")
    return Reproduced(title, sources, figure, headings, tuple(rows), table)
