"""A joint at rest: from the angle, the side and the torque to contraction and force."""

from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from .._errors import InputError
from ..quantities import ALPHA, BETA, GEOMETRY, LOAD
from ._content import Content, Wording
from ._keys import with_keys
from ._kind import ChannelKind, Kind
from ._section import Section, key


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


def _recognises(rows: frozenset[str]) -> bool:
    return "side" in rows


def _drawn_over(content: Content) -> str | None:
    """The bending angle, where it varies."""
    return "angle" if np.ptp(content.values["angle"]) > 0 else None


def _check(content: Content, wording: Wording) -> None:
    values, channels = content.values, content.channels
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


def _notes(content: Content, sidecar: bool) -> list[str]:
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
    recognises=_recognises,
    measured="contraction or force_N",
    sections={"joint": JointSection},
    drawn_over=_drawn_over,
    check=_check,
    notes=_notes,
)
