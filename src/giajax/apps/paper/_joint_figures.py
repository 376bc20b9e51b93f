"""Figs 6, 9, 10 and 12 of the paper: one joint, its muscles and its hysteresis."""

from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from ...mechanics.arm import takeichi_20m
from ...mechanics.joint import Joint, JointPair, equilibria, joint_spring
from ...report import BLUE, DEGREE, GREEN, VERMILLION, new_figure, plain
from ...schema.parameters import replace
from ...simulation import Pressures, Signal, Trajectory, joint_ramps, logged, simulate
from ..experiments import figure_12, one_link, one_link_table
from ..joint import angle_figure, angle_table
from ._arm_figures import (
    DURATION,
    RATE,
    SHOWN_LINKS,
    STEP_AT,
    STEP_DEG,
    TOLERANCE,
    solid_and_dotted,
)
from ._contenders import Reproduced, Sources
from ._explanations import (
    PRESSURES,
    Explained,
    at_pressure,
    collapse_pressure,
    collapse_radius,
    explained,
    likelihood,
)

JOINTS = {1: VERMILLION, 3: BLUE, 5: GREEN}
STEP_FOR = 1.0

_FIG06_SOURCES = Sources(
    printed="the computation of two pressures from a commanded angle, and of the torque from these "
    "pressures (fig. 6 and eqs (2) to (11)), a co-contraction torque of 0.3 N m, alpha and beta, "
    "and the arm of table 2.",
    assumed=f"the joint's geometry, the law of the muscles, alpha and beta blended over 1{DEGREE} "
    f"about 0, springs of the pair's stiffness at {STEP_DEG:g}{DEGREE}, C_D = 1.2, damping 0.05 N "
    f"m s/rad, joint 1 commanded to {STEP_DEG:g}{DEGREE} within {STEP_FOR:g} s, and all other "
    "joints commanded to 0.",
    reconstructed="nothing.",
)


