"""Hysteresis: from the history of an input to that of an output, at rest."""

from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from .._limits import ELEMENTS
from ._content import Content
from ._kind import ChannelKind, Kind
from ._section import COUNT, Count, Finite, Positive, Section, key

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
        _EITHER,
        "dead zones of the modified form above 0 (SI), or how many, densest at 0",
        preset=5,
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


def _recognises(rows: frozenset[str]) -> bool:
    return {"command", "angle"} <= rows or {"input", "output"} <= rows


def _drawn_over(content: Content) -> str | None:
    """The input, where it varies: it makes loops."""
    names = [c.name for c in content.channels.values() if c.kind in HYSTERESIS.inputs]
    return next((name for name in names if np.ptp(content.values[name]) > 0), None)


def _notes(content: Content, sidecar: bool) -> list[str]:
    if content.definition.section(HysteresisSection).operator is not None:
        return []
    return ["operator not stated in [hysteresis]: Prandtl-Ishlinskii of ten is assumed"]


HYSTERESIS = Kind(
    name="hysteresis",
    model="_hysteresis:HysteresisModel",
    channels=CHANNELS,
    recognises=_recognises,
    measured="output or angle_deg",
    sections={"hysteresis": HysteresisSection},
    commands=("input", "command"),
    drawn_over=_drawn_over,
    notes=_notes,
)
