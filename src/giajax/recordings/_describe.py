"""Describe the contents of a run as plain data that a person can check."""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt

from ..schema import WindSection
from ._plausible import oddities
from ._read import sidecar_path
from ._run import Run


def describe(run: Run) -> dict[str, Any]:
    """Return a description of a run as plain data (dicts, lists, str, int, float, bool, None).

    The keys are `name`, `path`, `model`, `rows`, `time` (s), `command`, `wind`, `channels` (each in
    its recorded unit), `sidecar`, `oddities` (each `Oddity` as a dict) and `notes`: sentences about
    these and about assumptions that replace missing information.
    """
    odd = oddities(run)
    rows = len(run.times) if run.times is not None else len(next(iter(run.values.values())))
    return {
        "name": run.name,
        "path": None if run.path is None else str(run.path),
        "model": run.model,
        "rows": rows,
        "time": None if run.times is None else _time(run.times),
        "command": _command(run),
        "wind": _wind(run),
        "channels": [_channel(run, name) for name in run.channels],
        "sidecar": _sidecar(run),
        "oddities": [dataclasses.asdict(each) for each in odd],
        "notes": [*map(str, odd), *_notes(run)],
    }


def _time(times: npt.NDArray[np.float64]) -> dict[str, float]:
    steps = np.diff(times)
    return {
        "start_s": float(times[0]),
        "end_s": float(times[-1]),
        "duration_s": float(times[-1] - times[0]),
        "interval_median_s": float(np.median(steps)),
        "interval_min_s": float(steps.min()),
        "interval_max_s": float(steps.max()),
    }


def _command(run: Run) -> dict[str, Any] | None:
    commands = {
        name: array
        for name, array in run.commands.items()
        if run.channels[name].kind in run.kind.commands
    }
    if not commands:
        return None
    interpolation = run.kind.interpolation(run)
    steps = np.arange(len(next(iter(commands.values())))) if run.times is None else run.times
    return {
        "channels": list(commands),
        "joints": [run.channels[name].index for name in commands if run.channels[name].index],
        "moving": [name for name, array in commands.items() if np.ptp(array) > 0],
        "interpolation": interpolation,
        "corners": _corners(steps, np.stack(list(commands.values()), axis=1), interpolation),
    }


def _corners(times: npt.NDArray[Any], values: npt.NDArray[Any], interpolation: str) -> int:
    """Return the number of rows where a command jumps (zoh) or changes slope; 0 if it is smooth."""
    if interpolation == "band_limited":
        return 0
    if interpolation == "zoh":
        return int(np.any(np.diff(values, axis=0) != 0, axis=1).sum())
    slopes = np.diff(values, axis=0) / np.diff(times)[:, None]
    # A ramp recorded with six digits changes its slope by one part in 1e4 from row to row.
    bends = np.abs(np.diff(slopes, axis=0)) > 1e-3 * np.abs(slopes).max(initial=0.0)
    return int(np.any(bends, axis=1).sum())


def _wind(run: Run) -> dict[str, Any] | None:
    section = run.definition.section(WindSection)
    constant = section.velocity_m_per_s
    if constant is not None:
        return {"source": "constant", "velocity_m_per_s": list(constant)}
    if run.winds:
        return {
            "source": "columns",
            "channels": list(run.winds),
            "interpolation": section.interpolation,
        }
    return None


def _channel(run: Run, name: str) -> dict[str, Any]:
    channel, values = run.channels[name], run.values[name]
    facts: dict[str, Any] = {
        "name": name,
        "column": channel.column,
        "unit": channel.unit,
        "part": run.part_of(name),
    }
    if channel.quantity == "text":
        counts = {text: int((values == text).sum()) for text in sorted(set(values))}
        return {**facts, "count": len(values), "missing_percent": 0.0, "texts": counts}
    measured = values[~np.isnan(values)]
    noise = run.noise(name)
    return {
        **facts,
        "count": len(measured),
        "missing_percent": 100.0 * (1.0 - len(measured) / len(values)),
        # Adding zero turns -0.0 into 0.0.
        "min": float(channel.from_si(measured.min())) + 0.0,
        "max": float(channel.from_si(measured.max())) + 0.0,
        "noise": None if noise is None else float(channel.from_si(noise)),
    }


def _sidecar(run: Run) -> dict[str, Any] | None:
    if run.path is None or not sidecar_path(run.path).is_file():
        return None
    keys = []
    for name, value in run.definition.contents().items():
        if isinstance(value, dict) and name != "truth":
            keys += [f"{name}.{key}" for key in value]
        else:
            keys.append(name)
    return {
        "path": str(sidecar_path(run.path)),
        "keys": keys,
        "checksum": "not stated" if run.definition.sha256 is None else "matches",
    }


def _notes(run: Run) -> list[str]:
    notes = run.kind.notes(run, _sidecar(run) is not None)
    if not run.observations:
        notes.append("the run has no measured channel: it can be simulated, but not fitted")
    silent = [name for name in run.observations if run.noise(name) is None]
    if silent:
        which = "" if len(silent) == len(run.observations) else f" of {', '.join(silent)}"
        notes.append(f"the noise{which} is not specified: a fit estimates it")
    return notes
