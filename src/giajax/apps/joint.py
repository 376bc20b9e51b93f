"""Figures and tables of one joint at rest, including figs 9 and 10 of the paper."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from ..mechanics.joint import (
    BRANCHES,
    LARGEST_ANGLE,
    Correction,
    Equilibria,
    Joint,
    JointPair,
    branch_angles,
    crushed_neck,
    equilibria,
    muscle_state,
    net_torque,
    pair_command,
)
from ..models import Scene, joint_scene
from ..report import (
    BLUE,
    DEGREE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    MINUS,
    VERMILLION,
    columns_of,
    draw_scene,
    new_figure,
    plain,
    to_csv,
    to_png,
)


def shade_branches(panel: Axes, joint: Joint) -> None:
    """Shade the range of angles about 0 in which the muscle is straight."""
    taut, wrapped = np.rad2deg(branch_angles(joint.geometry))
    end = np.rad2deg(LARGEST_ANGLE)
    lower, upper = np.nan_to_num(wrapped, nan=-end), np.nan_to_num(taut, nan=end)
    panel.axvspan(lower, upper, color=LIGHT, linewidth=0, zorder=0)


def angle_axis(panel: Axes, name: str) -> None:
    """Set the horizontal axis to the range of the joint angle."""
    end = np.rad2deg(LARGEST_ANGLE)
    panel.set_xlim(-end, end)
    panel.set_xticks(np.arange(-end, end + 1, 20))
    panel.set_xlabel(f"{name} ({DEGREE})")


def _of_both(
    step_deg: float, columns: Callable[[str, np.ndarray], dict[str, Any]]
) -> dict[str, np.ndarray]:
    """Return columns of the outer and of the inner muscle for all angles (deg); 0 occurs twice."""
    end = np.rad2deg(LARGEST_ANGLE)
    sizes = np.linspace(0, end, round(end / step_deg) + 1)
    outer, inner = columns("outer", -sizes[::-1]), columns("inner", sizes)
    return {name: np.concatenate([outer[name], inner[name]]) for name in outer}


def angle_table(joint: Joint, *, corrected: bool, step_deg: float = 0.5) -> dict[str, np.ndarray]:
    """Return all quantities of one muscle by its bending angle, as in figs 9 and 10.

    The corrections of the joint are included (fig. 10) or left out (fig. 9). The names of the
    columns end in their units. The angle 0 occurs twice, for the outer and for the inner muscle.
    """
    if not corrected:
        joint = Joint(joint.geometry, Correction(reading="none"), joint.torque)

    def columns(side: str, degrees: np.ndarray) -> dict[str, Any]:
        state = muscle_state(joint, np.deg2rad(degrees), side=side)
        return {
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
        }

    return _of_both(step_deg, columns)


_SMALL: Any = {"fontsize": 8, "frameon": False}


_ANGLE_CAPTION = (
    "Left: contraction of the muscle, epsilon in eq. (2). Right: force of the muscle that balances "
    "the torque. At positive bending angles the muscle is on the inner side of the joint (blue), "
    "at negative angles on the outer side (orange-red). In the light grey band the muscle is "
    "straight: its wire is slack, and it does not wrap around the balloons."
)
_CORRECTED = " Alpha (inner side) and beta (outer side) are added to the torque."


def angle_figure(joint: Joint, *, corrected: bool) -> Figure:
    """Plot contraction and force of one muscle versus its bending angle, as in figs 9 and 10.

    The corrections of the joint are included (fig. 10) or left out (fig. 9). The muscle is straight
    in the grey band.
    """
    table = angle_table(joint, corrected=corrected)
    what = "with the corrections alpha and beta" if corrected else "without corrections"
    title = f"One muscle at a torque of {float(joint.torque):g} N m, {what}"
    figure = new_figure(10, 3.9, title, _ANGLE_CAPTION + (_CORRECTED if corrected else ""))
    names = {"contraction": "contraction", "force_N": "force (N)"}
    for panel, (name, label) in zip(figure.subplots(1, 2), names.items(), strict=True):
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
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), **_SMALL)
    return figure


def correction_table(
    joint: Joint, *, reading: str, step_deg: float = 0.05
) -> dict[str, np.ndarray]:
    """Return alpha and beta of a joint by the bending angle of a muscle.

    `reading` selects the formula of beta, "continuous" or "printed". The names of the columns end
    in their units. The angle 0 occurs twice.
    """
    correction = dataclasses.replace(joint.correction, reading=reading)
    form = dataclasses.replace(joint, correction=correction)

    def columns(side: str, degrees: np.ndarray) -> dict[str, Any]:
        torque = muscle_state(form, np.deg2rad(degrees), side=side).torque
        return {
            "reading": np.full(len(degrees), reading),
            "side": np.full(len(degrees), side),
            "angle_deg": degrees + 0.0,
            "added_torque_N_m": np.asarray(torque) - float(joint.torque),
        }

    return _of_both(step_deg, columns)


_CORRECTION_CAPTION = (
    "Torque that is added to the torque of one muscle, versus the bending angle of the muscle. "
    "Alpha (blue) applies to the inner side, at positive angles. Beta applies to the outer side, "
    "at negative angles. It is computed with the absolute angle (orange-red) or, as printed, with "
    "the signed angle (dashed grey). On the dotted line the sum of both torques is 0. Below this "
    "line the force of the muscle would be negative."
)


def correction_figure(joint: Joint) -> Figure:
    """Plot alpha and beta of a joint in both readings of the paper, to show the erratum."""
    title = "Corrections: computed with |angle|, and as printed in the paper"
    figure = new_figure(8, 3.6, title, _CORRECTION_CAPTION)
    panel = figure.subplots()
    end, least = np.rad2deg(LARGEST_ANGLE), -float(joint.torque)
    for reading, colour, style in (("printed", GREY, (0, (3, 2))), ("continuous", VERMILLION, "-")):
        table = correction_table(joint, reading=reading)
        for side in ("outer", "inner"):
            rows = table["side"] == side
            ink = BLUE if side == "inner" and reading == "continuous" else colour
            curve = table["angle_deg"][rows], table["added_torque_N_m"][rows]
            panel.plot(*curve, color=ink, linestyle=style, linewidth=1.4)
    panel.axhline(least, color=INK, linewidth=0.8, linestyle=(0, (1, 2)))
    panel.text(end - 1, least, "below this line the muscle would have to push",
               fontsize=8, color=INK, ha="right", va="bottom")  # fmt: skip
    plain(panel, "added torque (N m)")
    angle_axis(panel, "bending angle of the muscle")
    handles = [
        Line2D([], [], color=BLUE, label="alpha"),
        Line2D([], [], color=VERMILLION, label="beta, continuous"),
        Line2D([], [], color=GREY, linestyle=(0, (3, 2)), label="beta, as printed"),
    ]
    panel.legend(handles=handles, loc="lower center", **_SMALL)
    return figure


_DRAWN = (60.0, 30.0, 10.0, 2.0, -2.0, -10.0, -30.0, -60.0)

_COLOURS = {"balloon": GREY, "muscle": BLUE, "wire": GREEN}
_WIDTHS = {"muscle": 2.0, "wire": 1.4}

# Letters that are drawn to the left of and below their points, so that they do not overlap.
_LEFT, _BELOW = frozenset("AMBP"), frozenset("EBD")

_LETTERS = (
    "E is the centre of the joint. B and D are the ends of the wire. Inner muscle: A and C are its "
    "ends, and H is the bush that the wire holds.\nOuter muscle: M and N are its ends, O is its "
    "middle, and P and Q are the points where it touches the balloons."
)


_JOINT_CAPTION = (
    "Each panel shows the joint at one bending angle, in the frame of the bisector of its links. "
    "Its title states the angle, the branch of the solution, and the contraction and force of the "
    "muscle. At positive angles the muscle is the inner one, at negative angles the outer one. The "
    "second muscle of the joint is not drawn. Dashed grey lines are the axes of the balloons. The "
    "letters are those of figs 7 and 8 of the paper and are explained below the panels."
)


def joint_figure(joint: Joint, degrees: Sequence[float] = _DRAWN) -> Figure:
    """Draw the joint at some bending angles (deg), to scale: links, muscle, wire and contacts.

    Only the muscle on the positive y side is drawn. It is the inner muscle at positive angles, and
    the outer one at negative angles.
    """
    columns = 2 if len(degrees) > 1 else 1
    rows = -(-len(degrees) // columns)
    title = "One muscle (blue) and its wire at rest, to scale"
    figure = new_figure(11, 2.35 * rows + 1.0, title, _JOINT_CAPTION)
    grid = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
    scene = joint_scene(joint.geometry, np.deg2rad(degrees))
    # Fill column by column, so that one column shows the inner and one the outer muscle.
    for index, panel in enumerate(grid.T.flat):
        if index < len(degrees):
            _draw_joint(panel, joint, scene, index, degrees[index])
        else:
            panel.set_visible(False)
    heights = np.sin(np.deg2rad(degrees) / 2)
    grid[0, 0].set_xlim(-1.02, 1.02)
    grid[0, 0].set_ylim(min(-0.22, heights.min() - 0.18), max(0.34, heights.max() + 0.3))
    for panel in grid[:, 0]:
        panel.set_ylabel("y (m)")
    for column in grid.T:
        lowest = [panel for panel in column if panel.get_visible()][-1]
        lowest.tick_params(labelbottom=True)
        lowest.set_xlabel("x (m)")
    figure.supxlabel(_LETTERS, fontsize=8, color=INK)
    handles = [
        Line2D([], [], color=BLUE, linewidth=2, label="muscle"),
        Line2D([], [], color=GREEN, linewidth=1.4, label="wire, taut"),
        Line2D([], [], color=GREEN, linewidth=1.4, linestyle=(0, (2, 2)), label="wire, slack"),
        Line2D([], [], color=GREY, linewidth=6, alpha=0.3, label="balloon"),
    ]
    figure.legend(handles=handles, loc="outside upper right", ncols=len(handles), **_SMALL)
    return figure


def joint_points(joint: Joint, angle: float) -> dict[str, np.ndarray]:
    """Return the lettered points of figs 7 and 8 at a bending angle of the muscle (rad), m.

    The points are in the frame of the bisector, each of shape (2,): A, B, C, D, E and H of an inner
    muscle, or M, P, O, Q, N, B, D and E of an outer muscle.
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
        left, below = name in _LEFT, name in _BELOW
        panel.annotate(
            name, (point[0], point[1]), (-3 if left else 3, -3 if below else 3),
            textcoords="offset points", fontsize=7.5, color=INK,
            ha="right" if left else "left", va="top" if below else "bottom",
        )  # fmt: skip
    state = muscle_state(joint, angle)
    force = f"{float(state.force):.2f}".replace("-", MINUS)
    shown = f"{degrees:g}".replace("-", MINUS)
    facts = f"{BRANCHES[int(state.branch)]}; contraction {float(state.contraction):.3f}, {force} N"
    plain(panel, f"{shown}{DEGREE}: {facts}")


