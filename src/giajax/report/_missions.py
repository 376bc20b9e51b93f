"""Many missions as pictures, tables and plain data."""

import json
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from ..mission import Cases, Mission
from ._csv import to_csv
from ._style import BLUE, GREY, VERMILLION, new_figure, plain, to_png

CASES_FILES = ("cases.json", "cases.csv", "cases.png")


def cases_files(mission: Mission, cases: Cases) -> dict[str, bytes]:
    """Numbers and a picture of many missions, by the names of `CASES_FILES`."""
    columns: dict[str, list[Any]] = {
        "wind_m_per_s": [case.wind for case in cases.cases],
        "seed": [case.seed for case in cases.cases],
        "reached_s": [np.nan if case.reached is None else case.reached for case in cases.cases],
        "reason": [case.reason for case in cases.cases],
        "flattening_m": [case.flattening for case in cases.cases],
        "force_N": [case.force for case in cases.cases],
        "touched": [" ".join(case.touched) for case in cases.cases],
    }
    return {
        "cases.json": f"{cases_json(mission, cases)}\n".encode(),
        "cases.csv": to_csv(columns),
        "cases.png": to_png(cases_figure(mission, cases)),
    }


def cases_json(mission: Mission, cases: Cases) -> str:
    """Success and time by speed of the air as JSON text."""
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
    """Success, and the times that it took, against the speed of the air."""
    limit = mission.section.limit_s
    figure = new_figure(9.0, 3.6, f"{len(cases.cases)} missions")
    share, times = figure.subplots(1, 2)
    tallies = cases.tallies
    winds = np.array([tally.wind for tally in tallies])
    inside = np.array([tally.inside / len(tally.cases) for tally in tallies])
    low, high = np.array([tally.interval for tally in tallies]).T
    span = 100 * np.maximum([inside - low, high - inside], 0)
    share.errorbar(winds, 100 * inside, span, fmt="o-", color=BLUE, capsize=3)
    share.set_ylim(0, 105)
    share.set_ylabel("%")
    plain(share, f"Inside within {limit / 60:g} min (95 % interval)")
    spread = 0.2 * (np.min(np.diff(winds)) if len(winds) > 1 else 0.1)
    random = np.random.default_rng(0)
    for tally in tallies:
        beside = tally.wind + spread * random.uniform(-1, 1, tally.inside)
        times.plot(beside, tally.times, ".", color=GREY, markersize=3, alpha=0.6)
        if tally.quartiles is not None:
            times.plot(tally.wind, tally.quartiles[1], "_", color=VERMILLION, markersize=18)
    times.axhline(limit, color=GREY, linewidth=0.8, linestyle="--")
    times.set_ylim(0, 1.05 * limit)
    times.set_ylabel("s")
    plain(times, "Time until it was inside (median in red)")
    for panel in (share, times):
        panel.set_xlabel("speed of the air (m/s)")
    return figure
