"""Noise of channels: standard deviations as `[noise]` states them, and in SI units."""

from collections.abc import Mapping
from typing import Any

from .._errors import InputError
from ._channels import Channel, parse_column
from ._column_table import NOISE_KEYS
from ._fit_sections import Noise
from ._units import QUANTITY_OF_SUFFIX, from_si, to_si

# Noise of arrays goes by quantity, without the unit that ends the key in a file.
_NOISE_QUANTITIES = {
    key.partition("_")[0]: key for key in Noise.model_fields if "_correlat" not in key
}


def deviation_of(noise: Noise, channel: Channel) -> float | None:
    """The standard deviation (SI) that `[noise]` states for a channel, or None."""
    for column, deviation in noise.columns.items():
        if column.startswith(channel.name):
            recorded = parse_column(column)
            if recorded.name == channel.name:
                return float(recorded.to_si(deviation))
    key = NOISE_KEYS.get(channel.kind)
    of_quantity = None if key is None else getattr(noise, key)
    if key is None or of_quantity is None:
        return None
    return float(to_si(*_unit_of(key), of_quantity))


def correlated_part_of(noise: Noise, channel: Channel) -> tuple[float, float] | None:
    """The deviation (SI) and the time (s) of the part with a memory, as `[noise]` states it."""
    key = NOISE_KEYS.get(channel.kind)
    # A column that states its own noise is not that of its quantity.
    if any(parse_column(column).name == channel.name for column in noise.columns):
        return None
    part = None if key is None else noise.correlated_part(key)
    if key is None or part is None:
        return None
    deviation, time_s = part
    return float(to_si(*_unit_of(key), deviation)), time_s


def _unit_of(key: str) -> tuple[str, str]:
    """Quantity and unit of a key of `[noise]`, which ends in its unit."""
    unit = key.partition("_")[2]
    return QUANTITY_OF_SUFFIX[unit], unit


def noise_section(noise: Mapping[str, float], channels: Mapping[str, Channel]) -> dict[str, Any]:
    """The `[noise]` section of standard deviations (SI) by quantity or by channel.

    Raises:
        InputError: another name.
    """
    section: dict[str, Any] = {}
    for name, deviation in noise.items():
        if name in _NOISE_QUANTITIES:
            key = _NOISE_QUANTITIES[name]
            section[key] = float(from_si(*_unit_of(key), deviation))
        elif name in channels:
            section[channels[name].column] = float(channels[name].from_si(deviation))
        else:
            raise InputError(
                f"{name!r} has no noise: give that of {', '.join(_NOISE_QUANTITIES)} "
                "or of a channel of the run"
            )
    return section