_EQUILIBRIA = (
    "target_deg", "reached", "first_pressure_kPa", "second_pressure_kPa", "angle_deg",
    "stable", "stiffness_N_m_per_rad", "muscle_stiffness_N_m_per_rad", "at_step",
    "first_branch", "second_branch", "at_lower_stop", "at_upper_stop", "indifferent",
)  # fmt: skip


def equilibria_table(
    pair: JointPair, degrees: np.ndarray
) -> tuple[dict[str, np.ndarray], list[Equilibria]]:
    """Return the controller's pressures for some angles (deg), and all equilibria under them.

    The table has one row per equilibrium; its column names end in their units. The second result is
    the equilibria of each target angle. Angles whose pressures crush the neck are left out.
    """
    command = pair_command(pair, np.deg2rad(degrees))
    pressures = np.asarray(command.pressures)
    held = np.asarray([crushed_neck(pair, jnp.asarray(both)) is None for both in pressures])
    degrees, pressures = degrees[held], pressures[held]
    everything = [equilibria(pair, both) for both in pressures]
    rows: list[tuple[object, ...]] = []
    for target, reached, both, rests in zip(
        degrees, np.asarray(command.reached)[held], pressures, everything, strict=True
    ):
        rows += [
            (
                target, bool(reached), both[0] / 1e3, both[1] / 1e3, np.rad2deg(item.angle),
                item.stable, item.stiffness, item.muscle_stiffness, item.at_step, *item.branches,
                rests.at_lower_stop, rests.at_upper_stop, rests.indifferent,
            )
            for item in rests.every
        ]  # fmt: skip
    table = columns_of(_EQUILIBRIA, rows)
    return {name: np.asarray(values) for name, values in table.items()}, everything


