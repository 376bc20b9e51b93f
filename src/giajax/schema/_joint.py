"""Kinds of single parts, with their quantities: joint, muscle, hysteresis, oscillator."""

from collections.abc import Callable
from itertools import pairwise
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, field_validator

from ..runtime.limits import ELEMENTS
from ..runtime.text import InputError
from ._declaration import (
    COUNT,
    Count,
    Declaration,
    Finite,
    Group,
    NotNegative,
    Positive,
    Section,
    freed,
    freed_guess,
    guess,
    key,
    left_out,
    positive,
    with_keys,
)
from ._kind import ChannelKind, Kind, Naming, RecordedRun

# Quantities of one joint: muscles, geometry, corrections, pressures, and hysteresis.

MUSCLE_LENGTH = 1.96
"""Length at rest of the muscle of a joint, m; assumed."""


def _pressure_limit(default: float, doc: str) -> Declaration:
    """Declare the pressure limit of a law; all laws share its key."""
    return guess(default, "Pa", doc).keyed("pressure_limit_kPa")


class _AtRest(Group):
    length = guess(MUSCLE_LENGTH, "m", "length of the muscle at rest").keyed("length_m")


class _Braided(Group):
    diameter = guess(3.5e-3, "m", "diameter of a braided muscle at rest").keyed("diameter_m")
    braid_angle = guess(
        float(np.deg2rad(18)),
        "rad",
        "angle between the braid and the axis of a muscle at rest (18 deg for thin muscles)",
        upper=float(np.arctan(np.sqrt(2))),
    ).keyed("braid_angle_deg")
    end_correction = freed_guess(
        1.6,
        "",
        "k: ratio of the contraction used in the ideal law to the actual contraction of the muscle",
    )
    effectiveness = freed_guess(
        1.0, "", "eta: ratio of the force of the muscle to the force of the ideal law"
    )
    dead_band = freed_guess(10e3, "Pa", "p_0: pressure below which the muscle exerts no force")
    pressure_limit = _pressure_limit(
        300e3, "maximum gauge pressure of the muscle (0.3 MPa for thin muscles)"
    )


class _Empirical(Group):
    force_limit = freed_guess(
        20.0, "N", "maximum force F_max of a very long muscle at the pressure limit"
    )
    contraction_limit = freed_guess(
        0.25, "", "contraction of an unloaded muscle at the pressure limit", upper=1
    )
    bell = freed_guess(
        1.0,
        "",
        "coefficient in the factor exp(-(bell e)^2) of the active force, where e is "
        "contraction / contraction_limit",
    )
    decay = freed_guess(
        4.0,
        "",
        "coefficient in the factor 1 - exp(-decay e) of the passive force, where e is "
        "contraction / contraction_limit",
    )
    end_length = Declaration(
        0.0075,
        "m",
        "total length of the muscle ends, which do not contribute to F_max",
        assumed=True,
    )
    length_scale = guess(
        0.05, "m", "length scale of the saturation of F_max as a function of muscle length"
    )
    pressure_limit = _pressure_limit(
        300e3, "maximum gauge pressure of the muscle, to which the relative pressure q refers"
    )


class _Piston(Group):
    bore = freed_guess(0.025, "m", "bore diameter of the piston's cylinder")
    offset = Declaration(
        0.0, "N", "force reading at zero pressure (offset of the load cell)", frozen=False
    )
    pressure_limit = _pressure_limit(1e6, "maximum gauge pressure of the piston's cylinder")


class _Friction(Group):
    half_width = freed_guess(
        1.0,
        "N",
        "half-width of the friction band: half of the force difference between filling and "
        "exhausting (one value for each pressure)",
    )
    presliding = freed_guess(
        2e-4, "m", "displacement from rest at which friction reaches its full value"
    )


AT_REST = _AtRest("")
BRAIDED = _Braided("muscle")
EMPIRICAL = _Empirical("muscle")
PISTON = _Piston("muscle")
FRICTION = _Friction("friction")


# A joint with muscles: geometry, torque, the corrections alpha and beta, and its drive.

_PER_SQUARE_DEGREE = float(np.rad2deg(1.0) ** 2)  # N m/deg^2 in N m/rad^2


def _along(key: str, default: float, doc: str, lower: float) -> Declaration:
    """Declare the coordinate of a point along its link; `_off` declares the other one."""
    return _coordinate(key, default, doc, 0, "coordinate along the link", lower)


