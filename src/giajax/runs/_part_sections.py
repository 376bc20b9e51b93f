"""The sections of the arm's parts: hysteresis, a joint with its muscle, a muscle."""

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from ._section import Finite, NotNegative, Positive, Section, key

Count = Annotated[int, Field(ge=1)]
CountOrPositive = Count | Annotated[list[Positive], Field(min_length=1)]
_EITHER = "a whole number of at least 1, or a list of positive numbers"


class Hysteresis(Section):
    """`[hysteresis]`: which operator, and what of it is no parameter. Values in SI units."""

    operator: (
        Literal[
            "prandtl_ishlinskii",
            "modified_prandtl_ishlinskii",
            "preisach",
            "bouc_wen",
            "bouc_wen_oscillator",
        ]
        | None
    ) = key(
        "one of prandtl_ishlinskii, modified_prandtl_ishlinskii, preisach, bouc_wen and "
        "bouc_wen_oscillator",
        "the operator; bouc_wen_oscillator is a mass on a spring with a Bouc-Wen element",
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
    rows: Annotated[int, Field(ge=2)] | None = key(
        "a whole number of at least 2", "rows of the Preisach mesh", preset=40
    )
    input_range: Annotated[list[Finite], Field(min_length=2, max_length=2)] | None = key(
        "a list of two numbers, the lower one first",
        "range of the input (SI) that the operator covers; that of the runs unless stated",
        preset=[-1.0, 1.0],
    )
    previous_extremes: Count | Annotated[list[Finite], Field(min_length=1)] | None = key(
        "a whole number of at least 1, or a list of numbers",
        "turning points of the input before the run (SI), or how many a fit may find",
        preset=1,
    )
    interpolation: Literal["linear", "band_limited"] | None = key(
        '"linear" or "band_limited" (one period of evenly sampled rows)',
        "force between two rows of an oscillator's run",
        preset="linear",
    )

    @field_validator("input_range")
    @classmethod
    def _range_is_one(cls, ends: Any) -> Any:
        if ends is not None and not ends[0] < ends[1]:
            raise ValueError(f"is {ends}, but must have the lower number first: correct it")
        return ends


Point = Annotated[list[Finite], Field(min_length=2, max_length=2)]
_POINT = "a list of two numbers: along the link, and off its axis towards the muscle"


class Joint(Section):
    """`[joint]`: one joint with its muscle. Points are in the frame of their link."""

    correction: Literal["continuous", "printed", "none"] | None = key(
        '"continuous", "printed" or "none"',
        "alpha and beta read with the size of the angle, as printed (an erratum), or zero",
        preset="continuous",
    )
    blend_deg: Annotated[float, Field(ge=0, le=30, allow_inf_nan=False)] | None = key(
        "a number from 0 to 30", "half-width about 0 in which alpha and beta join", preset=0.0
    )
    torque_N_m: Positive | None = key(  # noqa: N815
        "a positive number", "torque on the joint where no column gives it", preset=0.3
    )
    anchor_m: Point | None = key(_POINT, "ends A, C, M, N of the muscle", preset=[0.9, 0.18])
    wire_m: Point | None = key(_POINT, "ends B, D of the wire", preset=[0.03, 0.04])
    contact_m: Point | None = key(_POINT, "shoulders P, Q of the balloon", preset=[0.055, 0.15])
    wire_length_m: Positive | None = key("a positive number", "length of the wire", preset=0.34)
    muscle_length_m: Positive | None = key(
        "a positive number", "length of the muscle at rest", preset=1.96
    )


class Muscle(Section):
    """`[muscle]`: which law, what is known of the muscle, and whether it has friction."""

    law: Literal["braided", "empirical", "piston"] | None = key(
        '"braided", "empirical" or "piston"',
        "statics of a braid, a normalised shape for any length, or a cylinder",
        preset="braided",
    )
    length_m: Positive | None = key("a positive number", "length at rest", preset=1.96)
    diameter_m: Positive | None = key(
        "a positive number", "diameter of a braided muscle at rest", preset=0.0035
    )
    braid_angle_deg: Annotated[float, Field(gt=0, lt=54.7)] | None = key(
        "a number between 0 and 54.7", "angle of the braid from the axis at rest", preset=18.0
    )
    pressure_limit_kPa: Positive | None = key(  # noqa: N815
        "a positive number", "highest pressure", preset=300.0
    )
    pressure: Literal["measured", "mean"] | None = key(
        '"measured" or "mean"',
        "the pressure at each row, or its mean: what was set, where friction moves the gauge",
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
