"""The kinds of single parts: a joint at rest, a muscle, hysteresis, and an oscillator."""

from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from ..runtime.limits import ELEMENTS
from ..runtime.text import InputError
from ._declaration import COUNT, Count, Finite, NotNegative, Positive, Section, key, with_keys
from ._kind import ChannelKind, Kind, Naming, RecordedRun
from ._quantities_joint import (
    ALPHA,
    AT_REST,
    BETA,
    BRAIDED,
    EMPIRICAL,
    FRICTION,
    GEOMETRY,
    LOAD,
    PISTON,
)


@with_keys(LOAD, GEOMETRY, ALPHA, BETA)
class JointSection(Section):
    """`[joint]`: one joint with its muscle. Points are in the frame of their link."""

    correction: Literal["continuous", "printed", "none"] | None = key(
        '"continuous", "printed" or "none"',
        "alpha and beta read with the size of the angle, as printed (an erratum), or zero",
        preset="continuous",
    )
    blend_deg: Annotated[float, Field(ge=0, le=30, allow_inf_nan=False)] | None = key(
        "a number from 0 to 30", "half-width about 0 in which alpha and beta join", preset=0.0
    )


def _varying(*names: str) -> Callable[[RecordedRun], str | None]:
    """The first of these inputs that is recorded and varies."""

    def drawn_over(content: RecordedRun) -> str | None:
        recorded = [name for name in names if name in content.values]
        return next((name for name in recorded if np.ptp(content.values[name]) > 0), None)

    return drawn_over


def _check_joint(content: RecordedRun, naming: Naming) -> None:
    values, channels = content.values, content.channels
    for name, column in (("angle", "angle_deg"), ("side", "side")):
        if name not in channels:
            raise InputError(
                f"{naming.source} has no {name}: a joint run must have one for each sample, so "
                f"add the column {column}"
            )
    angle, side = values["angle"], values["side"]
    wrong = np.flatnonzero(((side == "inner") & (angle < 0)) | ((side == "outer") & (angle > 0)))
    if wrong.size:
        row = wrong[0]
        raise InputError(
            f"{naming.source}: in {naming.at(row)} the muscle is the {side[row]} one at "
            f"{np.rad2deg(angle[row]):.4g} deg, but the angle must be positive where the joint "
            "bends towards the muscle (inner): correct the side or the sign"
        )
    beyond = np.flatnonzero(np.abs(angle) > np.pi / 2)
    if beyond.size:
        row = beyond[0]
        raise InputError(
            f"{naming.source}: {naming.of(channels['angle'])} is {np.rad2deg(angle[row]):.4g} "
            f"deg in {naming.at(row)}, but a joint bends by at most 90 deg: correct it"
        )


def _joint_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    section, notes = content.definition.section(JointSection), []
    if not section.contents():
        notes.append("no [joint] in the sidecar: the geometry that giajax assumes is taken")
    if "torque" not in content.channels:
        torque = float(section.values().get(LOAD.torque.path, LOAD.torque.default))
        notes.append(f"torque not recorded: {torque:g} N m is taken")
    return notes


JOINT = Kind(
    name="joint",
    model="_joint:JointModel",
    channels=(
        ChannelKind("angle", "angle", "angle", "input"),
        ChannelKind("side", "side", "text", "input", texts=("inner", "outer")),
        ChannelKind("contraction", "contraction", "ratio", "output"),
        ChannelKind("force", "force", "force", "output"),
        ChannelKind("torque", "torque", "torque", "input"),
    ),
    recognises=lambda rows: "side" in rows,
    measured="contraction or force_N",
    sections={"joint": JointSection},
    drawn_over=_varying("angle"),
    check=_check_joint,
    notes=_joint_notes,
)


@with_keys(AT_REST, BRAIDED, EMPIRICAL, PISTON)
class _Law(Section):
    """Which law, and what it knows."""

    law: Literal["braided", "empirical", "piston"] | None = key(
        '"braided", "empirical" or "piston"',
        "statics of a braid, a normalised shape for any length, or a cylinder",
        preset="braided",
    )


