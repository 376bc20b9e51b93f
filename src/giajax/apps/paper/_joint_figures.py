"""Figs 6, 9, 10 and 12 of the paper: one joint, its muscles and its hysteresis."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...mechanics.arm import takeichi_20m
from ...mechanics.joint import Joint, JointPair, equilibria, joint_spring
from ...report import BLUE, DEGREE, GREEN, VERMILLION, new_figure, plain
from ...schema.parameters import replace
from ...simulation import Pressures, Signal, Trajectory, joint_ramps, logged, simulate
from ..experiments import figure_12, one_link, one_link_table
from ..joint import angle_figure, angle_table
from ._contenders import Reproduced, Sources

# Fig. 6: the controller of a joint, in the whole arm: pressures against springs.

LINKS = {6: GREEN, 12: BLUE, 20: VERMILLION}
JOINTS = {1: VERMILLION, 3: BLUE, 5: GREEN}
STEP_DEG, STEP_AT, STEP_FOR = 30.0, 0.5, 1.0
DURATION, RATE = 25.0, 20.0
TOLERANCE = 1e-8

_FIG06_SOURCES = Sources(
    printed="the way from a commanded angle to two pressures, and from these to a torque (fig. 6 "
    "and eqs (2) to (11)), 0.3 N m of co-contraction, alpha and beta, the arm of table 2.",
    assumed=f"the joint's geometry, the muscles' law, alpha and beta blended over 1{DEGREE} "
    f"about 0, springs of the pair's stiffness at {STEP_DEG:g}{DEGREE}, C_D = 1.2, damping 0.05 N "
    f"m s/rad, joint 1 sent to {STEP_DEG:g}{DEGREE} within {STEP_FOR:g} s and all others to 0.",
    reconstructed="nothing.",
)


@dataclasses.dataclass(frozen=True)
class Motions:
    """The arm whose pitch joints have muscles, driven by pressures, and that with springs.

    Attributes:
        pressures: driven by the pressures of the controller.
        springs: driven by the angles that the controller was told.
        pair: of each joint with muscles.
    """

    pressures: Trajectory
    springs: Trajectory
    pair: JointPair


def motions(tolerance: float = TOLERANCE) -> Motions:
    """Both motions after the base joint is sent to an angle.

    Arguments:
        tolerance: relative and absolute tolerance of the integrator.
    """
    arm = takeichi_20m(muscles="pitch")
    assert arm.pneumatics is not None
    pair, target = arm.pneumatics.pair, np.deg2rad(STEP_DEG)
    command = joint_ramps(arm.count, {1: target}, start=STEP_AT, duration=STEP_FOR)
    times = np.linspace(0.0, DURATION, round(DURATION * RATE) + 1)
    pressures = [arm.pneumatics.commanded(command(jnp.asarray(time))).ravel() for time in times]
    supplied = Pressures(logged(times, np.asarray(pressures)), arm.pneumatics.joints)
    at_target = jnp.asarray(arm.pneumatics.commanded(command(jnp.asarray(DURATION)))[:, 0])
    stiffness = float(joint_spring(pair, at_target, target).stiffness)
    sprung = replace(takeichi_20m(), {"joints.pitch_stiffness": stiffness})
    still: Signal = joint_ramps(arm.count, {})
    return Motions(
        simulate(arm, still, times, pressure=supplied, rtol=tolerance, atol=tolerance),
        simulate(sprung, command, times, rtol=tolerance, atol=tolerance),
        pair,
    )


def fig06() -> Reproduced:
    """The arm by pressures beside the arm with springs, and where its joints may rest."""
    both = motions()
    by_pressure, by_spring = np.rad2deg(both.pressures.angles), np.rad2deg(both.springs.angles)
    supplied = np.asarray(both.pressures.pressures)
    rows = []
    for joint in (1, 3, 5, 19):
        rests = equilibria(both.pair, supplied[-1, :, joint - 1]).stable
        allowed = ", ".join(f"{np.rad2deg(rest.angle):.1f}" for rest in rests)
        command = STEP_DEG if joint == 1 else 0.0
        at = joint - 1
        rows.append((joint, command, allowed, by_pressure[-1, at], by_spring[-1, at]))
    columns = {"time_s": np.asarray(both.pressures.times)}
    for row, name in enumerate(("first", "second")):
        columns[f"joint01_pressure_{name}_kPa"] = supplied[:, row, 0] / 1e3
    for joint in JOINTS:
        columns[f"joint{joint:02d}_angle_by_pressures_deg"] = by_pressure[:, joint - 1]
        columns[f"joint{joint:02d}_angle_by_springs_deg"] = by_spring[:, joint - 1]
    for link in LINKS:
        columns[f"link{link:02d}_z_by_pressures_m"] = _heights(both.pressures)[:, link - 1]
        columns[f"link{link:02d}_z_by_springs_m"] = _heights(both.springs)[:, link - 1]
    return Reproduced(
        "The arm by the pressures of its muscles, and with springs",
        _FIG06_SOURCES,
        _drawn(both),
        ("joint", "commanded, deg", "stable at, deg", "by pressures, deg", "by springs, deg"),
        tuple(rows),
        columns,
    )


def _heights(motion: Trajectory) -> np.ndarray:
    return np.asarray(motion.link_centres[..., 2])


def _drawn(both: Motions) -> Figure:
    figure = new_figure(8, 8.2, "Fig. 6: muscles by pressures (solid), springs (dotted)")
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1, 1.6, 1.6])
    times = np.asarray(both.pressures.times)
    supplied = np.asarray(both.pressures.pressures)[:, :, 0] / 1e3
    panels[0].plot(times, supplied[:, 0], color=VERMILLION, label="first muscle")
    panels[0].plot(times, supplied[:, 1], color=BLUE, label="second muscle")
    panels[0].set_ylabel("pressure in joint 1 (kPa)")
    angles = [np.rad2deg(motion.angles) for motion in (both.pressures, both.springs)]
    _curves(panels[1], times, angles, JOINTS, "joint")
    panels[1].set_ylabel(f"angle ({DEGREE})")
    _curves(panels[2], times, [_heights(m) for m in (both.pressures, both.springs)], LINKS, "link")
    panels[2].set_ylabel("z of the link's centre (m)")
    panels[2].set_xlabel("time (s)")
    panels[2].set_xlim(times[0], times[-1])
    for panel in panels:
        plain(panel)
        panel.legend(fontsize=8, frameon=False, ncols=3)
    return figure


def _curves(
    panel: Axes, times: np.ndarray, both: list[np.ndarray], colours: dict[int, str], what: str
) -> None:
    """Solid curves by pressures and dotted ones with springs."""
    for number, colour in colours.items():
        solid, dotted = (values[:, number - 1] for values in both)
        panel.plot(times, solid, color=colour, linewidth=1.6, label=f"{what} {number}")
        panel.plot(times, dotted, color=colour, linewidth=1.2, linestyle=(0, (1, 1.5)))


# Figs 9 and 10: contraction and force of a muscle against the angle of its joint.

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


# Fig. 12: measured against command values of one link, without and with compensation.

_FIG12_SOURCES = Sources(
    printed=f"the history (60, -60, 0{DEGREE} twice, 1{DEGREE} every 5 or 20 s), eq. (12), the "
    "offsets that make the mean error least, and the errors in the table.",
    assumed=f"over how much travel xi goes from 0 to 1: 40{DEGREE}.",
    reconstructed="the link: a simulated joint that snaps through 0 and is hysteretic. The inverse "
    "operator and the second history are giajax's.",
)


def fig12(progress: Callable[[str], None] | None = None) -> Reproduced:
    """Fig. 12, and the errors that the text gives.

    Arguments:
        progress: called with what is being done.
    """
    study = one_link(progress=progress)
    none, branches, inverse = (
        study.trial("paper", name) for name in ("none", "branches", "inverse")
    )
    rows = (
        ("without", "about 30", none.largest, "about 11", none.mean, "1", 1.0),
        (
            "eq. (12)",
            "almost the same",
            branches.largest,
            "-",
            branches.mean,
            "less than 0.5",
            branches.mean / none.mean,
        ),
        (
            "inverse operator",
            "-",
            inverse.largest,
            "-",
            inverse.mean,
            "-",
            inverse.mean / none.mean,
        ),
    )
    headings = (
        "compensation",
        "largest error in the paper, deg",
        "here",
        "mean error in the paper, deg",
        "here",
        "of that without, in the paper",
        "here",
    )
    figure = figure_12(study)
    title = "Fig. 12: one link, measured against target angles (a simulated joint)"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    return Reproduced(title, _FIG12_SOURCES, figure, headings, rows, one_link_table(study))
