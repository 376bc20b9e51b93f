"""Files, figure and scene of a life cycle."""

import dataclasses
import json
from typing import Any

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...models import Line, Scene, arm_scene
from ...report import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT,
    PURPLE,
    VERMILLION,
    new_figure,
    plain,
    to_csv,
    to_png,
)
from ...runtime.records import plain_data
from ..mission import motion
from ..viewer import Show
from ._life import Balance, Life

LIFE_FILES = ("life.json", "life.csv", "life.png")

_MINUTE = 60.0
_Numbers = npt.NDArray[np.float64]


def life_files(life: Life) -> dict[str, bytes]:
    """Return the results and a figure of a life cycle, by the names of `LIFE_FILES`."""
    return {
        "life.json": f"{life_json(life)}\n".encode(),
        "life.csv": to_csv(_columns(life)),
        "life.png": to_png(life_figure(life)),
    }


def _columns(life: Life) -> dict[str, Any]:
    """Return the table of the phases; works that do not occur in a phase are 0."""
    phases = life.phases
    names = dict.fromkeys(name for each in phases for name in each.energy.works)
    columns: dict[str, Any] = {"phase": [each.name for each in phases]}
    facts = {
        "begin_s": "begin",
        "end_s": "end",
        "fed_kg": "fed",
        "let_out_kg": "let_out",
        "gas_kg": "gas",
        "lift_kg": "lift",
        "margin_N": "margin",
        "weakest_link": "weakest",
    }
    columns |= {key: [getattr(each, name) for each in phases] for key, name in facts.items()}
    columns["touched"] = [" ".join(each.obstacles) for each in phases]
    columns["stored_J"] = [each.energy.stored for each in phases]
    for name in names:
        key = f"{name.replace(' ', '_')}_work_J"
        columns[key] = [each.energy.works.get(name, 0.0) for each in phases]
    columns["imbalance_J"] = [each.energy.imbalance for each in phases]
    return columns


def _balance(balance: Balance) -> dict[str, Any]:
    return {
        "stored_J": balance.stored,
        "works_J": dict(balance.works),
        "lost_J": balance.lost,
        "exchanged_J": balance.exchanged,
        "imbalance_J": balance.imbalance,
    }


def life_json(life: Life) -> str:
    """Return the results of a life cycle as JSON text."""
    made, mission = life.unrolled.unrolling, life.mission
    changed, impulses = life.momentum
    phases = [
        {
            "phase": each.name,
            "begin_s": each.begin,
            "end_s": each.end,
            "fed_kg": each.fed,
            "let_out_kg": each.let_out,
            "gas_kg": each.gas,
            "lift_kg": each.lift,
            "margin_N": each.margin,
            "weakest_link": each.weakest,
            "pressure_Pa": each.pressure,
            "fullness": each.fullness,
            "touched": each.obstacles,
            "energy": _balance(each.energy),
        }
        for each in life.phases
    ]
    facts = {
        "duration_s": life.duration,
        "reached_s": life.outcome.reached,
        "reason": life.outcome.reason or None,
        "muscle_pull_N": life.pull,
        "helium_imbalance": life.helium,
        "energy_imbalance": life.energy_imbalance,
        "momentum_imbalance": life.momentum_imbalance,
        "repeat_apart_rad": life.apart,
        "energy": _balance(life.energy),
        "momentum_change_N_s": changed,
        "impulses_N_s": impulses,
        "arm_lift_off_s": life.unrolled.arm_lift_off,
        "phases": phases,
        "mission": mission.section.contents(),
        "unrolling": made.definition(),
        "filling": made.filling.definition(),
    }
    return json.dumps(plain_data(facts), indent=2)


def _gas_rows(life: Life) -> dict[str, _Numbers]:
    """Return the time, s, gas, kg, least and largest pressure, Pa, and lift, kg, of all phases."""
    filling = life.unrolled.unrolling.filling
    full = np.asarray(filling.full_mass)
    parts: list[tuple[_Numbers, ...]] = []
    times = life.unrolled.times
    one = np.ones_like(times)
    least = float(life.courses["fill"].lift[0])
    parts.append((times, life.unrolled.gas, 0 * one, life.unrolled.pressure, least * one))
    for phase in life.phases[1:]:
        course = life.courses.get(phase.name)
        if course is None:
            row = (phase.gas, phase.pressure.min(), phase.pressure.max(), phase.lift)
            ends = np.array([phase.begin, phase.end])
            parts.append((ends, *(np.full(2, each) for each in row)))
            continue
        share, pressure = np.asarray(course.share), np.asarray(course.pressure)
        gas = share @ full if share.shape[1] == full.size else share[:, 0] * full.sum()
        times = phase.begin + np.asarray(course.times)
        rows = (gas, pressure.min(axis=1), pressure.max(axis=1), np.asarray(course.lift))
        parts.append((times, *rows))
    names = ("time", "gas", "least", "most", "lift")
    return dict(zip(names, map(np.concatenate, zip(*parts, strict=True)), strict=True))