@with_keys(FRICTION)
class MuscleSection(_Law):
    """`[muscle]`: which law, what is known of the muscle, and whether it has friction."""

    pressure: Literal["measured", "mean"] | None = key(
        '"measured" or "mean"',
        "the pressure at each row, or its mean, which was set where friction moves the gauge",
        preset="measured",
    )
    friction: Literal["coulomb", "none"] | None = key(
        '"coulomb" or "none"',
        "force between filling and exhausting; needs phase or time",
        preset="none",
    )
    friction_pressures_kPa: Annotated[list[NotNegative], Field(min_length=1)] | None = key(  # noqa: N815
        "a list of increasing numbers",
        "pressures at which friction has its half-widths, linear between them",
        preset=[0.0],
    )

    @field_validator("friction_pressures_kPa")
    @classmethod
    def _pressures_increase(cls, pressures: Any) -> Any:
        if pressures is not None and any(a >= b for a, b in pairwise(pressures)):
            raise ValueError(f"is {pressures}, but must increase: sort it, each pressure once")
        return pressures


def _check_muscle(content: RecordedRun, naming: Naming) -> None:
    channels, section = content.channels, content.definition.section(MuscleSection)
    if "pressure" not in channels:
        raise InputError(
            f"{naming.source} has no pressure: a muscle run must have one for each sample, so "
            "add a column such as pressure_kPa"
        )
    moves = {"contraction", "position"} & set(channels)
    if section.law != "piston" and not moves:
        raise InputError(
            f"{naming.source} has neither contraction nor position: a muscle's force depends on "
            "how far it has shortened, so add a column such as contraction"
        )
    friction = section.friction or ("coulomb" if section.law == "piston" else "none")
    directed = "phase" in channels or (moves and content.times is not None)
    if friction == "coulomb" and not directed:
        raise InputError(
            f"{naming.source}: friction needs the direction of motion, from a phase column, or "
            'from time and position: add them, or state friction = "none" in [muscle]'
        )


def _muscle_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    section, notes = content.definition.section(MuscleSection), []
    if section.law is None:
        notes.append("law not stated in [muscle]: a braided muscle is assumed")
    without = None if section.law == "piston" else "none"
    if "phase" in content.channels and (section.friction or without) == "none":
        notes.append("the phase is recorded, but [muscle] states no friction: it is not used")
    return notes


MUSCLE = Kind(
    name="muscle",
    model="_muscle:MuscleModel",
    channels=(
        ChannelKind("pressure", "pressure", "pressure", "input"),
        ChannelKind("contraction", "contraction", "ratio", "input"),
        ChannelKind("position", "position", "length", "input"),
        ChannelKind("phase", "phase", "text", "input", texts=("fill", "exhaust")),
        ChannelKind("force", "force", "force", "output"),
    ),
    recognises=lambda rows: "pressure" in rows,
    measured="force_N",
    sections={"muscle": MuscleSection},
    drawn_over=_varying("contraction", "position", "pressure"),
    check=_check_muscle,
    notes=_muscle_notes,
)


# Hysteresis: from the history of an input to that of an output, at rest.

CountOrPositive = Count | Annotated[list[Positive], Field(min_length=1)]
_EITHER = f"{COUNT}, or a list of positive numbers"