def _off(key: str, default: float, doc: str, lower: float) -> Declaration:
    return _coordinate(key, default, doc, 1, "distance from the axis of the link", lower)


def _coordinate(
    key: str, default: float, doc: str, place: int, direction: str, lower: float
) -> Declaration:
    return Declaration(default, "m", f"{doc}: {direction}", lower=lower, assumed=True).keyed(
        key,
        lower=-np.inf,
        remark=": along the link, and away from its axis towards the muscle",
        place=place,
        meaning=doc,
    )


_ANCHOR = "position of the ends A, C, M, N of the muscle"
_WIRE = "position of the ends B, D of the wire"
_CONTACT = "position of the shoulders P, Q of the balloon"


class _Geometry(Group):
    anchor_x = _along("anchor_m", 0.90, _ANCHOR, lower=0)
    anchor_y = _off("anchor_m", 0.18, _ANCHOR, lower=0)
    wire_x = _along("wire_m", 0.03, _WIRE, lower=-np.inf)
    wire_y = _off("wire_m", 0.04, _WIRE, lower=-np.inf)
    contact_x = _along("contact_m", 0.055, _CONTACT, lower=0)
    contact_y = _off("contact_m", 0.15, _CONTACT, lower=0)
    wire_length = guess(0.34, "m", "length L_wire of the wire that passes through the bush").keyed(
        "wire_length_m"
    )
    muscle_length = guess(MUSCLE_LENGTH, "m", "length L_pam of the muscle at rest").keyed(
        "muscle_length_m"
    )


class _Load(Group):
    torque = Declaration(
        0.3, "N m", "constant torque on the joint, used if a run does not record the torque"
    ).keyed("torque_N_m", lower=0)


class _Alpha(Group):
    offset = Declaration(
        0.03,
        "N m",
        "value of the torque correction alpha at bending angles up to its threshold",
        frozen=False,
    )
    threshold = freed(
        float(np.deg2rad(40)),
        "rad",
        "bending angle above which the torque correction alpha increases (40 deg)",
        upper=float(np.pi / 2),
    )
    curvature = Declaration(
        _PER_SQUARE_DEGREE / 1600,
        "N m/rad^2",
        "coefficient of the increase in alpha, which is proportional to the square of the angle "
        "beyond the threshold (1/1600 per deg^2)",
        frozen=False,
    )


class _Beta(Group):
    offset = Declaration(
        0.01, "N m", "value of the torque correction beta for the straight joint", frozen=False
    )
    width = freed(
        float(np.deg2rad(2)),
        "rad",
        "bending angle at which the linearly decreasing part of beta reaches zero (2 deg)",
        upper=float(np.pi / 2),
    )
    threshold = freed(
        float(np.deg2rad(20)),
        "rad",
        "bending angle beyond which beta decreases quadratically (20 deg)",
        upper=float(np.pi / 2),
    )
    curvature = Declaration(
        0.3 * _PER_SQUARE_DEGREE / 1600,
        "N m/rad^2",
        "coefficient of the decrease in beta, which is proportional to the square of the angle "
        "beyond the threshold (0.3/1600 per deg^2)",
        frozen=False,
    )


class _Drive(Group):
    lag = Declaration(
        0.2,
        "s",
        "time constant of the first-order lag of a muscle's pressure behind its command (63 %)",
        lower=1e-3,
        upper=1e3,
        optional=True,
        has_states=True,
        assumed=True,
    )
    passive_stiffness = positive(
        0.1,
        "N m/rad",
        "stiffness of a joint about its straight pose, in addition to the stiffness of its muscles",
        upper=1e3,
        optional=True,
    )
    stop_stiffness = guess(
        10.0,
        "N m/rad",
        "stiffness of the end stop of a joint with muscles, which acts beyond 60 deg",
        upper=1e4,
    )


GEOMETRY = _Geometry("geometry")
LOAD = _Load("")
ALPHA = _Alpha("alpha")
BETA = _Beta("beta")
DRIVE = _Drive("drive")


class _Play(Group):
    thresholds = positive(0.0, "input", "half-width of the backlash of the play element")


class _Stop(Group):
    thresholds = positive(
        1.0, "input", "change in the input from rest at which the stop element begins to slide"
    )