_CAPTION = (
    "Top: mass of gas in the arm, and highest (orange-red) and lowest (dotted blue) gauge pressure "
    "of all links. At the dashed line the pressure force on the largest cross-section equals the "
    "maximum pull of one muscle. The background alternates between phases, and long phases are "
    "labelled. Lower left: energy gained (blue), energy lost or delivered (orange-red, hatched), "
    "and magnitude of the change of stored energy (green, dotted) in each phase. Values below 1e-6 "
    "J are drawn as 1e-6 J. Lower right: work during the mission. Negative work takes energy from "
    "the motion."
)


def life_figure(life: Life) -> Figure:
    """Plot the gas and the pressures versus time, the energies, and the works of the mission."""
    links = life.mission.model.arm.count
    title = f"Life cycle of an arm with {links} links: duration {life.duration / _MINUTE:.1f} min"
    figure = new_figure(10.0, 7.0, title, _CAPTION)
    rows = _gas_rows(life)
    minutes = rows["time"] / _MINUTE
    axes = figure.add_subplot(2, 2, 1)
    axes.plot(minutes, rows["gas"] * 1e3, color=BLUE, linewidth=1.4)
    plain(axes, "Gas in the arm", "time (min)", "mass (g)")
    _mark(axes, life)
    axes = figure.add_subplot(2, 2, 2)
    axes.plot(minutes, rows["most"], color=VERMILLION, linewidth=1.2, label="highest")
    axes.plot(minutes, rows["least"], ":", color=BLUE, linewidth=1.6, label="lowest")
    area = np.pi / 4 * float(np.max(life.mission.model.arm.links.diameter)) ** 2
    axes.axhline(
        life.pull / area, color=INK, linewidth=0.8, linestyle="--", label="needed for one muscle"
    )
    axes.legend(fontsize=8, frameon=False)
    plain(axes, "Pressure in the links", "time (min)", "gauge pressure (Pa)")
    _mark(axes, life)
    axes = figure.add_subplot(2, 2, 3)
    _energies(axes, life)
    axes = figure.add_subplot(2, 2, 4)
    _works(axes, life)
    return figure


def _mark(axes: Axes, life: Life) -> None:
    """Shade every other phase, and label the phases that are long enough."""
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))
    for index, phase in enumerate(life.phases):
        if index % 2:
            axes.axvspan(phase.begin / _MINUTE, phase.end / _MINUTE, color=LIGHT, linewidth=0)
        if phase.end - phase.begin > 0.06 * life.duration:
            middle = (phase.begin + phase.end) / 2 / _MINUTE
            at = high + 0.06 * (high - low)
            axes.text(middle, at, phase.name, fontsize=7, color=INK, ha="center", va="center")


def _energies(axes: Axes, life: Life) -> None:
    """Plot the energies that were gained, lost and stored in each phase."""
    places = np.arange(len(life.phases))
    rows = {
        "gained": ([each.energy.gained for each in life.phases], BLUE, ""),
        "lost or delivered": ([each.energy.lost for each in life.phases], VERMILLION, "////"),
        "stored": ([abs(each.energy.stored) for each in life.phases], GREEN, "...."),
    }
    for offset, (name, (heights, colour, hatch)) in zip(
        (-0.27, 0, 0.27), rows.items(), strict=True
    ):
        # The edges have no width, but hatches are drawn in their colour.
        style: Any = {"color": colour, "hatch": hatch, "edgecolor": "white", "linewidth": 0}
        axes.bar(places + offset, np.maximum(heights, 1e-6), 0.27, label=name, **style)
    axes.set_yscale("log")
    axes.set_xticks(places, [each.name for each in life.phases], rotation=45, ha="right")
    axes.legend(fontsize=7, frameon=False)
    plain(axes, "Energies in each phase", "", "energy (J)")
    axes.tick_params(which="both", labelsize=7)


def _works(axes: Axes, life: Life) -> None:
    """Plot the works during the mission versus time."""
    styles: Any = zip(
        (BLUE, VERMILLION, GREEN, INK, GREY, PURPLE),
        ("-", "--", "-.", ":", (0, (8, 2)), (0, (5, 1, 1, 1, 1, 1))),
        strict=True,
    )
    for name, row in life.audit.works._asdict().items():
        if np.any(np.asarray(row) != 0):
            colour, dashes = next(styles)
            axes.plot(life.outcome.times, row, color=colour, ls=dashes, lw=1.2, label=name)
    axes.axhline(0, color=GREY, linewidth=0.8)
    axes.legend(fontsize=7, frameon=False)
    plain(axes, "Work done on the arm during the mission", "time (s)", "work (J)")


