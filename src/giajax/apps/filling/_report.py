"""An arm that was filled, as pictures, tables and plain data."""

import json
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ...report import BLUE, GREY, INK, VERMILLION, new_figure, plain, to_csv, to_png
from ...runtime.records import plain_data
from ._fill import Filled, FillingCurve

FILLING_FILES = ("filling.json", "filling.csv", "filling.png")
CURVE_FILES = ("curve.csv", "curve.png")

_MINUTE, _LITRE_PER_MINUTE = 60.0, 1e-3 / 60


def filling_files(filled: Filled, curve: FillingCurve | None = None) -> dict[str, bytes]:
    """Numbers and pictures of a filling, by the names of `FILLING_FILES` and `CURVE_FILES`."""
    files = {
        "filling.json": f"{filling_json(filled, curve)}\n".encode(),
        "filling.csv": to_csv(_columns(filled)),
        "filling.png": to_png(filling_figure(filled)),
    }
    if curve is not None:
        pairs = {
            "port_diameter_mm": curve.diameters * 1e3,
            "supply_flow_l_per_min": curve.flows / _LITRE_PER_MINUTE,
            curve.path.replace(".", "_"): curve.strengths,
            "largest_pressure_Pa": curve.pressures,
        }
        files |= {"curve.csv": to_csv(pairs), "curve.png": to_png(curve_figure(curve))}
    return files


def _columns(filled: Filled) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "time_s": filled.times,
        "supply_flow_m3_per_s": filled.flow,
        "supplied_kg": filled.supplied,
    }
    each = {
        "fullness": filled.fullness,
        "pressure_Pa": filled.pressure,
        "net_lift_kg": filled.net_lift,
        "stiffness_N_m2": filled.stiffness,
    }
    for name, table in each.items():
        columns |= {f"link{i:02d}_{name}": row for i, row in enumerate(table.T, start=1)}
    return columns


def filling_json(filled: Filled, curve: FillingCurve | None = None) -> str:
    """A filling as JSON text, without what it was like on the way; what never came is null."""
    made = filled.filling
    facts: dict[str, Any] = {
        "finished": filled.finished,
        "duration_s": filled.duration,
        "arm_lift_off_s": filled.arm_lift_off,
        "volume_m3": np.sum(np.asarray(made.volume)),
        "supplied_kg": filled.supplied[-1],
        "imbalance": filled.imbalance,
        "links": {
            f"link{i:02d}": {
                "full_s": filled.full[i - 1],
                "lift_off_s": filled.lift_off[i - 1],
                "largest_pressure_Pa": filled.pressure[:, i - 1].max(),
                "fullness": filled.fullness[-1, i - 1],
                "net_lift_kg": filled.net_lift[-1, i - 1],
                "folding_moment_N_m": filled.folding_moment[-1, i - 1],
                "stiffness_N_m2": filled.stiffness[-1, i - 1],
            }
            for i in range(1, made.arm.count + 1)
        },
        "filling": made.definition(),
    }
    if curve is not None:
        names = ("port_diameter_m", "supply", "supply_flow_m3_per_s", "largest_pressure_Pa")
        rows = zip(curve.diameters, curve.strengths, curve.flows, curve.pressures, strict=True)
        facts["curve"] = {
            "duration_s": curve.duration,
            "supply": curve.path,
            "pairs": [dict(zip(names, row, strict=True)) for row in rows],
        }
    return json.dumps(plain_data(facts), indent=2)


def filling_figure(filled: Filled) -> Figure:
    """Fullness, pressure, lift and stiffness over time."""
    end = f"full after {filled.duration / _MINUTE:.1f} min" if filled.finished else "never full"
    figure = new_figure(9.0, 6.0, f"Filling {filled.filling.arm.count} links: {end}")
    minutes = filled.times / _MINUTE
    panels = {
        "Fullness of each link": (filled.fullness, "volume over that when tight"),
        "Pressure in each link": (filled.pressure, "Pa above the room"),
        "Lift beyond each link's own weight": (filled.net_lift * 1e3, "g"),
        "Bending stiffness of each link (assumed)": (filled.stiffness, "N m$^2$"),
    }
    for place, (title, (table, unit)) in enumerate(panels.items(), start=1):
        axes = figure.add_subplot(2, 2, place)
        _curves(axes, minutes, table)
        plain(axes, title, "time (min)", unit)
        if place == 2:
            axes.legend(fontsize=8, frameon=False, loc="upper left")
        if place == 3:
            axes.axhline(0, color=GREY, linewidth=0.8)
            if not np.isnan(filled.arm_lift_off):
                when = filled.arm_lift_off / _MINUTE
                axes.axvline(when, color=INK, linewidth=0.8, linestyle="--")
                low, high = axes.get_ylim()
                axes.set_ylim(low, high + 0.2 * (high - low))
                said, above = f"the arm lifts itself: {when:.1f} min", high + 0.08 * (high - low)
                small: Any = {"ha": "right", "fontsize": 8}
                axes.annotate(said, (when, above), (-4, 0), textcoords="offset points", **small)
    return figure


def _curves(axes: Axes, minutes: Any, table: Any) -> None:
    """A line for each link, from the base's colour to the tip's."""
    last = table.shape[1] - 1
    named = {0: "link 1 (base)", last: f"link {last + 1} (tip)"} if last else {0: "link 1"}
    for index, row in enumerate(table.T):
        colour = colormaps["viridis"](0.9 * index / max(last, 1))
        axes.plot(minutes, row, color=colour, linewidth=1.1, label=named.get(index))


def curve_figure(curve: FillingCurve) -> Figure:
    """Port against supply, and the pressure that it costs."""
    title = f"Ports and supplies with which filling takes {curve.duration / _MINUTE:g} min"
    figure = new_figure(8.0, 3.4, title)
    diameters = curve.diameters * 1e3
    axes = figure.add_subplot(1, 2, 1)
    axes.plot(curve.flows / _LITRE_PER_MINUTE, diameters, "o-", color=BLUE, ms=4)
    port = "diameter of the ports (mm)"
    plain(axes, "Port against supply", "flow of the supply when it begins (l/min)", port)
    axes.set_ylim(bottom=0)
    axes = figure.add_subplot(1, 2, 2)
    axes.semilogy(diameters, curve.pressures, "o-", color=VERMILLION, ms=4)
    plain(axes, "What it costs", port, "largest pressure in the first bag (Pa)")
    axes.tick_params(which="both", labelsize=8)
    return figure
