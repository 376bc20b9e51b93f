"""Where two pressures hold a joint: every equilibrium, and the torque that makes them."""

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..joint import LARGEST_ANGLE, Equilibria, JointPair, equilibria, net_torque, pair_command
from ._joint_panels import angle_axis, shade_branches
from ._style import BLUE, DEGREE, GREY, INK, LIGHT, VERMILLION, new_figure, plain


def equilibria_table(
    pair: JointPair, degrees: np.ndarray
) -> tuple[dict[str, np.ndarray], list[Equilibria]]:
    """Pressures of the controller for some angles, and every equilibrium of each pair of them.

    Arguments:
        pair: joint and muscles.
        degrees: target angles, deg, shape (angle,).

    Returns:
        Columns, one row an equilibrium, in the units that their names say; and the equilibria of
        each target angle.
    """
    command = pair_command(pair, np.deg2rad(degrees))
    pressures = np.asarray(command.pressures)
    everything = [equilibria(pair, both) for both in pressures]
    rows: dict[str, list[object]] = {
        name: []
        for name in (
            "target_deg", "reached", "first_pressure_kPa", "second_pressure_kPa", "angle_deg",
            "stable", "stiffness_N_m_per_rad", "muscle_stiffness_N_m_per_rad", "at_step",
            "first_branch", "second_branch", "at_lower_stop", "at_upper_stop", "indifferent",
        )
    }  # fmt: skip
    for target, reached, both, rests in zip(
        degrees, np.asarray(command.reached), pressures, everything, strict=True
    ):
        for item in rests.every:
            cells: tuple[object, ...] = (
                target, bool(reached), both[0] / 1e3, both[1] / 1e3, np.rad2deg(item.angle),
                item.stable, item.stiffness, item.muscle_stiffness, item.at_step, *item.branches,
                rests.at_lower_stop, rests.at_upper_stop, rests.indifferent,
            )  # fmt: skip
            for column, cell in zip(rows.values(), cells, strict=True):
                column.append(cell)
    return {name: np.asarray(values) for name, values in rows.items()}, everything


def equilibria_figure(pair: JointPair, table: dict[str, np.ndarray], example_deg: float) -> Figure:
    """Where a pair rests: every equilibrium against the target angle, and the torque of one.

    Arguments:
        pair: joint and muscles.
        table: of `equilibria_table`.
        example_deg: target angle whose two pressures are drawn, deg.

    Returns:
        The picture.
    """
    figure = new_figure(11, 4.2, "Two pressures hold a joint at more than one angle")
    left, right = figure.subplots(1, 2)
    shade_branches(left, pair.joint)
    target, angle, stable = table["target_deg"], table["angle_deg"], table["stable"]
    end = np.rad2deg(LARGEST_ANGLE)
    left.plot([-end, end], [-end, end], color=LIGHT, linewidth=3, zorder=1)
    for held, colour, name in ((True, BLUE, "stable"), (False, VERMILLION, "unstable")):
        rows = stable == held
        left.plot(target[rows], angle[rows], ".", color=colour, markersize=4, label=name)
    plain(left, f"equilibria of its two pressures ({DEGREE})")
    angle_axis(left, "target angle")
    left.set_ylim(-end, end)
    left.set_yticks(np.arange(-end, end + 1, 20))
    left.legend(fontsize=8, frameon=False, loc="upper left")

    shade_branches(right, pair.joint)
    _draw_torque(right, pair, example_deg)
    return figure


def _draw_torque(panel: Axes, pair: JointPair, example_deg: float) -> None:
    pressures = pair_command(pair, np.deg2rad(example_deg)).pressures
    sizes = np.deg2rad(np.linspace(0, np.rad2deg(LARGEST_ANGLE), 601))
    load = jnp.asarray(0.0, dtype=pressures.dtype)
    for ahead in (False, True):
        angle = jnp.asarray(sizes if ahead else -sizes[::-1], dtype=pressures.dtype)
        side = jnp.full(angle.shape, ahead)
        torque = net_torque(pair, pressures, load, angle, side)
        panel.plot(np.rad2deg(angle), torque, color=INK, linewidth=1.4)
    panel.axhline(0, color=GREY, linewidth=0.8)
    for item in equilibria(pair, pressures).every:
        colour = BLUE if item.stable else VERMILLION
        panel.plot(np.rad2deg(item.angle), 0, "o", color=colour, markersize=6)
    kilopascals = " and ".join(f"{float(p) / 1e3:.1f}" for p in pressures)
    plain(panel, f"torque at {kilopascals} kPa, for {example_deg:g}{DEGREE} (N m)")
    angle_axis(panel, "angle")
