"""What a summary says of what was held out of a fit."""

import math

from ..fitting import FitResult, HeldOut


def held_out_lines(result: FitResult) -> list[str]:
    """How well what was held out of each run is predicted."""
    return [line for record in result.held_out for line in _lines(record)]


def _lines(record: HeldOut) -> list[str]:
    by_unit: dict[str, list[str]] = {}
    for name, channel in record.channels.items():
        by_unit.setdefault(channel.unit, []).append(name)
    lines = []
    for unit, names in by_unit.items():
        channels = [record.channels[name] for name in names]
        errors = _range([channel.rmse for channel in channels]) or "not known"
        if len(names) <= 4:
            each = [f"{n} {_range([record.channels[n].rmse]) or 'not known'}" for n in names]
            errors = ", ".join(each)
        sizes = _range([channel.size for channel in channels])
        values = sum(channel.n for channel in channels)
        lines.append(
            f"{record.name}: RMSE {errors}{f' {unit}' if unit else ''}"
            + (f"; {sizes} times what noise and the parameters allow" if sizes else "")
            + f"; {len(names)} channel{'s' * (len(names) > 1)}, {values} values"
        )
    return lines


def _range(values: list[float | None]) -> str:
    """The smallest and the largest of what is known and finite; empty where nothing is."""
    known = sorted(value for value in values if value is not None and math.isfinite(value))
    if not known:
        return ""
    low, high = f"{known[0]:.3g}", f"{known[-1]:.3g}"
    return low if low == high else f"{low} to {high}"