class _PrandtlIshlinskii(Group):
    elastic = freed(
        1.0,
        "output/input",
        "coefficient of the elastic part of the output, which is proportional to the input",
    )
    weights = freed(0.1, "output/input", "weights of the play or stop elements in the output")
    thresholds = positive(1.0, "input", "thresholds of the play or stop elements")


class _DeadZones(Group):
    slope = freed(
        1.0, "output/input", "slope of the output between the dead-zone thresholds nearest to 0"
    )
    upper_thresholds = positive(1.0, "input", "thresholds of the dead zones at positive values")
    upper_slopes = freed(
        1.0, "output/input", "slope of the output beyond each positive dead-zone threshold"
    )
    lower_thresholds = positive(
        1.0, "input", "thresholds of the dead zones at negative values, as distances from 0"
    )
    lower_slopes = freed(
        1.0, "output/input", "slope of the output beyond each negative dead-zone threshold"
    )


class _ModifiedPrandtlIshlinskii(Group):
    weights = freed(0.1, "", "weights of the play elements, relative to the weight of the input")
    thresholds = positive(1.0, "input", "thresholds of the play elements")


class _Preisach(Group):
    slope = Declaration(
        0.5,
        "output/input",
        "slope of the reversible part of the output versus the input",
        frozen=False,
    )
    saturation = freed(
        0.5, "output", "hysteretic part of the output if all relays are in the upper state"
    )
    coercivity = freed(0.2, "input", "median half-width of the relays")
    coercivity_spread = Declaration(
        0.7,
        "",
        "standard deviation of the logarithm of the half-widths of the relays",
        lower=0.05,
        upper=5,
        frozen=False,
    )
    bias = Declaration(0.0, "input", "mean of the centres of the relays")
    interaction = freed(0.3, "input", "standard deviation of the centres of the relays")


_GAMMA = (
    "coefficient of the dissipative term of the Bouc-Wen equation, which determines the width of "
    "the loop"
)
_DELTA = (
    "coefficient of the second nonlinear term of the Bouc-Wen equation, which determines the shape "
    "of the loop"
)
_NU = "exponent of the Bouc-Wen equation, which determines the sharpness of the knee"


class _BoucWen(Group):
    elastic = freed(
        0.5,
        "output/input",
        "coefficient of the elastic part of the output, which is proportional to the input",
    )
    alpha = freed(
        0.5, "output/input", "initial slope of the hysteretic part of the output versus the input"
    )
    beta = positive(
        1.0,
        "1/input",
        "common factor of gamma and delta; only the products beta gamma and beta delta are "
        "identifiable",
    )
    gamma = freed(
        1.0,
        "",
        _GAMMA,
    )
    delta = Declaration(
        0.1,
        "",
        _DELTA,
        frozen=False,
    )
    nu = Declaration(
        1.0,
        "",
        _NU,
        lower=0.5,
        upper=20,
    )


class _Branches(Group):
    travel = positive(
        1.0,
        "output",
        "change in the desired output that moves the command from one branch to the other",
    )


class _BoucWenOscillator(Group):
    mass = freed(2.0, "kg", "moving mass of the oscillator")
    damping = freed(10.0, "N s/m", "viscous damping coefficient of the oscillator")
    stiffness = freed(5e4, "N/m", "stiffness of the spring parallel to the hysteretic element")
    alpha = freed(5e4, "N/m", "initial stiffness of the hysteretic element")
    beta = positive(
        1e3,
        "1/m",
        "common factor of gamma and delta; only the products beta gamma and beta delta are "
        "identifiable",
    )
    gamma = freed(
        0.8,
        "",
        _GAMMA,
    )
    delta = Declaration(
        -1.1,
        "",
        _DELTA,
        frozen=False,
    )
    nu = Declaration(
        1.0,
        "",
        _NU,
        lower=0.5,
        upper=20,
    )


class _Loop(Group):
    offset = Declaration(0.0, "output", "constant offset added to the output", frozen=False)
    drift = left_out(
        "output",
        "drift of the output at the last sample; the drift increases linearly with time",
    )
    previous_extremes = Declaration(
        0.0, "input", "turning points of the input before the run, in chronological order"
    )