_FRAMES = 40  # number of frames of a phase without a flight
_FLAT = 0.1  # drawn radius of an empty link divided by that of a full one


def life_show(life: Life) -> Show:
    """Return all phases as one scene on one clock, for a page of the viewer.

    In the phases of unrolling, filling and deflating, the links lie at the level of the base and
    point away from the opening. The roll is drawn as a crosswise line with the width of a link.
    Raising and lowering rotate the straight arm about its base.
    """
    arm = life.mission.model.arm
    flown = arm_scene(motion(life.mission, life.outcome))
    away = -np.asarray(life.mission.opening.centre) * [1.0, 1.0, 0.0]
    length = float(np.linalg.norm(away))
    lying = away / length if length > 0 else np.array([-1.0, 0.0, 0.0])
    lengths = np.asarray(arm.links.length)
    ends = np.cumsum(lengths)
    across = np.cross([0.0, 0.0, 1.0], lying)
    half = np.asarray(arm.links.diameter)[:, None] / 2 * across
    # The mission begins with the straight arm.
    first = flown.lines[0].points[0]
    straight = (first[1] - first[0]) / np.linalg.norm(first[1] - first[0])

    def laid(paid_out: float) -> _Numbers:
        """Return both ends of each link, m, shape (link, 2, 3)."""
        begin, end = ends - lengths, np.minimum(ends, paid_out)
        out = np.stack([begin, end], axis=1)[:, :, None] * lying
        roll = paid_out * lying + np.stack([-half, half], axis=1)
        rolled: _Numbers = np.where((begin < paid_out)[:, None, None], out, roll)
        return rolled

    points, fullness, times = [], [], []

    def add(when: npt.ArrayLike, rows: Any, full: Any) -> None:
        times.append(np.asarray(when, dtype=float))
        points.append(np.asarray(rows))
        fullness.append(np.broadcast_to(full, (len(times[-1]), arm.count)))

    unrolled = life.unrolled
    some = _some(len(unrolled.times))
    add(unrolled.times[some], [laid(x) for x in unrolled.paid_out[some]], 0.0)
    turned = _turned(lying, straight, lengths)
    for phase in life.phases[1:]:
        course = life.courses.get(phase.name)
        clock = np.linspace(phase.begin, phase.end, _FRAMES)
        part = np.linspace(0, 1, _FRAMES)
        if phase.name == "mission":
            links = [line.points for line in flown.lines if line.name == "link"]
            add(phase.begin + life.outcome.times, np.stack(links, axis=1), phase.fullness)
        elif phase.name in ("raise", "lower"):
            order = part if phase.name == "raise" else part[::-1]
            add(clock, [turned(x) for x in order], phase.fullness)
        else:
            assert course is not None
            row = _some(len(course.times))
            rolls = phase.name == "roll up"
            rest = 1 - np.asarray(course.times)[row] / float(course.times[-1])
            out = [laid(ends[-1] * (x if rolls else 1.0)) for x in rest]
            add(phase.begin + np.asarray(course.times)[row], out, np.asarray(course.fullness)[row])
    # Remove the duplicate times where one phase ends and the next one begins.
    clock = np.concatenate(times)
    clock, kept = np.unique(clock, return_index=True)
    place = np.concatenate(points)[kept]
    wide = np.concatenate(fullness)[kept]
    swelling = np.sqrt(np.clip(wide, _FLAT**2, 1))
    radii = np.asarray(arm.links.diameter) / 2
    lines = tuple(
        Line("link", place[:, k], np.full(2, radii[k]), swelling=swelling[:, k])
        for k in range(arm.count)
    )
    scene = Scene(lines, {"tip": place[:, -1, 1]}, clock, (), flown.blocks)
    captions = tuple((each.begin, each.name) for each in life.phases)
    return dataclasses.replace(Show("life", scene), captions=captions)


def _some(rows: int) -> npt.NDArray[np.int64]:
    return np.unique(np.linspace(0, rows - 1, 2 * _FRAMES).astype(int))


def _turned(lying: _Numbers, straight: _Numbers, lengths: _Numbers) -> Any:
    """Return a function of the ends of each link while the arm rotates between two directions.

    Its argument is the completed part of the rotation, from 0 to 1.
    """
    cosine = float(np.clip(lying @ straight, -1, 1))
    angle = np.arccos(cosine)
    aside = straight - cosine * lying
    size = float(np.linalg.norm(aside))
    aside = aside / size if size > 1e-9 else np.array([0.0, 0.0, 1.0])
    ends = np.cumsum(lengths)

    def at(part: float) -> _Numbers:
        along = np.cos(part * angle) * lying + np.sin(part * angle) * aside
        rows: _Numbers = np.stack([ends - lengths, ends], axis=1)[:, :, None] * along
        return rows

    return at