def motions() -> tuple[Trajectory, Trajectory, JointPair]:
    """Return the motions of the arm with muscles and of the arm with springs, and the muscle pair.

    The first arm is driven by the pressures of the controller, the second by the commanded angles.
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
    near: Any = {"rtol": TOLERANCE, "atol": TOLERANCE}
    by_pressures = simulate(arm, still, times, pressure=supplied, **near)
    return by_pressures, simulate(sprung, command, times, **near), pair


def fig06() -> Reproduced:
    """Fig. 6: the arm driven by pressures, the arm with springs, and the stable joint angles."""
    driven, sprung, pair = motions()
    by_pressure, by_spring = np.rad2deg(driven.angles), np.rad2deg(sprung.angles)
    supplied = np.asarray(driven.pressures)
    rows = []
    for joint in (1, 3, 5, 19):
        rests = equilibria(pair, supplied[-1, :, joint - 1]).stable
        allowed = ", ".join(f"{np.rad2deg(rest.angle):.1f}" for rest in rests)
        command = STEP_DEG if joint == 1 else 0.0
        at = joint - 1
        rows.append((joint, command, allowed, by_pressure[-1, at], by_spring[-1, at]))
    columns = {"time_s": np.asarray(driven.times)}
    for row, name in enumerate(("first", "second")):
        columns[f"joint01_pressure_{name}_kPa"] = supplied[:, row, 0] / 1e3
    for joint in JOINTS:
        columns[f"joint{joint:02d}_angle_by_pressures_deg"] = by_pressure[:, joint - 1]
        columns[f"joint{joint:02d}_angle_by_springs_deg"] = by_spring[:, joint - 1]
    for link in SHOWN_LINKS:
        columns[f"link{link:02d}_z_by_pressures_m"] = _heights(driven)[:, link - 1]
        columns[f"link{link:02d}_z_by_springs_m"] = _heights(sprung)[:, link - 1]
    return Reproduced(
        "The arm driven by muscle pressures, and the same arm with springs",
        _FIG06_SOURCES,
        _drawn(driven, sprung),
        ("joint", "commanded, deg", "stable angles, deg", "with muscles, deg", "with springs, deg"),
        tuple(rows),
        columns,
    )


def _heights(motion: Trajectory) -> np.ndarray:
    return np.asarray(motion.link_centres[..., 2])


_FIG06_CAPTION = (
    f"Joint 1 is commanded from 0 to {STEP_DEG:g}{DEGREE} within {STEP_FOR:g} s, starting at "
    f"{STEP_AT:g} s, and all other joints to 0. Top: gauge pressures in the first (orange-red) and "
    "second muscle (dashed blue) of joint 1. Middle: angles of joint 1 (orange-red circles), joint "
    "3 (blue squares) and joint 5 (green triangles). Bottom: heights z of the centres of link 6 "
    "(green circles), link 12 (blue squares) and link 20 (orange-red triangles). Markers are at "
    "some of the samples. Dotted lines are the same arm with linear springs, which have the "
    f"stiffness of the muscle pair at {STEP_DEG:g}{DEGREE}."
)


def _drawn(driven: Trajectory, sprung: Trajectory) -> Figure:
    title = "Fig. 6: joints driven by muscle pressures (solid) and joints with springs (dotted)"
    figure = new_figure(8, 8.2, title, _FIG06_CAPTION)
    panels = figure.subplots(3, 1, sharex=True, height_ratios=[1, 1.6, 1.6])
    times = np.asarray(driven.times)
    supplied = np.asarray(driven.pressures)[:, :, 0] / 1e3
    panels[0].plot(times, supplied[:, 0], color=VERMILLION, label="first muscle")
    panels[0].plot(times, supplied[:, 1], "--", color=BLUE, label="second muscle")
    both = (driven, sprung)
    angles, heights = [np.rad2deg(each.angles) for each in both], [_heights(each) for each in both]
    solid_and_dotted(panels[1], times, angles, JOINTS, "joint")
    solid_and_dotted(panels[2], times, heights, SHOWN_LINKS, "link")
    panels[2].set_xlim(times[0], times[-1])
    labels = ("pressure in joint 1 (kPa)", f"angle ({DEGREE})", "z of the link's centre (m)")
    for panel, label in zip(panels, labels, strict=True):
        plain(panel, "", "time (s)" if panel is panels[2] else "", label)
        panel.legend(fontsize=8, frameon=False, ncols=3)
    return figure


# Angles that the text discusses: the ends, the onset of balloon contact, and angles near 0.
ANGLES = (-60.0, -40.0, -20.0, 20.0, 40.0, 60.0)

_ASSUMED = (
    "the points where muscle, wire and bush are fixed, and the lengths of wire (0.34 m) and muscle "
    "(1.96 m): the paper gives no coordinates."
)
_NOT_DRAWN = "nothing. The paper gives its measured points only in a figure, so they are not drawn."


_PRINTED = {
    9: "eqs (2) to (11) with alpha = beta = 0, and the torque of 0.3 N m.",
    10: "eqs (2) to (11), the torque of 0.3 N m, alpha, and beta, which is evaluated with "
    f"|theta|: as printed, beta is discontinuous at 0{DEGREE} and 20{DEGREE}.",
}


def fig09_or_10(number: int) -> Reproduced:
    """Fig. 9 (the model without corrections) or fig. 10 (with alpha and beta)."""
    corrected = number == 10
    table = angle_table(Joint(), corrected=corrected)
    figure = angle_figure(Joint(), corrected=corrected)
    title = f"Fig. {number}: {figure.get_suptitle()[0].lower()}{figure.get_suptitle()[1:]}"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    rows: list[tuple[Any, ...]] = []
    for angle in ANGLES:
        row = int(np.argmin(np.abs(table["angle_deg"] - angle)))
        side, branch = str(table["side"][row]), str(table["branch"][row])
        contraction, force = float(table["contraction"][row]), float(table["force_N"][row])
        rows.append((f"{angle:g}", side, round(contraction, 4), round(force, 3), branch))
    headings = ("angle, deg", "muscle", "contraction", "force, N", "branch")
    sources = Sources(_PRINTED[number], _ASSUMED, _NOT_DRAWN)
    return Reproduced(title, sources, figure, headings, tuple(rows), table)


_FIG12_SOURCES = Sources(
    printed=f"the history (60, -60, 0{DEGREE} twice, 1{DEGREE} every 5 or 20 s), eq. (12), the "
    "offsets that minimise the mean error, and the errors in the table.",
    assumed=f"the travel over which xi changes from 0 to 1 (40{DEGREE}). For the explanations, "
    "also the geometry, the muscles, and the film and gas (1 kPa) of the neck.",
    reconstructed="the link: a simulated joint that snaps through 0 and is hysteretic. The inverse "
    "operator and the second history were added by giajax.",
)


def fig12(progress: Callable[[str], None] | None = None) -> Reproduced:
    """Fig. 12, with the errors that the text gives and their possible explanations."""
    study = one_link(progress=progress)
    # For each compensation: largest error, mean error, and its ratio to the uncompensated mean
    # error.
    said = {
        "none": ("without", "about 30", "about 11", "1"),
        "branches": ("eq. (12)", "almost the same", "-", "less than 0.5"),
        "inverse": ("inverse operator", "-", "-", "-"),
    }
    without, rows = study.trial("paper", "none"), []
    for name, (label, largest, mean, share) in said.items():
        trial = study.trial("paper", name)
        here = trial.mean / without.mean
        shown = (largest, trial.largest, mean, trial.mean, share, here, "-", "-", "-")
        rows.append((label, *shown))
    (progress or (lambda text: None))("fitting the explanations to the loop")
    measured = without.history.measured
    found = explained(without.angles[measured])
    rows += _explanation_rows(found, without.angles[measured])
    headings = (
        *("compensation or explanation", "largest error in the paper, deg", "here"),
        *(
            "mean error in the paper, deg",
            "here",
            "relative to no compensation, in the paper",
            "here",
        ),
        *(
            "angle at a command of 13 deg, deg (paper: about 30)",
            "chi-square of the text",
            "log-likelihood of the loop",
        ),
    )
    figure = figure_12(study)
    title = "Fig. 12: measured versus target angles of one link (a simulated joint)"
    figure.suptitle(title, fontsize=10, x=0.01, ha="left")
    columns = one_link_table(study)
    facts = {"explanations": _explanation_facts(found)}
    return Reproduced(title, _FIG12_SOURCES, figure, headings, tuple(rows), columns, facts)


def _explanation_rows(
    found: Mapping[str, tuple[Explained, Explained]], loop: np.ndarray
) -> list[tuple[Any, ...]]:
    """Return the best fit of each explanation to the text, and its loop at three pressures."""

    def row(label: str, one: Explained, *judged: Any) -> tuple[Any, ...]:
        said = {name: round(value, 1) for name, value in one.said.items()}
        errors = ("about 30", said["largest"], "about 11", said["mean"], "-", "-", said["at 13"])
        return (label, *errors, *judged)

    most = max(likelihood(liked.angles, loop) for _, liked in found.values())
    rows = []
    for name, (nearest, liked) in found.items():
        less = likelihood(liked.angles, loop) - most
        rows.append(row(f"{name}: {nearest.needs}", nearest, nearest.misfit, less))
    for name, (nearest, _) in found.items():
        for pressure in PRESSURES:
            label = f"{name}, with {pressure / 1e3:g} kPa"
            rows.append(row(label, at_pressure(nearest, pressure), "-", "-"))
    return rows


# Radius of a link of the arm, m, and the torque, N m, and compression, N, due to one muscle.
_LINK_RADIUS, _TORQUE, _PRESSED = 0.15, 0.3, (2.0, 4.0)


def _explanation_facts(found: Mapping[str, tuple[Explained, Explained]]) -> dict[str, Any]:
    """Return the parameters of each explanation and the collapse limits for one muscle."""
    pressures = [collapse_pressure(_LINK_RADIUS, _TORQUE, force) for force in _PRESSED]
    radii = [collapse_radius(1e3, _TORQUE, force) for force in _PRESSED]
    needs = {
        name: {"of the text": nearest.needs, "of the loop": liked.needs}
        for name, (nearest, liked) in found.items()
    }
    return {
        "needed": needs,
        "collapse_of_a_link_of_150_mm_radius_Pa": pressures,
        "collapse_at_1_kPa_radius_m": radii,
    }