# Style of unstable (False) and stable (True) equilibria.
_EQUILIBRIUM: dict[bool, dict[str, Any]] = {
    False: {"marker": "o", "linestyle": "none", "color": VERMILLION, "markerfacecolor": "white"},
    True: {"marker": "o", "linestyle": "none", "color": BLUE},
}

_EQUILIBRIA_CAPTION = (
    "Left: all stable (filled blue dots) and unstable (hollow orange-red dots) equilibrium angles "
    "under the two pressures that the controller computes for a target angle, versus this angle. "
    "On the light grey diagonal, the equilibrium is at the target. Right: net torque of the joint "
    "towards positive angles versus its angle, at the constant pressures for one target angle. Its "
    "zeros are the stable (filled blue dots) and unstable (hollow orange-red dots) equilibria. In "
    "the light grey bands, the first muscle of the joint is straight at the angle on the abscissa."
)


def equilibria_figure(pair: JointPair, table: dict[str, np.ndarray], example_deg: float) -> Figure:
    """Plot every equilibrium of a pair versus the target angle, and the torque for one target.

    The table comes from `equilibria_table`. The example is the target angle whose torque is drawn.
    """
    title = "Equilibria of a joint: the same two pressures allow several angles"
    figure = new_figure(11, 4.2, title, _EQUILIBRIA_CAPTION)
    left, right = figure.subplots(1, 2)
    shade_branches(left, pair.joint)
    target, angle, stable = table["target_deg"], table["angle_deg"], table["stable"]
    end = np.rad2deg(LARGEST_ANGLE)
    left.plot([-end, end], [-end, end], color=LIGHT, linewidth=3, zorder=1)
    for held, name in ((True, "stable"), (False, "unstable")):
        rows, style = stable == held, _EQUILIBRIUM[held]
        left.plot(target[rows], angle[rows], ms=2.5, mew=0.6, label=name, **style)
    plain(left, f"equilibrium angles for these two pressures ({DEGREE})")
    # At larger target angles the pressures crush the neck.
    most = float(np.max(np.abs(target), initial=0.0))
    beyond = f" (the neck is crushed beyond {most:g}{DEGREE})" if most < end - 1 else ""
    angle_axis(left, f"target angle{beyond}")
    left.set_ylim(-end, end)
    left.set_yticks(np.arange(-end, end + 1, 20))
    left.legend(loc="upper left", **_SMALL)
    shade_branches(right, pair.joint)
    pressures = pair_command(pair, np.deg2rad(example_deg)).pressures
    sizes = np.deg2rad(np.linspace(0, np.rad2deg(LARGEST_ANGLE), 601))
    load = jnp.asarray(0.0, dtype=pressures.dtype)
    for ahead in (False, True):
        bent = jnp.asarray(sizes if ahead else -sizes[::-1], dtype=pressures.dtype)
        side = jnp.full(bent.shape, ahead)
        torque = net_torque(pair, pressures, load, bent, side)
        right.plot(np.rad2deg(bent), torque, color=INK, linewidth=1.4)
    right.axhline(0, color=GREY, linewidth=0.8)
    for item in equilibria(pair, pressures).every:
        right.plot(np.rad2deg(item.angle), 0, markersize=6, **_EQUILIBRIUM[bool(item.stable)])
    kilopascals = " and ".join(f"{float(p) / 1e3:.1f}" for p in pressures)
    plain(right, f"torque at {kilopascals} kPa, target {example_deg:g}{DEGREE} (N m)")
    angle_axis(right, "angle")
    return figure


