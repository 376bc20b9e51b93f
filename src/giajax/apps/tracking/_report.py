"""Figures, tables, plain data, page and run of a track."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from ...report import BLUE, GREY, VERMILLION, Table, new_figure, plain
from ...runtime.records import plain_data
from ...runtime.text import format_estimate
from ...schema import CommandSection
from ...schema.parameters import find
from ._live import Heard
from ._track import SHOWN, Change, States, Track
from ._verdict import BAND, TrackVerdict

Hidden = Sequence[tuple[str, float, float]]
"""States about which the channels contain little information, as `unseen` returns them."""

_NAMED = 6


class TrackFiles(NamedTuple):
    """File names of a track."""

    facts: str = "track.json"
    picture: str = "track.png"
    page: str = "track.html"
    bands: str = "bands.csv"
    estimate: str = "estimate.csv"


TRACK_FILES = TrackFiles()


def _caption(found: Track) -> str:
    dots = (
        " Grey dots: measured positions at the time of exposure."
        if any(f"tip_{axis}" in found.arm.channels for axis in "xyz")
        else ""
    )
    wind = (
        " Mean wind: smoothed estimates of its components x (grey, dotted), y (blue) and z "
        "(orange-red, dashed), averaged over the links."
        if found.filtered.wind is not None
        else ""
    )
    return (
        "Tip x, y and z: estimates from the measurements up to each time (filter, dashed blue) and "
        f"from the whole run (smoother, orange-red).{dots}{wind} Bands: 95 %, or {BAND:g} standard "
        "deviations above and below the estimate. Innovations: measured minus expected values of "
        "all channels, whitened to a standard deviation of 1; values that were not used, such as "
        "outliers, are at 0. Dotted lines: -2 and 2."
    )


def track_figure(found: Track, title: str = "") -> Figure:
    """Plot the tip, the wind and the innovations versus time, with 95 % bands."""
    blows = found.filtered.wind is not None
    rows = 4 + blows
    title = title or f"Track of {found.run.name}"
    figure = new_figure(9, 1.7 * rows + 0.6, title, _caption(found))
    axes = figure.subplots(rows, 1, sharex=True)
    times = found.times
    for k, axis in enumerate("xyz"):
        name = f"tip_{axis}"
        if name in found.arm.channels:
            column = found.arm.channels.index(name)
            there = found.there[:, column]
            shown = np.asarray(found.run.values[name])
            stamps = found.run.times
            if stamps is not None and there.any():
                late = found.arm.delay_of("camera.delay") or 0.0
                axes[k].plot(stamps - late, shown, ".", color=GREY, ms=2, label="measured")
        for states, line, label in (
            (found.filtered, {"color": BLUE, "lw": 0.8, "ls": "--"}, "filter"),
            (found.smoothed, {"color": VERMILLION, "lw": 1.6}, "smoother"),
        ):
            _band(axes[k], times, states.tip[:, k], states.tip_deviations[:, k], line, label)
        plain(axes[k], "", "", f"tip {axis} (m)")
    axes[0].legend(fontsize=8, frameon=False, ncols=3)
    if blows:
        lines = ((GREY, ":"), (BLUE, "-"), (VERMILLION, "--"))
        for k, (axis, (colour, style)) in enumerate(zip("xyz", lines, strict=True)):
            wind, spread = found.smoothed.wind, found.smoothed.wind_deviations
            assert wind is not None
            assert spread is not None
            line = {"color": colour, "ls": style, "lw": 1.2}
            _band(axes[3], times, wind[:, k], spread[:, k], line, axis)
        plain(axes[3], "", "", "mean wind\nof the links (m/s)")
        axes[3].legend(fontsize=8, frameon=False, ncols=3)
    whitened = np.where(found.there, found.whitened, np.nan)
    axes[-1].plot(times, whitened, ".", color=BLUE, ms=2)
    for level in (-2, 2):
        axes[-1].axhline(level, color=GREY, lw=0.8, ls=":")
    plain(axes[-1], "", "time (s)", "innovations\n(standard deviations)")
    return figure


def _band(axes: Any, times: Any, mean: Any, spread: Any, line: Any, label: str) -> None:
    low, high = mean - BAND * spread, mean + BAND * spread
    axes.fill_between(times, low, high, color=line["color"], alpha=0.2, lw=0)
    axes.plot(times, mean, label=label, **line)


def estimate_columns(found: Track) -> dict[str, np.ndarray]:
    """Return the smoothed states as columns of a run: commands, wind, angles, rates and tip, SI.

    A tracked wind is the mean over the links.
    """
    states, joints = found.smoothed, range(found.arm.joints)
    stamps, run = np.asarray(found.run.times), found.run
    held = run.definition.section(CommandSection).interpolation == "zoh"
    at = np.maximum(np.searchsorted(stamps, found.times, side="right") - 1, 0)
    columns = {
        name: column[at] if held else np.interp(found.times, stamps, column)
        for name, column in run.commands.items()
    }
    columns |= {name: np.interp(found.times, stamps, run.values[name]) for name in run.winds}
    if states.wind is not None:
        columns |= {f"wind_{axis}": states.wind[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"joint{k + 1:02d}_angle": states.angles[:, k] for k in joints}
    columns |= {f"joint{k + 1:02d}_rate": states.rates[:, k] for k in joints}
    columns |= {f"tip_{axis}": states.tip[:, k] for k, axis in enumerate("xyz")}
    return columns


def estimate_definition(found: Track) -> dict[str, Any]:
    """Return the sidecar of the smoothed states: the arm, with the first row as initial state."""
    arm = found.arm.model.definition()["arm"]
    origin = f"giajax track of {found.run.name}"
    held = found.run.definition.section(CommandSection).interpolation
    return {
        "model": "arm",
        "origin": origin,
        "arm": arm,
        "initial": {"first_row": True},
        "command": {"interpolation": held},
    }


def band_columns(found: Track) -> dict[str, np.ndarray]:
    """Return filtered, smoothed and predicted estimates with standard deviations as columns.

    The names of the columns end in their unit.
    """
    columns: dict[str, np.ndarray] = {"time_s": found.times}
    kinds = {"filtered": found.filtered, "smoothed": found.smoothed}
    if found.now is not None:
        columns["known_at_s"] = found.now_times
        kinds["known"] = found.now
    for kind, states in kinds.items():
        for name, (mean, spread, unit, factor) in _quantities(states).items():
            columns[f"{kind}_{name}_{unit}"] = factor * mean
            columns[f"{kind}_{name}_deviation_{unit}"] = factor * spread
    for link in range(found.arm.joints):
        for k, axis in enumerate("xyz"):
            mean, deviation = end_columns(link, axis)
            columns[mean] = found.smoothed.ends[:, link, k]
            columns[deviation] = found.smoothed.end_deviations[:, link, k]
    return columns


def end_columns(link: int, axis: str) -> tuple[str, str]:
    """Return the column names of the end of a link (from 0) and of its standard deviation, m."""
    name = f"smoothed_link{link + 1:02d}_end_{axis}"
    return f"{name}_m", f"{name}_deviation_m"


def _quantities(states: States) -> dict[str, tuple[Any, Any, str, float]]:
    found: dict[str, tuple[Any, Any, str, float]] = {}
    for k, axis in enumerate("xyz"):
        found[f"tip_{axis}"] = (states.tip[:, k], states.tip_deviations[:, k], "m", 1.0)
    degree = float(np.rad2deg(1.0))
    for k in range(states.angles.shape[1]):
        name = f"joint{k + 1:02d}"
        spreads = states.angle_deviations[:, k], states.rate_deviations[:, k]
        found[f"{name}_angle"] = (states.angles[:, k], spreads[0], "deg", degree)
        found[f"{name}_rate"] = (states.rates[:, k], spreads[1], "deg_per_s", degree)
    if states.wind is not None and states.wind_deviations is not None:
        for k, axis in enumerate("xyz"):
            spread = states.wind_deviations[:, k]
            found[f"wind_{axis}"] = (states.wind[:, k], spread, "m_per_s", 1.0)
    for path, values in states.parameters.items():
        found[path] = (values, states.parameter_deviations[path], "SI", 1.0)
    for k in range(states.biases.shape[1]):
        found[f"bias{k + 1:02d}"] = (states.biases[:, k], states.bias_deviations[:, k], "SI", 1.0)
    return found


def heard_facts(heard: Heard) -> dict[str, Any]:
    """Return the estimate at one time of a live run as plain data."""
    now = heard.now
    facts = {
        "time_s": heard.time,
        "tip_m": now.tip[0].tolist(),
        "tip_deviation_m": now.tip_deviations[0].tolist(),
        "wind_m_per_s": None if now.wind is None else now.wind[0].tolist(),
        "parameters": {
            path: {
                "value": float(values[0]),
                "deviation": float(now.parameter_deviations[path][0]),
                "shown": path in heard.shown,
            }
            for path, values in now.parameters.items()
        },
        "nis": heard.nis,
        "changes": [dataclasses.asdict(change) for change in heard.changes],
    }
    found: dict[str, Any] = plain_data(facts)
    return found


def heard_line(heard: Heard) -> str:
    """Return the estimate at one time of a live run as a line, preceded by a line per change."""
    now = heard.now
    tip = " ".join(f"{each:.3f}" for each in now.tip[0])
    parts = [
        f"{heard.time:8.1f} s",
        f"tip {tip} m +- {float(np.linalg.norm(now.tip_deviations[0])):.2g}",
    ]
    if now.wind is not None:
        parts.append("wind " + " ".join(f"{each:.2f}" for each in now.wind[0]) + " m/s")
    for path, values in now.parameters.items():
        spread = float(now.parameter_deviations[path][0])
        hidden = "" if path in heard.shown else " (not yet determined)"
        parts.append(f"{path} {float(values[0]):.4g} +- {spread:.2g}{hidden}")
    parts += [] if heard.nis is None else [f"NIS {heard.nis:.2f}"]
    return "\n".join([*map(change_sentence, heard.changes), "  ".join(parts)])


def change_sentence(change: Change) -> str:
    """Return the description of a detected change in one sentence."""
    way = "fallen" if change.size < 0 else "risen"
    return (
        f"changed: {change.path} has {way} by {abs(change.size):.2g} +- {change.deviation:.1g} at "
        f"about {change.time:.1f} s (detected at {change.found:.1f} s)"
    )


TRACK_HEADINGS = (
    *("state", "unit", "final estimate", "standard deviation"),
    "mean standard deviation, smoothed",
)


def track_rows(found: Track) -> list[tuple[str, ...]]:
    """Return rows for tip, wind, parameters, biases, and the joint with the largest uncertainty."""
    return [
        (name, unit, *format_estimate(mean, spread), format_estimate(mean, after)[1])
        for name, unit, mean, spread, after in _final(found)
    ]


def _final(found: Track) -> list[tuple[str, str, float, float, float]]:
    """Return names, units, final estimates, and deviations: final ones and means when smoothed."""
    rows: list[tuple[str, str, float, float, float]] = []
    smooth = _quantities(found.smoothed)
    latest = found.filtered
    least = int(np.argmax(latest.angle_deviations[-1]))
    for name, (mean, spread, unit, factor) in _quantities(latest).items():
        if name.startswith("joint") and name != f"joint{least + 1:02d}_angle":
            continue
        words = name if not name.startswith("joint") else f"{name} (largest uncertainty)"
        after = float(factor * np.mean(smooth[name][1]))
        unit = unit.replace("_per_", "/")
        if name in latest.parameters:
            unit = find(found.arm.model, name).declaration.unit or "-"
        rows.append((words, unit, float(factor * mean[-1]), float(factor * spread[-1]), after))
    return rows


def track_facts(found: Track, verdict: TrackVerdict, hidden: Hidden = ()) -> dict[str, Any]:
    """Return the results of a track as plain data."""
    return {
        "run": found.run.name,
        "sha256": found.run.sha256,
        "channels": dict(
            zip(found.arm.channels, np.asarray(found.arm.noise).tolist(), strict=True)
        ),
        "states": found.arm.sizes(),
        "considered": dict(found.unknown.considered),
        "estimated": dict(found.unknown.estimated),
        "torque_n_m_root_s": float(found.arm.torque),
        "latency_s": found.latency,
        "events": len(found.times),
        "seconds_per_event": found.seconds,
        "log_likelihood": float(np.sum(found.log_likelihood)),
        "changes": [dataclasses.asdict(change) for change in found.changes],
        "verdict": {
            "adequate": verdict.adequate,
            "sentence": verdict.sentence,
            "nis": verdict.nis,
            "nis_with_outliers": float(np.sum(found.nis) / np.sum(found.there)),
            "nis_error": verdict.nis_error,
            "correlation": verdict.correlation,
            "left_out": verdict.left_out,
            "tried": list(verdict.tried),
            "causes": [
                {"name": c.name, "gain": c.gain, "advice": c.advice, "value": c.value}
                for c in verdict.causes
            ],
        },
        "at_the_end": [
            {"state": row[0], "unit": row[1], "value": row[2], "deviation": row[3]}
            for row in _final(found)
        ],
        "hardly_seen": [
            {"state": name, "before": before, "after": after} for name, before, after in hidden
        ],
    }


def track_notes(found: Track, verdict: TrackVerdict, hidden: Hidden = ()) -> list[str]:
    """Return notes on a track, each a sentence."""
    notes = [
        f"{cause.name}: log-likelihood +{cause.gain:.3g}; {cause.advice}"
        for cause in verdict.causes[1:]
    ]
    if found.loosened > 1:
        notes.append(
            "the state estimate diverged with the default value of the unmodelled torque, so "
            f"{found.loosened} times this value was used: the model may lack an effect such as wind"
        )
    notes += [change_sentence(change) for change in found.changes]
    if found.changes and not verdict.adequate:
        notes.append("detected changes are not reliable, because the track is not adequate")
    changed = {change.path: change.time for change in found.changes}
    for path, before in found.unknown.estimated.items():
        if found.smoothed.parameter_deviations[path][-1] > SHOWN * before:
            since = f" after {changed[path]:.1f} s" if path in changed else ""
            notes.append(
                f"this run has no information on {path}{since}: the arm is at rest, or moves in "
                "another direction"
            )
    if hidden:
        names = [name for name, _, _ in hidden]
        notes.append(
            f"these channels contain little information on {', '.join(names[:_NAMED])}"
            + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
            + ": their uncertainty is hardly reduced"
        )
    if verdict.left_out > 0:
        notes.append(f"{verdict.left_out:.2%} of the measurements were rejected as outliers")
    if found.now is not None:
        known = float(np.sqrt(np.mean(np.sum(found.now.tip_deviations**2, axis=1))))
        notes.append(
            f"measurements arrive {found.now_times[0] - found.times[0]:.2g} s late; when they "
            f"arrive, the position of the tip is known to within {known:.2g} m"
        )
    return notes


def track_sections(
    found: Track, verdict: TrackVerdict, hidden: Hidden = ()
) -> tuple[list[tuple[str, Table, str]], list[str]]:
    """Return the tables of a page, each with its heading and note, and the notes on the track."""
    rows = [[*row] for row in track_rows(found)]
    states = Table([*TRACK_HEADINGS], rows, 2)
    sound = Table(
        ["", "value", "expected"],
        [
            ["NIS per measurement", f"{verdict.nis:.3f}", f"1 +- {4 * verdict.nis_error:.3f}"],
            ["largest correlation", f"{verdict.correlation:.3f}", "0"],
            ["outliers, %", f"{100 * verdict.left_out:.2f}", "0"],
            ["explanations tried", ", ".join(verdict.tried) or "none", ""],
        ],
    )
    tables = [
        (
            "States",
            states,
            "Final estimates and their standard deviations are those of the filter.",
        ),
        (
            "Innovations",
            sound,
            "Measured minus expected values, divided by their expected standard deviations.",
        ),
    ]
    return tables, track_notes(found, verdict, hidden)