PLAY = _Play("")
STOP = _Stop("")
PRANDTL_ISHLINSKII = _PrandtlIshlinskii("")
DEAD_ZONES = _DeadZones("dead_zones")
MODIFIED_PRANDTL_ISHLINSKII = _ModifiedPrandtlIshlinskii("")
PREISACH = _Preisach("")
BOUC_WEN = _BoucWen("")
BRANCH_COMPENSATOR = _Branches("")
BOUC_WEN_OSCILLATOR = _BoucWenOscillator("")
LOOP = _Loop("")


@with_keys(LOAD, GEOMETRY, ALPHA, BETA)
class JointSection(Section):
    """`[joint]`: one joint with its muscle. Points are in the frame of their link."""

    correction: Literal["continuous", "printed", "none"] | None = key(
        '"continuous", "printed" or "none"',
        "torque corrections alpha and beta: functions of the absolute angle (continuous), as "
        "printed in the paper, including its error (printed), or zero (none)",
        preset="continuous",
    )
    blend_deg: Annotated[float, Field(ge=0, le=30, allow_inf_nan=False)] | None = key(
        "a number from 0 to 30",
        "half-width of the interval of joint angles about 0 in which alpha and beta are blended",
        preset=0.0,
    )


def _varying(*names: str) -> Callable[[RecordedRun], str | None]:
    """Return a function that returns the first of these inputs that is recorded and varies."""

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
            f"{naming.source}: in {naming.at(row)} the side is {side[row]} and the angle is "
            f"{np.rad2deg(angle[row]):.4g} deg, but the angle must be positive where the joint "
            "bends towards the muscle (inner): correct the side or the sign"
        )
    beyond = np.flatnonzero(np.abs(angle) > np.pi / 2)
    if beyond.size:
        row = beyond[0]
        raise InputError(
            f"{naming.source}: {naming.of(channels['angle'])} is {np.rad2deg(angle[row]):.4g} "
            f"deg in {naming.at(row)}, but a joint bends by at most 90 deg: correct the angle"
        )


def _joint_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    section, notes = content.definition.section(JointSection), []
    if not section.contents():
        notes.append("the sidecar has no [joint]: the default geometry of giajax is used")
    if "torque" not in content.channels:
        torque = float(section.values().get(LOAD.torque.path, LOAD.torque.default))
        notes.append(f"the torque is not recorded: {torque:g} N m is assumed")
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
    """The force law and its parameters."""

    law: Literal["braided", "empirical", "piston"] | None = key(
        '"braided", "empirical" or "piston"',
        "force law: a braided muscle (braided), a normalised curve for muscles of any length "
        "(empirical), or a pneumatic cylinder (piston)",
        preset="braided",
    )


@with_keys(FRICTION)
class MuscleSection(_Law):
    """`[muscle]`: the force law, the parameters of the muscle, and its friction."""

    pressure: Literal["measured", "mean"] | None = key(
        '"measured" or "mean"',
        "pressure used by the model: the value at each sample (measured), or the mean over the "
        "run (mean) if the pressure was held constant but friction disturbs its measurement",
        preset="measured",
    )
    friction: Literal["coulomb", "none"] | None = key(
        '"coulomb" or "none"',
        "friction force of the muscle, which changes sign between filling and exhausting; "
        "requires a recorded phase, or position and time",
        preset="none",
    )
    friction_pressures_kPa: Annotated[list[NotNegative], Field(min_length=1)] | None = key(  # noqa: N815
        "a list of increasing numbers",
        "pressures at which the half-width of the friction band is specified; values in between "
        "are interpolated linearly",
        preset=[0.0],
    )

    @field_validator("friction_pressures_kPa")
    @classmethod
    def _pressures_increase(cls, pressures: Any) -> Any:
        if pressures is not None and any(a >= b for a, b in pairwise(pressures)):
            raise ValueError(
                f"is {pressures}, but must increase: sort the list, and give each pressure once"
            )
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
            "its contraction, so add a column such as contraction"
        )
    friction = section.friction or ("coulomb" if section.law == "piston" else "none")
    directed = "phase" in channels or (moves and content.times is not None)
    if friction == "coulomb" and not directed:
        raise InputError(
            f"{naming.source}: friction requires the direction of motion, from a phase column, or "
            'from time and position: add these columns, or set friction = "none" in [muscle]'
        )


