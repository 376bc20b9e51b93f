"""Missions by model predictive control, by the retuned operator, and with a known state.

Arms and winds are sampled as the files of the missions specify, and are the same for all
controllers. The controller with a known state is the same predictive control, which receives the
true state, wind and stiffness of the arm with the delay of the image.
"""

import dataclasses
import tomllib
from typing import Any

import numpy as np

from ._missions import GEOMETRIES, REASONS
from ._record import ROOT
from ._study import Figures, Study, shares_differ

FILES = {"on the level": "naraha.toml", "along the line": "naraha_slant.toml"}
WINDS = (0.2, 0.3)
# The speed and rate with which the operator arrived soonest, which also causes contacts.
RETUNED = {"speed_m_per_s": 0.3, "approach_rate_deg_per_s": 2.0}
DRIVERS: dict[str, tuple[str, dict[str, float]]] = {
    "operator, retuned": ("operator", RETUNED),
    "mpc": ("mpc", {}),
}
LATENCY = 0.5  # s
INTERVAL, KNOWN = 0.1, 200.0  # s: between decisions; time limit with a known state


def run(size: int, seed: int) -> Figures:
    """Return the figures of `size` missions of each kind."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return {name: _missions(file, size, seed) for name, file in FILES.items()}


def part(size: int, seed: int) -> Figures:
    """Return the figures of level missions by model predictive control in the paper's wind."""
    import jax

    jax.config.update("jax_enable_x64", True)
    return {"on the level": _flown("mpc", "naraha.toml", WINDS[:1], max(2, size // 2), seed)}


def mission_of(file: str, controller: str, **operator: float) -> Any:
    """Return a mission of the folder `missions`, with other settings of its operator."""
    from giajax.apps.mission import Mission
    from giajax.recordings import Definition

    text = (ROOT / "missions" / file).read_text(encoding="utf-8")
    data = tomllib.loads(text)
    data["mission"]["operator"] |= operator
    return Mission.from_definition(Definition.parse(data), controller=controller)


def _missions(file: str, count: int, seed: int) -> list[dict[str, Any]]:
    rows = []
    for name in DRIVERS:
        rows += _flown(name, file, WINDS, count, seed)
    # The same arms and winds for both controllers.
    seeds = range(1000 * seed, 1000 * seed + max(1, count // 6))
    mission = mission_of(file, "mpc", latency_s=LATENCY)
    mpc = [mission.case(k).fly(k, drawn=mission).reached for k in seeds]
    known = [knowing(mission, k)["reached_s"] for k in seeds]
    for name, times in (("mpc, some of these", mpc), ("mpc that knows all", known)):
        arrived = [time for time in times if time is not None and time <= KNOWN]
        middle = round(float(np.median(arrived)), 1) if arrived else None
        row = {"wind_m_per_s": WINDS[0], "cases": len(times), "inside": len(arrived)}
        rows.append({"driver": f"{name}, {KNOWN:g} s", **row, "median_s": middle})
    return rows


def _flown(
    name: str, file: str, winds: tuple[float, ...], count: int, seed: int
) -> list[dict[str, Any]]:
    from giajax.apps.mission import fly_cases

    controller, settings = DRIVERS[name]
    mission = mission_of(file, controller, latency_s=LATENCY, **settings)
    found = fly_cases(mission, winds, count, seed=1000 * seed)
    return [{"driver": name, **_row(tally)} for tally in found.tallies]


def _row(tally: Any) -> dict[str, Any]:
    quartiles = None if tally.quartiles is None else [round(each, 1) for each in tally.quartiles]
    return {
        "wind_m_per_s": tally.wind,
        "cases": len(tally.cases),
        "inside": tally.inside,
        "median_s": None if quartiles is None else quartiles[1],
        "quartiles_s": None if quartiles is None else quartiles[::2],
        "touched": tally.touched,
        "largest_flattening_m": round(tally.flattening, 4),
        "reasons": tally.reasons,
    }


def knowing(mission: Any, seed: int) -> dict[str, Any]:
    """Return the figures of a mission with a delayed true state, wind and stiffness."""
    import jax
    import jax.numpy as jnp

    from giajax.apps.mission import Scene, Steering

    from ._holding import flown_knowing

    drawn = mission.case(seed)
    steering = Steering.from_section(mission.section, drawn.model)
    steering = dataclasses.replace(steering, deep=mission.controller.deep)
    scene = Scene(drawn.model.arm, mission.camera, mission.opening, jnp.asarray(INTERVAL))
    most = mission.section.limit_s if not mission.enters else min(KNOWN, mission.section.limit_s)
    wind = mission.wind(seed)[: round(most / INTERVAL) + 1]
    late = round(mission.section.operator.latency_s / INTERVAL)
    tip = np.asarray(flown_knowing(drawn.model.arm, steering, scene, jnp.asarray(wind), late))
    half = tip[len(tip) // 2 :]
    local = np.asarray(mission.opening.local(jnp.asarray(tip)))
    beside = np.asarray(jax.vmap(mission.opening.beside)(jnp.asarray(local)))
    inside = (local[:, 0] < -mission.section.beyond_m) & (beside == 0)
    held = round(mission.section.hold_s / INTERVAL)
    stays = np.convolve(inside, np.ones(held), "valid") == held
    return {
        "swing_m": float(np.sqrt(np.mean(np.sum((half - half.mean(axis=0)) ** 2, axis=1)))),
        "reached_s": float(np.argmax(stays) * INTERVAL) if np.any(stays) else None,
    }


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report fewer arrivals, or more contacts, than expected by chance."""
    sentences = []
    for name, rows in new.items():
        before = {(row["driver"], row["wind_m_per_s"]): row for row in stored[name]}
        for row in rows:
            then = before[row["driver"], row["wind_m_per_s"]]
            shares = then["inside"], then["cases"], row["inside"], row["cases"]
            if shares_differ(*shares, fewer=True):
                sentences.append(
                    f"{name}, {row['driver']}: {row['inside']} of {row['cases']} are inside, and "
                    f"{then['inside']} of {then['cases']} were"
                )
            clear = then["cases"] - then["touched"], row["cases"] - row["touched"]
            if shares_differ(clear[0], then["cases"], clear[1], row["cases"], fewer=True):
                sentences.append(
                    f"{name}, {row['driver']}: {row['touched']} of {row['cases']} touched "
                    f"something, and {then['touched']} of {then['cases']} did"
                )
    return sentences


SHOWN = {
    "mpc, some of these, 200 s": "mpc, subset of the cases, limit of 200 s",
    "mpc that knows all, 200 s": "mpc with the true state and air, the same subset",
}
"""Stored names of controllers -> names on the page."""


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each controller and wind speed."""
    rows = [
        "| direction of the 14 m | air speed, m/s | controller | missions with the tip inside "
        "within 12 min | median time, s | quartiles, s | missions with contact | largest "
        "flattening, mm | reasons for failure |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        for row in each:
            low, high = row.get("quartiles_s") or ("-", "-")
            why = "; ".join(
                f"{n}: {REASONS.get(reason, reason)}"
                for reason, n in row.get("reasons", {}).items()
            )
            flat = row.get("largest_flattening_m")
            cells = [
                GEOMETRIES[name], f"{row['wind_m_per_s']:g}",
                SHOWN.get(row["driver"], row["driver"]),
                f"{row['inside']} of {row['cases']}", row["median_s"] or "-", f"{low} to {high}",
                row.get("touched", "-"), "-" if flat is None else f"{1e3 * flat:.0f}", why or "-",
            ]  # fmt: skip
            rows.append(f"| {' | '.join(map(str, cells))} |")
    return [
        *rows,
        "",
        f"Camera images arrive {LATENCY:g} s late. In the retuned operator model, the speed is 0.3 "
        "m/s, and the joints move to the approach pose at 2 deg/s.",
    ]


STEERING = Study(
    name="steering",
    meaning=(
        "`giajax mission --controller mpc` and other controllers steer the tip of the paper's arm "
        "through the window frame of the mock-up. The table lists how often they succeed and "
        "the time to success."
    ),
    size=72,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
