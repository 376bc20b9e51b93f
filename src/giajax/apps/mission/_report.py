"""Figures and files of a mission, of many missions, and of a certificate."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

from ...models import arm_scene
from ...report import (
    BLUE,
    DEGREE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    VERMILLION,
    draw_blocks,
    draw_scene,
    new_figure,
    plain,
    to_csv,
    to_png,
)
from ...runtime.records import plain_data
from ...simulation import at_rest
from ._cases import Case, Cases
from ._certificate import Certificate
from ._mission import Mission, Outcome

MISSION_FILES = ("mission.json", "mission.png")

_GROUND = 500.0  # size above which a block counts as ground, larger than a building, m
_SHAPES = 6  # number of shapes of the arm in a figure, including the first and the last
_LIGHTEST = 0.75  # end of the used part of the colour map: yellow is hard to see on white
_BENT_MOST = ((BLUE, "-"), (VERMILLION, "--"), (GREEN, "-."), (INK, ":"))


def mission_files(mission: Mission, outcome: Outcome) -> dict[str, bytes]:
    """Return the results and a figure of a mission, by the names of `MISSION_FILES`."""
    return {
        "mission.json": f"{mission_json(mission, outcome)}\n".encode(),
        "mission.png": to_png(mission_figure(mission, outcome)),
    }


def mission_json(mission: Mission, outcome: Outcome) -> str:
    """Return the results of a mission as JSON text."""
    facts = {
        "reached_s": None if outcome.reached is None else round(outcome.reached, 6),
        "reason": outcome.reason or None,
        "ended_s": round(float(outcome.times[-1]), 6),
        "nearest_m": outcome.nearest,
        "controller": mission.driver,
        "keeps_station": not mission.enters,
        "swing_m": None if mission.enters else outcome.swing,
        "touched": [
            {
                "obstacle": each.obstacle,
                "links": list(each.links),
                "duration_s": round(each.duration, 6),
                "flattening_m": each.flattening,
                "force_N": each.force,
                "impulse_N_s": each.impulse,
            }
            for each in outcome.touched
        ],
        "mission": mission.section.contents(),
    }
    return json.dumps(plain_data(facts), indent=2)


_MISSION_CAPTION = (
    "Left: the arm at up to six equally spaced times, light at the start and dark at the end, with "
    "the path of the tip (dotted), obstacles (grey) and the opening (orange-red). Upper right: "
    "distance of the tip from the outer plane of the opening (blue circles) and from its axis "
    "(orange-red squares). Dotted lines are estimates of the controller. The dashed line is the "
    "depth from which the tip counts as inside. In grey intervals the camera sees at least two "
    "corners of the opening. Lower right: commanded joint angles. The four angles "
    "with the largest ranges are labelled, and the others are thin and grey."
)


def mission_figure(mission: Mission, outcome: Outcome) -> Figure:
    """Plot the arm from the side and from above, the path of the tip, and the commands."""
    how = f"opening not reached: {outcome.reason}"
    if not mission.enters and np.isfinite(outcome.swing):
        how = f"tip held in front of the opening to within {outcome.swing:.2f} m"
    elif outcome.reached is not None:
        how = f"tip inside the opening after {outcome.reached:.0f} s"
    wind = mission.section.wind.speed_m_per_s
    title = f"Mission, wind {wind:g} m/s, controller {mission.driver}: {how}"
    figure = new_figure(11.0, 7.0, title, _MISSION_CAPTION)
    grid = figure.add_gridspec(4, 2)
    _shapes(figure.add_subplot(grid[:3, 0]), mission, outcome, "xz")
    _shapes(figure.add_subplot(grid[3, 0]), mission, outcome, "xy")
    _way(figure.add_subplot(grid[:2, 1]), mission, outcome)
    _commands(figure.add_subplot(grid[2:, 1]), outcome)
    return figure


def _shapes(panel: Axes, mission: Mission, outcome: Outcome, axes: str) -> None:
    arm = mission.model.arm
    rows = np.linspace(0, len(outcome.times) - 1, _SHAPES).astype(int)
    rows = rows[np.all(np.isfinite(outcome.angles[rows]), axis=1)]
    scenes = [
        dataclasses.replace(arm_scene(at_rest(arm, jnp.asarray(outcome.angles[row]))), markers={})
        for row in rows
    ]
    last = max(len(scenes) - 1, 1)
    for place, (row, scene) in enumerate(zip(rows, scenes, strict=True)):
        colour = to_hex(colormaps["viridis"](_LIGHTEST * (1 - place / last)))
        draw_scene(panel, scene, 0, axes=axes, colours={"link": colour})
        panel.plot([], [], color=colour, linewidth=3, label=f"{outcome.times[row]:.0f} s")
    seen = ["xyz".index(name) for name in axes]
    panel.plot(*outcome.tip[:, seen].T, ":", color=INK, linewidth=1.0, label="path of the tip")
    points = [scene.lines[k].points[0][:, seen] for scene in scenes for k in range(arm.count)]
    corners = np.asarray(mission.opening.corners)[:, seen]
    low, high = (of(np.concatenate([*points, corners]), axis=0) for of in (np.min, np.max))
    panel.set_xlim(low[0] - 1.5, high[0] + 2.5)
    panel.set_ylim(low[1] - 1.5, high[1] + 1.5)
    if scenes:
        # Omit the ground from above, where it would fill the panel.
        blocks = [block for block in scenes[0].blocks if axes == "xz" or block.size[0] < _GROUND]
        draw_blocks(panel, blocks, axes=axes)
    outline = corners[[0, 1, 2, 3, 0]]
    panel.plot(*outline.T, color=VERMILLION, linewidth=2.0, label="opening", zorder=6)
    title = "From the side" if axes == "xz" else "From above"
    plain(panel, title, f"{axes[0]} (m)", f"{axes[1]} (m)")
    panel.grid(False)
    panel.set_aspect("equal")
    if axes == "xz":
        panel.legend(fontsize=8, frameon=False, loc="upper left", bbox_to_anchor=(1, 1))


def _way(panel: Axes, mission: Mission, outcome: Outcome) -> None:
    opening = mission.opening
    for points, style, name in (
        (outcome.tip, "-", ""),
        (outcome.believed, ":", ", estimated by the operator"),
    ):
        local = np.asarray(opening.local(jnp.asarray(points)))
        beside = np.linalg.norm(local[:, 1:], axis=1)
        for of, values, mark, colour in (
            ("the plane of the opening", local[:, 0], "o", BLUE),
            ("the axis of the opening", beside, "s", VERMILLION),
        ):
            marks: Any = {} if name else {"marker": mark, "markevery": 0.1, "markersize": 4}
            panel.plot(
                outcome.times, values, style, color=colour, label=f"from {of}{name}", **marks
            )
    seen = outcome.corners >= 2
    edges = np.flatnonzero(np.diff(np.concatenate([[False], seen, [False]]).astype(int)))
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        panel.axvspan(outcome.times[first], outcome.times[end - 1], color=LIGHT, linewidth=0)
    panel.axhline(-mission.section.beyond_m, color=GREY, linewidth=0.8, linestyle="--")
    panel.set_ylim(-2, min(16, max(4.0, float(np.nanmax(np.abs(outcome.tip))))))
    title = "Tip and opening (grey: the camera sees the opening)"
    plain(panel, title, "time (s)", "distance of the tip (m)")
    panel.legend(fontsize=8, frameon=False)


def _commands(panel: Axes, outcome: Outcome) -> None:
    """Plot the commands of the joints that are bent most in colour, and the others in grey."""
    angles = np.rad2deg(outcome.command)
    order = np.argsort(-np.ptp(angles, axis=0), kind="stable")
    most = np.sort(order[: len(_BENT_MOST)])
    for joint in order[len(_BENT_MOST) :]:
        label = "other joints" if joint == order[-1] else None
        panel.plot(outcome.times, angles[:, joint], color=GREY, linewidth=0.5, label=label)
    for joint, (colour, style) in zip(most, _BENT_MOST, strict=False):
        line: Any = {"color": colour, "linestyle": style, "linewidth": 1.4}
        panel.plot(outcome.times, angles[:, joint], label=f"joint {joint + 1}", **line)
    plain(panel, "Commands", "time (s)", f"commanded angle ({DEGREE})")
    panel.legend(fontsize=8, frameon=False)


CASES_FILES = ("cases.json", "cases.csv", "cases.png")


def cases_files(mission: Mission, cases: Cases) -> dict[str, bytes]:
    """Return the results and a figure of many missions, by the names of `CASES_FILES`."""
    return {
        "cases.json": f"{cases_json(mission, cases)}\n".encode(),
        "cases.csv": to_csv(_columns(cases.cases)),
        "cases.png": to_png(cases_figure(mission, cases)),
    }


def _columns(cases: Sequence[Case]) -> dict[str, Any]:
    return {
        "wind_m_per_s": [case.wind for case in cases],
        "seed": [case.seed for case in cases],
        "reached_s": [np.nan if case.reached is None else case.reached for case in cases],
        "reason": [case.reason for case in cases],
        "flattening_m": [case.flattening for case in cases],
        "force_N": [case.force for case in cases],
        "touched": [" ".join(case.touched) for case in cases],
    }


def cases_json(mission: Mission, cases: Cases) -> str:
    """Return the successes and times at each wind speed as JSON text."""
    rows = [
        {
            "wind_m_per_s": tally.wind,
            "cases": len(tally.cases),
            "inside": tally.inside,
            "interval": list(tally.interval),
            "quartiles_s": None if tally.quartiles is None else list(tally.quartiles),
            "touched": tally.touched,
            "largest_flattening_m": tally.flattening,
            "largest_force_N": tally.force,
            "reasons": tally.reasons,
        }
        for tally in cases.tallies
    ]
    return json.dumps({"winds": rows, "mission": mission.section.contents()}, indent=2)


def cases_figure(mission: Mission, cases: Cases) -> Figure:
    """Plot the probability of success and the times to success versus wind speed."""
    section, limit = mission.section, mission.section.limit_s
    drawn = ", and the sampled parameters of the arm" if section.spread else ""
    caption = (
        f"The missions differ in the gusts and the pixel errors of the camera{drawn}. Left: "
        "percentage of the missions at each wind speed in which the tip moved at least "
        f"{section.beyond_m:g} m into the opening within the time limit of {limit:g} s and stayed "
        f"there for {section.hold_s:g} s. Error bars are 95 % intervals of the probability of "
        "success (Wilson). Right: time until the tip was inside, for each successful mission "
        "(grey dots, with a random horizontal offset), and the median (orange-red bar). The "
        "dashed line is the time limit."
    )
    figure = new_figure(9.0, 3.6, f"{len(cases.cases)} missions", caption)
    share, times = figure.subplots(1, 2)
    tallies = cases.tallies
    winds = np.array([tally.wind for tally in tallies])
    inside = np.array([tally.inside / len(tally.cases) for tally in tallies])
    low, high = np.array([tally.interval for tally in tallies]).T
    span = 100 * np.maximum([inside - low, high - inside], 0)
    share.errorbar(winds, 100 * inside, span, fmt="o-", color=BLUE, capsize=3)
    share.set_ylim(0, 105)
    across = "wind speed (m/s)"
    plain(
        share,
        f"Tip inside the opening within {limit / 60:g} min (95 % interval)",
        across,
        "share of missions (%)",
    )
    spread = 0.2 * (np.min(np.diff(winds)) if len(winds) > 1 else 0.1)
    random = np.random.default_rng(0)
    for tally in tallies:
        beside = tally.wind + spread * random.uniform(-1, 1, tally.inside)
        times.plot(beside, tally.times, ".", color=GREY, markersize=3, alpha=0.6)
        if tally.quartiles is not None:
            times.plot(tally.wind, tally.quartiles[1], "_", color=VERMILLION, markersize=18)
    times.axhline(limit, color=GREY, linewidth=0.8, linestyle="--")
    times.set_ylim(0, 1.05 * limit)
    plain(times, "Time until the tip was inside the opening (bar: median)", across, "time (s)")
    return figure


CERTIFICATE_FILES = ("certificate.json", "certificate.csv", "certificate.png")


def certificate_files(mission: Mission, found: Certificate, **origin: Any) -> dict[str, bytes]:
    """Return the results and a figure of a certificate, by the names of `CERTIFICATE_FILES`.

    `origin` adds keys to the JSON file that describe the origin of the certificate.
    """
    columns = {**_columns(found.cases), "chance": found.chances.tolist()}
    return {
        "certificate.json": f"{certificate_json(mission, found, **origin)}\n".encode(),
        "certificate.csv": to_csv(columns),
        "certificate.png": to_png(certificate_figure(mission, found)),
    }


def certificate_json(mission: Mission, found: Certificate, **origin: Any) -> str:
    """Return the probability of a mission and the data behind it as JSON text."""
    section = mission.section.contents()
    # Each mission has its own wind speed.
    wind = {key: one for key, one in section.get("wind", {}).items() if key != "speed_m_per_s"}
    facts = {
        "chance": found.chance,
        "interval": list(found.interval),
        "unlike": found.unlike,
        "air_m_per_s": list(found.air),
        "near": len(found.near),
        "near_inside": sum(case.reached is not None for case in found.near),
        "cases": len(found.cases),
        "inside": sum(case.reached is not None for case in found.cases),
        "controller": mission.driver,
        **origin,
        "mission": {**section, "wind": wind},
    }
    return json.dumps(plain_data(facts), indent=2)


_CERTIFICATE_CAPTION = (
    "Each marker is a mission that was simulated after a rest period. It is a blue dot if the tip "
    "was inside in time, and an orange-red cross otherwise. The ordinate is the wind speed of the "
    "mission, and the abscissa is the probability of success that a logistic regression on all "
    "missions estimates from its rest period. The grey line is the probability for the recording "
    "of the arm at rest. The light grey band is its 95 % confidence interval due to the finite "
    "number of missions, without the error of the logistic model."
)


def certificate_figure(mission: Mission, found: Certificate) -> Figure:
    """Plot the missions by wind speed and by the probability estimated from their own rests."""
    minutes = mission.section.limit_s / 60
    title = (
        f"Probability that the tip is inside the opening within {minutes:g} min, "
        f"controller {mission.driver}"
    )
    title = f"{title}: {100 * found.chance:.0f} %"
    figure = new_figure(7.5, 4.2, title, _CERTIFICATE_CAPTION)
    panel = figure.subplots()
    winds = np.array([case.wind for case in found.cases])
    inside = np.array([case.reached is not None for case in found.cases])
    for these, colour, mark, label in (
        (inside, BLUE, "o", "tip inside the opening"),
        (~inside, VERMILLION, "x", "tip not inside"),
    ):
        panel.plot(
            100 * found.chances[these], winds[these], mark, color=colour, markersize=4, alpha=0.7,
            label=f"{label} ({np.sum(these)})", linewidth=0,
        )  # fmt: skip
    low, high = found.interval
    panel.axvspan(
        100 * low, 100 * high, color=LIGHT, linewidth=0, label="recorded arm, 95 % interval"
    )
    panel.axvline(100 * found.chance, color=GREY, linewidth=1.2)
    panel.set_xlim(-2, 102)
    panel.set_ylim(0, 1.05 * max(winds.max(), 0.05))
    plain(
        panel,
        f"{len(winds)} simulated missions",
        "probability estimated from each arm at rest (%)",
        "wind speed (m/s)",
    )
    panel.legend(fontsize=8, frameon=False, loc="upper right")
    return figure
