"""Checks of a run's content, the same for a file and for arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from .._limits import VALUE
from ..kinds import KINDS, Kind
from ._channels import Channel, parse_column
from ._column_table import TEXTS
from ._definition import Definition
from ._times import check_times
from ._wording import Wording


@dataclass(frozen=True)
class _Content:
    """What a kind of model checks; see `giajax.kinds.Content`."""

    times: npt.NDArray[np.float64] | None
    values: Mapping[str, npt.NDArray[Any]]
    channels: Mapping[str, Channel]
    definition: Definition


def check_content(
    model: str,
    times: npt.NDArray[np.float64] | None,
    values: Mapping[str, npt.NDArray[Any]],
    channels: Mapping[str, Channel],
    definition: Definition,
    wording: Wording,
) -> None:
    """Raise `InputError` for the first thing in a run that no model could use."""
    kind = KINDS[model]
    _check_lengths(kind, times, values, channels, wording)
    if times is not None:
        check_times(times, wording, integrated=kind.timed)
    for name, channel in channels.items():
        if channel.quantity == "text":
            _check_text(values[name], channel, wording)
        else:
            # What acts on a model must be known at every sample; only measurements may be missing.
            gaps = channel.kind in kind.outputs
            _check_numbers(values[name], channel, wording, gaps=gaps)
    for column in definition.noise.columns:
        if parse_column(column).name not in {
            name for name, channel in channels.items() if channel.kind in kind.outputs
        }:
            raise InputError(
                f"{wording.source}: noise is stated for {column!r}, which must be a measured "
                "column of the run: correct or remove that key"
            )
    kind.check(_Content(times, values, channels, definition), wording)


def _check_lengths(
    kind: Kind,
    times: npt.NDArray[np.float64] | None,
    values: Mapping[str, npt.NDArray[Any]],
    channels: Mapping[str, Channel],
    wording: Wording,
) -> None:
    if times is None and kind.timed:
        run = f"{'an' if kind.name[0] in 'aeiou' else 'a'} {kind.name} run"
        raise InputError(
            f"{wording.source} has no time column: {run} must have time_s or time_ms, "
            "so add or --rename it"
            if wording.columns
            else f"{wording.source} has no times: {run} must have them, so give them"
        )
    length = len(next(iter(values.values()))) if times is None else len(times)
    for name, array in values.items():
        if len(array) != length:
            raise InputError(
                f"{wording.source}: {wording.of(channels[name])} has {len(array)} samples, but "
                f"must have {length} like the others: give it at every sample, NaN where missing"
            )
    least = 1 if times is None else 2
    if length < least:
        raise InputError(
            f"{wording.source} has {length} sample{'s' * (length != 1)}, but must have at least "
            f"{least}: give a longer run"
        )


def _check_text(array: npt.NDArray[Any], channel: Channel, wording: Wording) -> None:
    allowed = TEXTS[channel.kind]
    for index, text in enumerate(array):
        if text not in allowed:
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is {text!r} in {wording.at(index)}, but "
                f"must be {' or '.join(allowed)} everywhere: correct it"
            )


def _check_numbers(
    array: npt.NDArray[Any], channel: Channel, wording: Wording, *, gaps: bool
) -> None:
    missing = np.isnan(array)
    if missing.all():
        raise InputError(
            f"{wording.source}: {wording.of(channel)} has no value at all: "
            "it must have at least one, so fill or remove it"
        )
    bad = np.flatnonzero(np.isinf(array))
    if bad.size:
        raise InputError(
            f"{wording.source}: {wording.of(channel)} is infinite in {wording.at(bad[0])}, but "
            "must be a finite number or empty: correct it"
        )
    bad = np.flatnonzero(np.abs(array) > VALUE)
    if bad.size:
        raise InputError(
            f"{wording.source}: {wording.of(channel)} is {channel.from_si(array[bad[0]]):.3g} in "
            f"{wording.at(bad[0])}, but no value of a recording is so large: correct or empty it"
        )
    bad = np.flatnonzero(missing)
    if bad.size and not gaps:
        raise InputError(
            f"{wording.source}: {wording.of(channel)} is empty in {wording.at(bad[0])}, but what "
            "drives the model must be known at every sample: fill the gap"
        )
