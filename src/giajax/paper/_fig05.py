"""Fig. 5: displacements of links 6, 12 and 20 in the models with and without air resistance."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure

from ..arm import takeichi_20m
from ..parameters import replace
from ..report import BLUE, DEGREE, GREEN, VERMILLION, new_figure, plain
from ..simulation import joint_steps, simulate
from ._reproduced import Reproduced, Sources

LINKS = {6: GREEN, 12: BLUE, 20: VERMILLION}
STEP_DEG, STEP_AT = 30.0, 0.5
DURATION, RATE = 25.0, 20.0

# When the table looks, s.
AT = (5, 10, 25)

# Of the integrator: each curve is then right to 1e-7 m.
TOLERANCE = 1e-8

SOURCES = Sources(
    printed="the model (20 rigid links, springs, eq. (1) at their centres), length, diameter and "
    "mass (table 2), the three links, solid with and dotted without air.",
    assumed=f"stiffness 3 (pitch) and 30 N m/rad (yaw), damping 0.05 N m s/rad, C_D = 1.2, a step "
    f"of {STEP_DEG:g}{DEGREE} at {STEP_AT:g} s: the text gives none of them.",
    reconstructed="nothing.",
)


def heights(tolerance: float = TOLERANCE) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Heights of the links' centres after a step of joint 1.

    Arguments:
        tolerance: relative and absolute tolerance of the integrator.

    Returns:
        Times, s, shape (sample,), and the height z of all links, m, shape (sample, link), "with"
        and "without" air.
    """
    arm = takeichi_20m()
    arms = {"with": arm, "without": replace(arm, {"air.drag_coefficient": 0.0})}
    command = joint_steps(arm.count, {1: np.deg2rad(STEP_DEG)}, time=STEP_AT)
    times = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    motions = {
        air: simulate(each, command, times, rtol=tolerance, atol=tolerance)
        for air, each in arms.items()
    }
    return times, {air: np.asarray(motion.link_centres[..., 2]) for air, motion in motions.items()}


def fig05() -> Reproduced:
    """Fig. 5, and by how much air changes each curve."""
    times, z = heights()
    headings = ("link", *(f"z at {at} s {air} air, m" for at in AT for air in z))
    rows = []
    columns = {"time_s": times}
    for link in LINKS:
        curves = {air: z[air][:, link - 1] for air in z}
        at = [round(seconds * RATE) for seconds in AT]
        rows.append((link, *(float(curve[row]) for row in at for curve in curves.values())))
        columns |= {f"link{link:02d}_z_{air}_air_m": curves[air] for air in curves}
    return Reproduced(
        "Heights of links 6, 12 and 20 after a step of the base joint",
        SOURCES,
        _drawn(times, z),
        headings,
        tuple(rows),
        columns,
    )


def _drawn(times: np.ndarray, z: Mapping[str, np.ndarray]) -> Figure:
    figure = new_figure(8, 4.8, "Fig. 5: links 6, 12 and 20 with (solid) and without (dotted) air")
    axes = figure.subplots()
    for link, colour in LINKS.items():
        axes.plot(times, z["with"][:, link - 1], color=colour, linewidth=1.6, label=f"link {link}")
        axes.plot(
            times, z["without"][:, link - 1], color=colour, linewidth=1.2, linestyle=(0, (1, 1.5))
        )
    plain(axes)
    axes.set_xlim(times[0], times[-1])
    axes.set_xlabel("time (s)")
    axes.set_ylabel("z of the link's centre (m)")
    axes.legend(fontsize=8, frameon=False, ncols=3, loc="upper left")
    return figure
