"""Checks of a run's content, the same for a file and for arrays."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from .._errors import InputError
from ._channels import TEXTS, Channel, parse_column
from ._definition import Definition
from ._model import GIVEN, PREDICTED

DEFAULT_PRESET = "takeichi_20m"
DEFAULT_LINKS = 20

# A model needs these at every sample; a gap in them is not a missing measurement.
_WITHOUT_GAPS = {
    "arm": ("joint_command", "joint_torque", "wind"),
    "hysteresis": ("input", "command"),
    "joint": GIVEN["joint"],
    "muscle": GIVEN["muscle"],
}


@dataclass(frozen=True)
class Wording:
    """How errors name the parts of a run: `row 5` and columns of a file, samples of arrays."""

    source: str
    row: str
    first_row: int
    columns: bool

    def at(self, index: Any) -> str:
        """The row of the sample with this index."""
        return f"{self.row} {int(index) + self.first_row}"

    def of(self, channel: Channel) -> str:
        """The name that the person gave the channel."""
        return f"column {channel.column!r}" if self.columns else f"channel {channel.name!r}"


def links_of(definition: Definition) -> int | None:
    """The number of links that a definition states or its preset has; None if not known here."""
    if definition.arm.links is not None:
        return definition.arm.links
    return DEFAULT_LINKS if definition.arm.preset in (None, DEFAULT_PRESET) else None


def check_content(
    model: str,
    times: npt.NDArray[np.float64] | None,
    values: Mapping[str, npt.NDArray[Any]],
    channels: Mapping[str, Channel],
    definition: Definition,
    wording: Wording,
) -> None:
    """Raise `InputError` for the first thing in a run that no model could use."""
    _check_lengths(model, times, values, channels, wording)
    if times is not None:
        check_times(times, wording)
    for name, channel in channels.items():
        if channel.quantity == "text":
            _check_text(values[name], channel, wording)
        else:
            gaps = channel.kind not in _WITHOUT_GAPS[model]
            _check_numbers(values[name], channel, wording, gaps=gaps)
    for column in definition.noise.columns:
        if parse_column(column).name not in {
            name for name, channel in channels.items() if channel.kind in PREDICTED[model]
        }:
            raise InputError(
                f"{wording.source}: noise is stated for {column!r}, which must be a measured "
                "column of the run: correct or remove that key"
            )
    if model == "arm":
        _check_arm(channels, definition, wording)
    if model == "joint":
        _check_joint(values, channels, wording)
    if model == "muscle":
        _check_muscle(times, channels, definition, wording)


def check_times(times: npt.NDArray[np.float64], wording: Wording) -> None:
    """Raise `InputError` unless times are finite and strictly increasing."""
    bad = np.flatnonzero(~np.isfinite(times))
    if bad.size:
        state = "infinite" if np.isinf(times[bad[0]]) else "empty"
        raise InputError(
            f"{wording.source}: time in {wording.at(bad[0])} is {state}, but every sample must "
            "have its time: complete or remove it"
        )
    bad = np.flatnonzero(np.diff(times) <= 0)
    if bad.size:
        at = bad[0] + 1
        raise InputError(
            f"{wording.source}: time goes from {times[at - 1]:.9g} s to {times[at]:.9g} s in "
            f"{wording.at(at)}, but must strictly increase: sort the samples and remove repeated "
            "ones"
        )


def _check_lengths(
    model: str,
    times: npt.NDArray[np.float64] | None,
    values: Mapping[str, npt.NDArray[Any]],
    channels: Mapping[str, Channel],
    wording: Wording,
) -> None:
    if times is None and model == "arm":
        raise InputError(
            f"{wording.source} has no time column: an arm run must have time_s or time_ms, "
            "so add or --rename it"
            if wording.columns
            else f"{wording.source} has no times: an arm run must have them, so give them"
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
    bad = np.flatnonzero(missing)
    if bad.size and not gaps:
        raise InputError(
            f"{wording.source}: {wording.of(channel)} is empty in {wording.at(bad[0])}, but what "
            "drives the model must be known at every sample: fill the gap"
        )


def _check_arm(channels: Mapping[str, Channel], definition: Definition, wording: Wording) -> None:
    links = links_of(definition)
    for channel in channels.values():
        if links is not None and channel.index is not None and channel.index > links:
            part = "link" if channel.kind == "link_position" else "joint"
            raise InputError(
                f"{wording.source}: {wording.of(channel)} is of {part} {channel.index}, but the "
                f"arm has {links} links: correct the name, or state links in [arm]"
            )
    try:
        definition.arm.check_lists(links)
    except ValueError as error:
        raise InputError(f"{wording.source}: [arm] {error}") from None
    initial = definition.initial
    for key in ("angle_deg", "rate_deg_per_s"):
        value = getattr(initial, key)
        if isinstance(value, list) and links is not None and len(value) != links:
            raise InputError(
                f"{wording.source}: initial.{key} has {len(value)} values, but must have one for "
                f"each of the {links} joints: correct the list"
            )
    commanded = any(channel.kind in GIVEN["arm"] for channel in channels.values())
    stated = bool(definition.free_motion)
    if commanded and stated:
        raise InputError(
            f"{wording.source}: free_motion = true is stated, but there are command columns: "
            "remove one or the other"
        )
    has_initial = bool(initial.first_row) or bool(initial.free)
    has_initial |= initial.angle_deg is not None or initial.rate_deg_per_s is not None
    if not commanded and not stated and not has_initial:
        raise InputError(
            f"{wording.source} has no command column: an arm run must have one such as "
            "joint01_command_deg, or a sidecar with free_motion = true or [initial], so add it"
        )
    windy = [channel for channel in channels.values() if channel.kind == "wind"]
    if windy and definition.wind.velocity_m_per_s is not None:
        raise InputError(
            f"{wording.source}: wind.velocity_m_per_s states a constant wind, but "
            f"{wording.of(windy[0])} records it: remove one or the other"
        )


def _check_joint(
    values: Mapping[str, npt.NDArray[Any]], channels: Mapping[str, Channel], wording: Wording
) -> None:
    for name, column in (("angle", "angle_deg"), ("side", "side")):
        if name not in channels:
            raise InputError(
                f"{wording.source} has no {name}: a joint run must have one for each sample, so "
                f"add the column {column}"
            )
    angle, side = values["angle"], values["side"]
    wrong = np.flatnonzero(((side == "inner") & (angle < 0)) | ((side == "outer") & (angle > 0)))
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{wording.source}: in {wording.at(row)} the muscle is the {side[row]} one at "
            f"{np.rad2deg(angle[row]):.4g} deg, but the angle must be positive where the joint "
            "bends towards the muscle (inner): correct the side or the sign"
        )
    beyond = np.flatnonzero(np.abs(angle) > np.pi / 2)
    if beyond.size:
        row = beyond[0]
        raise InputError(
            f"{wording.source}: {wording.of(channels['angle'])} is {np.rad2deg(angle[row]):.4g} "
            f"deg in {wording.at(row)}, but a joint bends by at most 90 deg: correct it"
        )


def _check_muscle(
    times: npt.NDArray[np.float64] | None,
    channels: Mapping[str, Channel],
    definition: Definition,
    wording: Wording,
) -> None:
    if "pressure" not in channels:
        raise InputError(
            f"{wording.source} has no pressure: a muscle run must have one for each sample, so "
            "add a column such as pressure_kPa"
        )
    stated = definition.muscle
    moves = {"contraction", "position"} & set(channels)
    if stated.law != "piston" and not moves:
        raise InputError(
            f"{wording.source} has neither contraction nor position: a muscle's force depends on "
            "how far it has shortened, so add a column such as contraction"
        )
    friction = stated.friction or ("coulomb" if stated.law == "piston" else "none")
    directed = "phase" in channels or (moves and times is not None)
    if friction == "coulomb" and not directed:
        raise InputError(
            f"{wording.source}: friction needs the direction of motion, from a phase column, or "
            'from time and position: add them, or state friction = "none" in [muscle]'
        )
