"""Table, JSON data and figure of a plan."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ...models import arm_scene
from ...report import BLUE, GREY, VERMILLION, draw_blocks, draw_scene, new_figure, plain
from ...simulation import at_rest
from ._plan import Plan, Planned

PLAN_HEADINGS = (
    "command",
    "command ends, s",
    "tip at rest, s",
    "off target, % of travel",
    "residual, % of travel",
    "residual, stiffness -25 %",
    "residual, stiffness +25 %",
    "residual, 95 % of draws",
    "clearance, m",
)


def plan_rows(found: Plan) -> list[tuple[Any, ...]]:
    """Return a row for the direct and one for the planned command, with columns `PLAN_HEADINGS`.

    A value is None if it does not exist.
    """
    return [
        (
            row.name,
            float(row.command.times[-1]),
            row.settled,
            *(
                None if size is None else 100 * size / found.travel
                for size in (row.missed, row.residual, row.soft, row.stiff)
            ),
            100 * float(np.percentile(row.drawn, 95)) / found.travel if _banded(row) else None,
            row.clearance,
        )
        for row in (found.direct, found.planned)
    ]


def plan_facts(found: Plan) -> dict[str, Any]:
    """Return the result of a plan as plain data."""
    limits = found.limits
    return {
        "goal_m": found.goal.tolist(),
        "travel_m": found.travel,
        "within": found.within,
        "slowest_period_s": found.period,
        "steps": found.steps,
        "limits": {
            "angle_deg": float(np.rad2deg(limits.angle)),
            "rate_deg_per_s": float(np.rad2deg(limits.rate)),
            "clearance_m": limits.clearance,
            "pressure_Pa": limits.pressure,
        },
        "commands": [
            {
                "name": row.name,
                "ends_s": float(row.command.times[-1]),
                "settled_s": row.settled,
                "residual_m": row.residual,
                "missed_m": row.missed,
                "residual_soft_m": _finite(row.soft),
                "residual_stiff_m": _finite(row.stiff),
                "residual_drawn_m": row.drawn.tolist(),
                "clearance_m": row.clearance,
                "closest_m": None if row.closest is None else _finite(row.closest),
            }
            for row in (found.direct, found.planned)
        ],
        "notes": list(found.notes),
    }


def _finite(size: float | None) -> float | None:
    return size if size is not None and np.isfinite(size) else None


def _banded(row: Planned) -> bool:
    """Return whether there are enough draws for a spread."""
    return len(row.drawn) > 1


def path_columns(found: Plan) -> dict[str, np.ndarray]:
    """Return the predicted path of the tip under the planned command, with a 95 % band of draws.

    Column names end in their unit.
    """
    row = found.planned
    columns: dict[str, np.ndarray] = {"time_s": row.times}
    for k, axis in enumerate("xyz"):
        columns[f"tip_{axis}_m"] = row.tips[:, k]
        if _banded(row):
            low, high = np.percentile(row.drawn_tips[:, :, k], (2.5, 97.5), axis=0)
            columns |= {f"tip_{axis}_low_m": low, f"tip_{axis}_high_m": high}
    return columns


_SHAPES = 6  # Number of drawn shapes of the arm.


def _caption(found: Plan) -> str:
    blocks = "" if found.planned.clearance is None else " Light grey: obstacles."
    bands = (
        " Bands: central 95 % of distances for parameters drawn from the uncertainty of the fit."
        if _banded(found.direct) or _banded(found.planned)
        else ""
    )
    return (
        f"Left: the arm at {_SHAPES} equally spaced times of the planned command, from "
        f"yellow-green (start) to violet (end). Grey line: path of the tip. Cross: target.{blocks} "
        "Top right: commands of the moving joints, from violet (base) to yellow-green (tip). "
        "Bottom right: distance of the tip from the target under the planned command (blue) and "
        "under the direct motion at the largest rate (dashed grey). Dots: ends of the commands. "
        f"Dotted line: {100 * found.within:.3g} % of the initial distance.{bands}"
    )


def plan_figure(found: Plan, title: str = "") -> Figure:
    """Plot shapes of the arm during the motion, the commands, and the distance from the target."""
    figure = new_figure(11, 6.4, title or "A planned command", _caption(found))
    grid = figure.add_gridspec(2, 2)
    across = np.ptp(found.planned.tips, axis=0)
    _shapes(figure.add_subplot(grid[:, 0]), found, "xz" if across[2] >= across[1] else "xy")
    above = figure.add_subplot(grid[0, 1])
    below = figure.add_subplot(grid[1, 1], sharex=above)
    row = found.planned
    used = np.flatnonzero(np.ptp(row.command.angles, axis=0) > 1e-6)
    for joint in used:
        colour = colormaps["viridis"](0.9 * joint / max(found.model.arm.count - 1, 1))
        label = f"joint {joint + 1}" if joint in (used[0], used[-1]) else None
        angles = np.degrees(row.command.at(row.times)[:, joint])
        above.plot(row.times, angles, color=colour, lw=0.9, label=label)
    plain(above, "", "", "planned command (deg)")
    above.legend(fontsize=8, frameon=False)
    _distance(below, found, found.direct, GREY, "--")
    _distance(below, found, row, BLUE, "-")
    below.axhline(found.within * found.travel, color=GREY, lw=0.8, ls=":")
    plain(below, "", "time (s)", "distance of the tip\nfrom the target (m)")
    below.set_ylim(0, None)
    below.set_xlim(0, _shown(found))
    below.legend(fontsize=8, frameon=False)
    return figure


def _shown(found: Plan) -> float:
    """Return the end of the time axis, s."""
    settled = (found.direct.settled, found.planned.settled)
    ends = [float(found.planned.times[-1]) if each is None else each for each in settled]
    return min(float(found.planned.times[-1]), 1.3 * max(ends))


def _distance(panel: Axes, found: Plan, row: Planned, colour: str, dashes: str) -> None:
    def off(tips: np.ndarray) -> np.ndarray:
        return np.asarray(np.linalg.norm(tips - found.goal, axis=-1))

    if _banded(row):
        low, high = np.percentile(off(row.drawn_tips), (2.5, 97.5), axis=0)
        panel.fill_between(row.times, low, high, color=colour, alpha=0.2, lw=0)
    panel.plot(row.times, off(row.tips), dashes, color=colour, label=row.name)
    panel.plot(row.command.times[-1], off(row.tips)[_end(row)], "o", color=colour, ms=5)


def _end(row: Planned) -> int:
    return int(np.searchsorted(row.times, row.command.times[-1] - 1e-9))


def _shapes(panel: Axes, found: Plan, axes: str) -> None:
    arm, row = found.model.arm, found.planned
    seen = ["xyz".index(name) for name in axes]
    until = _end(row)
    scenes = [
        arm_scene(at_rest(arm, jnp.asarray(row.angles[sample])))
        for sample in np.linspace(0, until, _SHAPES).astype(int)
    ]
    for place, scene in enumerate(scenes):
        colour = to_hex(colormaps["viridis"](0.9 * (1 - place / (_SHAPES - 1))))
        draw_scene(panel, scene, 0, axes=axes, colours={"link": colour, "marker": colour})
    panel.plot(*row.tips[:, seen].T, color=GREY, lw=0.8, label="tip")
    panel.plot(*found.goal[seen], "x", color=VERMILLION, ms=8, label="target")
    points = [line.points[0][:, seen] for scene in scenes for line in scene.lines]
    every = np.concatenate([*points, row.tips[:, seen]])
    low, high = np.min(every, axis=0) - 1, np.max(every, axis=0) + 1
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
    draw_blocks(panel, scenes[0].blocks, axes=axes)
    names = "From the side" if axes == "xz" else "From above"
    plain(panel, names, f"{axes[0]} (m)", f"{axes[1]} (m)")
    panel.set_aspect("equal")
    panel.legend(fontsize=8, frameon=False)