class HysteresisSection(Section):
    """`[hysteresis]`: the operator and its options, parameters apart. Values in SI units."""

    operator: (
        Literal["prandtl_ishlinskii", "modified_prandtl_ishlinskii", "preisach", "bouc_wen"] | None
    ) = key(
        "one of prandtl_ishlinskii, modified_prandtl_ishlinskii, preisach and bouc_wen",
        "the operator",
        preset="prandtl_ishlinskii",
    )
    elements: Literal["play", "stop"] | None = key(
        '"play" or "stop"', "what a Prandtl-Ishlinskii operator is made of", preset="play"
    )
    thresholds: CountOrPositive | None = key(
        _EITHER,
        "thresholds of its elements (SI), or how many there are, evenly up to half the input",
        preset=10,
    )
    upper_dead_zones: CountOrPositive | None = key(
        _EITHER, "dead zones of the modified form above 0 (SI), or how many, densest at 0", preset=5
    )
    lower_dead_zones: CountOrPositive | None = key(
        _EITHER, "the same below 0, as distances from it", preset=5
    )
    rows: Annotated[int, Field(ge=2, le=ELEMENTS)] | None = key(
        f"a whole number from 2 to {ELEMENTS}", "rows of the Preisach mesh", preset=40
    )
    input_range: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = key(
        "a list of two numbers, the lower one first",
        "range of the input (SI) that the operator covers; that of the runs unless stated",
        preset=[-1.0, 1.0],
    )
    previous_extremes: Count | Annotated[list[Finite], Field(min_length=1)] | None = key(
        f"{COUNT}, or a list of numbers",
        "turning points of the input before the run (SI), or how many a fit may find",
        preset=1,
    )

    @field_validator("input_range")
    @classmethod
    def _range_is_one(cls, ends: Any) -> Any:
        if ends is not None and not ends[0] < ends[1]:
            raise ValueError(f"is {ends}, but must have the lower number first: correct it")
        return ends


# Of the operator and of the oscillator, whose runs have the same columns.
CHANNELS = (
    ChannelKind("input", "input", None, "input"),
    ChannelKind("output", "output", None, "output"),
    ChannelKind("command", "command", "angle", "input"),
    ChannelKind("angle", "angle", "angle", "output", noise="angle_deg"),
)


def _hysteresis_drawn_over(content: RecordedRun) -> str | None:
    """The input, where it varies: it makes loops."""
    names = [c.name for c in content.channels.values() if c.kind in HYSTERESIS.inputs]
    return next((name for name in names if np.ptp(content.values[name]) > 0), None)


def _hysteresis_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    if content.definition.section(HysteresisSection).operator is not None:
        return []
    return ["operator not stated in [hysteresis]: Prandtl-Ishlinskii of ten is assumed"]


HYSTERESIS = Kind(
    name="hysteresis",
    model="_hysteresis:HysteresisModel",
    channels=CHANNELS,
    recognises=lambda rows: {"command", "angle"} <= rows or {"input", "output"} <= rows,
    measured="output or angle_deg",
    sections={"hysteresis": HysteresisSection},
    commands=("input", "command"),
    drawn_over=_hysteresis_drawn_over,
    notes=_hysteresis_notes,
)


class OscillatorSection(Section):
    """`[oscillator]`: the options of an oscillator, parameters apart."""

    interpolation: Literal["linear", "band_limited"] | None = key(
        '"linear" or "band_limited" (one period of evenly sampled rows)',
        "force between two rows",
        preset="linear",
    )


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Version 0.1 had the oscillator as an operator of `[hysteresis]`."""
    before = data.get("hysteresis")
    if not isinstance(before, dict) or before.get("operator") != "bouc_wen_oscillator":
        # A fit definition of that version names only the model, beside such a sidecar.
        renamed = data.get("model") == "hysteresis" and "oscillator" in data and not before
        return {**data, "model": "oscillator"} if renamed else data
    section = {name: value for name, value in before.items() if name == "interpolation"}
    upgraded = {name: value for name, value in data.items() if name != "hysteresis"}
    return {**upgraded, "model": "oscillator", "oscillator": section}


OSCILLATOR = Kind(
    name="oscillator",
    model="_oscillator:OscillatorModel",
    channels=CHANNELS,
    # Its columns are those of a hysteresis run: a sidecar must say which it is.
    recognises=lambda rows: False,
    measured="output or angle_deg",
    sections={"oscillator": OscillatorSection},
    commands=("input", "command"),
    timed=True,
    interpolation=lambda content: (
        content.definition.section(OscillatorSection).interpolation or "linear"
    ),
    former_parameters=frozenset({"previous_extremes"}),
    upgraded=_upgraded,
)