def _muscle_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    section, notes = content.definition.section(MuscleSection), []
    if section.law is None:
        notes.append("[muscle] specifies no law: a braided muscle is assumed")
    without = None if section.law == "piston" else "none"
    if "phase" in content.channels and (section.friction or without) == "none":
        notes.append("the phase is recorded, but not used, because [muscle] specifies no friction")
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
    """`[hysteresis]`: the operator and its options, without its parameters. Values in SI units."""

    operator: (
        Literal["prandtl_ishlinskii", "modified_prandtl_ishlinskii", "preisach", "bouc_wen"] | None
    ) = key(
        "one of prandtl_ishlinskii, modified_prandtl_ishlinskii, preisach and bouc_wen",
        "hysteresis operator",
        preset="prandtl_ishlinskii",
    )
    elements: Literal["play", "stop"] | None = key(
        '"play" or "stop"', "type of the elements of a Prandtl-Ishlinskii operator", preset="play"
    )
    thresholds: CountOrPositive | None = key(
        _EITHER,
        "thresholds of the elements (SI), or the number of thresholds, which are then spaced "
        "evenly up to half of the input range",
        preset=10,
    )
    upper_dead_zones: CountOrPositive | None = key(
        _EITHER,
        "positive thresholds of the dead zones of the modified operator (SI), or the number of "
        "these thresholds, which are then densest near 0",
        preset=5,
    )
    lower_dead_zones: CountOrPositive | None = key(
        _EITHER,
        "negative thresholds of the dead zones of the modified operator (SI, as distances from "
        "0), or the number of these thresholds",
        preset=5,
    )
    rows: Annotated[int, Field(ge=2, le=ELEMENTS)] | None = key(
        f"a whole number from 2 to {ELEMENTS}", "number of rows of the Preisach mesh", preset=40
    )
    input_range: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = key(
        "a list of two numbers, the lower one first",
        "input range (SI) that the operator covers (default: the range of the inputs of the runs)",
        preset=[-1.0, 1.0],
    )
    previous_extremes: Count | Annotated[list[Finite], Field(min_length=1)] | None = key(
        f"{COUNT}, or a list of numbers",
        "turning points of the input before the run (SI), or the number of turning points that a "
        "fit may estimate",
        preset=1,
    )

    @field_validator("input_range")
    @classmethod
    def _range_is_one(cls, ends: Any) -> Any:
        if ends is not None and not ends[0] < ends[1]:
            raise ValueError(f"is {ends}: give two different numbers, the lower one first")
        return ends


# Columns that runs of the hysteresis operator and of the oscillator share.
CHANNELS = (
    ChannelKind("input", "input", None, "input"),
    ChannelKind("output", "output", None, "output"),
    ChannelKind("command", "command", "angle", "input"),
    ChannelKind("angle", "angle", "angle", "output", noise="angle_deg"),
)


def _hysteresis_drawn_over(content: RecordedRun) -> str | None:
    """Return the input if it varies, because loops are drawn over it."""
    names = [c.name for c in content.channels.values() if c.kind in HYSTERESIS.inputs]
    return next((name for name in names if np.ptp(content.values[name]) > 0), None)


def _hysteresis_notes(content: RecordedRun, sidecar: bool) -> list[str]:
    if content.definition.section(HysteresisSection).operator is not None:
        return []
    return [
        "[hysteresis] specifies no operator: a Prandtl-Ishlinskii operator with ten elements is "
        "assumed"
    ]


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
    """`[oscillator]`: the options of an oscillator, without its parameters."""

    interpolation: Literal["linear", "band_limited"] | None = key(
        '"linear" or "band_limited" (one period of evenly sampled rows)',
        "interpolation of the force between samples",
        preset="linear",
    )


def _upgraded(data: dict[str, Any]) -> dict[str, Any]:
    """Convert a definition of version 0.1, which has the oscillator in `[hysteresis]`."""
    before = data.get("hysteresis")
    if not isinstance(before, dict) or before.get("operator") != "bouc_wen_oscillator":
        # A fit definition of that version gives only the model next to such a sidecar.
        renamed = data.get("model") == "hysteresis" and "oscillator" in data and not before
        return {**data, "model": "oscillator"} if renamed else data
    section = {name: value for name, value in before.items() if name == "interpolation"}
    upgraded = {name: value for name, value in data.items() if name != "hysteresis"}
    return {**upgraded, "model": "oscillator", "oscillator": section}


OSCILLATOR = Kind(
    name="oscillator",
    model="_oscillator:OscillatorModel",
    channels=CHANNELS,
    # Its columns are those of a hysteresis run, so a sidecar must give the model.
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
