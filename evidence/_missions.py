"""Missions: how often the operator brings the mock-up arm to its opening, by wind speed.

The study includes both interpretations of the 14 m in the paper. Arms and winds are sampled as the
files specify in `[mission.wind]` and `[mission.spread]`. The same arms and gusts are used at each
wind speed.
"""

import math
from pathlib import Path
from typing import Any

from ._record import ROOT
from ._study import Figures, Study, shares_differ

FILES = {"on the level": "naraha.toml", "along the line": "naraha_slant.toml"}
GEOMETRIES = {"on the level": "horizontal", "along the line": "slanted"}
"""Stored names of the two geometries -> names on the page."""

WINDS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)


def run(size: int, seed: int, names: tuple[str, ...] = tuple(FILES)) -> Figures:
    """Return the figures of about `size` missions, equally many for each geometry and wind."""
    count = math.ceil(size / (len(FILES) * len(WINDS)))
    return {name: _flown(ROOT / "missions" / FILES[name], count, seed) for name in names}


def part(size: int, seed: int) -> Figures:
    """Return the figures of one geometry."""
    return run(size, seed, ("on the level",))


def _flown(path: Path, count: int, seed: int) -> Figures:
    import json

    import jax

    jax.config.update("jax_enable_x64", True)
    from giajax.apps.mission import Mission, cases_json, fly_cases
    from giajax.recordings import Definition

    mission = Mission.from_definition(Definition.load(path))
    facts = json.loads(cases_json(mission, fly_cases(mission, WINDS, count, seed=1000 * seed)))
    spread, wind = (facts["mission"][key] for key in ("spread", "wind"))
    return {"spread": spread, "air": wind, "winds": [_short(row) for row in facts["winds"]]}


def _short(row: dict[str, Any]) -> dict[str, Any]:
    short = {key: round(v, 4) if isinstance(v, float) else v for key, v in row.items()}
    for key, digits in (("interval", 4), ("quartiles_s", 1)):
        short[key] = row[key] and [round(each, digits) for each in row[key]]
    return short


def disagreements(stored: Figures, new: Figures) -> list[str]:
    """Report success rates that differ by more than by chance (Fisher's exact test)."""
    sentences = []
    for name, after in new.items():
        for one, other in zip(stored[name]["winds"], after["winds"], strict=True):
            if shares_differ(one["inside"], one["cases"], other["inside"], other["cases"]):
                sentences.append(
                    f"{name}, {one['wind_m_per_s']:g} m/s: {other['inside']} of {other['cases']} "
                    f"inside, and {one['inside']} of {one['cases']} were"
                )
    return sentences


REASONS = {
    "the tip did not come near": "the tip did not approach the opening",
    "the tip came near, and not in": "the tip approached the opening and did not enter it",
    "the tip came in, and did not stay": "the tip entered the opening and did not stay inside",
}
"""Stored reasons of failures -> reasons on the page."""


def table(figures: Figures) -> list[str]:
    """Return a table with a row for each geometry and wind speed."""
    rows = [
        "| direction of the 14 m | air speed, m/s | missions with the tip inside within 12 min | "
        "95 % interval of the share | median time, s | quartiles, s | missions with contact | "
        "largest flattening, mm | largest contact force, N | reasons for failure |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, each in figures.items():
        for row in each["winds"]:
            low, middle, high = row["quartiles_s"] or ("-", "-", "-")
            least, most = row["interval"]
            why = "; ".join(
                f"{count}: {REASONS.get(reason, reason)}"
                for reason, count in row["reasons"].items()
            )
            rows.append(
                f"| {GEOMETRIES[name]} | {row['wind_m_per_s']:g} | {row['inside']} of "
                f"{row['cases']} | {100 * least:.1f} to {100 * most:.1f} % | {middle} | "
                f"{low} to {high} | {row['touched']} | {1e3 * row['largest_flattening_m']:.0f} | "
                f"{row['largest_force_N']:.1f} | {why or '-'} |"
            )
    spread = next(iter(figures.values()))["spread"]
    drawn = ", ".join(f"`{path}` {deviation:g}" for path, deviation in spread.items())
    return [
        *rows,
        "",
        "The following parameters are sampled for each case, with these standard deviations of "
        f"their logarithms: {drawn}. "
        "The mean flow of the air is horizontal and has a random direction. Its speed is 0.3 times "
        "the air speed. Gusts with a length scale of 2 m along the arm make up the rest. The "
        "radius of a link is 150 mm.",
    ]


MISSIONS = Study(
    name="missions",
    meaning=(
        "The operator model of `giajax mission` steers the paper's arm through the window frame "
        "of the mock-up. The table lists, for each air speed, how often the operator succeeds, the "
        "time to success, how often the arm touches an obstacle, and the reasons for failures."
    ),
    size=1000,
    seed=1,
    run=run,
    disagreements=disagreements,
    table=table,
    part=part,
)
