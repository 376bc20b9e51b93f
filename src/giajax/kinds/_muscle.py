"""A muscle or a cylinder: from pressure and contraction to force."""

from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from .._errors import InputError
from ..quantities import AT_REST, BRAIDED, EMPIRICAL, FRICTION, PISTON
from ._content import Content, Wording
from ._keys import with_keys
from ._kind import ChannelKind, Kind
from ._section import NotNegative, Section, key


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


def _recognises(rows: frozenset[str]) -> bool:
    return "pressure" in rows


def _drawn_over(content: Content) -> str | None:
    """The contraction of a muscle, the position of a piston; else the pressure."""
    moving = ("contraction", "position", "pressure")
    recorded = [name for name in moving if name in content.values]
    return next((name for name in recorded if np.ptp(content.values[name]) > 0), None)


def _check(content: Content, wording: Wording) -> None:
    channels, section = content.channels, content.definition.section(MuscleSection)
    if "pressure" not in channels:
        raise InputError(
            f"{wording.source} has no pressure: a muscle run must have one for each sample, so "
            "add a column such as pressure_kPa"
        )
    moves = {"contraction", "position"} & set(channels)
    if section.law != "piston" and not moves:
        raise InputError(
            f"{wording.source} has neither contraction nor position: a muscle's force depends on "
            "how far it has shortened, so add a column such as contraction"
        )
    friction = section.friction or ("coulomb" if section.law == "piston" else "none")
    directed = "phase" in channels or (moves and content.times is not None)
    if friction == "coulomb" and not directed:
        raise InputError(
            f"{wording.source}: friction needs the direction of motion, from a phase column, or "
            'from time and position: add them, or state friction = "none" in [muscle]'
        )


def _notes(content: Content, sidecar: bool) -> list[str]:
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
    recognises=_recognises,
    measured="force_N",
    sections={"muscle": MuscleSection},
    drawn_over=_drawn_over,
    check=_check,
    notes=_notes,
)