JOINT_FILES = (
    *("fig09.png", "fig09.csv", "fig10.png", "fig10.csv", "corrections.png", "corrections.csv"),
    *("joint.png", "points.csv", "equilibria.png", "equilibria.csv"),
)
"""Names of the files that `joint_files` makes."""


def joint_files(pair: JointPair, degrees: Sequence[float], target: float) -> dict[str, bytes]:
    """Return figures (PNG) and tables (CSV) of a joint, by the names of `JOINT_FILES`.

    The joint is drawn at the angles `degrees`. `target` is the target angle whose pressures are
    used for the torque curve, deg.
    """
    joint = pair.joint
    readings = [correction_table(joint, reading=name) for name in ("continuous", "printed")]
    corrections = {name: np.concatenate([each[name] for each in readings]) for name in readings[0]}
    # A joint bends from -60 to 60 deg: use steps of 1 deg.
    end = round(float(np.rad2deg(LARGEST_ANGLE)))
    holding, _ = equilibria_table(pair, np.linspace(-end, end, 2 * end + 1))
    points = [
        (angle, name, x, y)
        for angle in degrees
        for name, (x, y) in joint_points(joint, np.deg2rad(angle)).items()
    ]
    tables: dict[str, Any] = {
        "fig09.csv": angle_table(joint, corrected=False),
        "fig10.csv": angle_table(joint, corrected=True),
        "corrections.csv": corrections,
        "points.csv": columns_of(("angle_deg", "point", "x_m", "y_m"), points),
        "equilibria.csv": holding,
    }
    pictures = {
        "fig09.png": angle_figure(joint, corrected=False),
        "fig10.png": angle_figure(joint, corrected=True),
        "corrections.png": correction_figure(joint),
        "joint.png": joint_figure(joint, degrees),
        "equilibria.png": equilibria_figure(pair, holding, target),
    }
    made = {name: to_csv(table) for name, table in tables.items()}
    made |= {name: to_png(figure) for name, figure in pictures.items()}
    return {name: made[name] for name in JOINT_FILES}
