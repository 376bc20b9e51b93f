"""The sections of files for operators: a mission, and what a game pad does."""

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from ..runtime.limits import ELEMENTS
from ._declaration import (
    NOT_NEGATIVE,
    POSITIVE,
    Count,
    Finite,
    Name,
    NotNegative,
    Positive,
    Section,
    key,
)

_Share = Annotated[float, Field(gt=0, le=1, allow_inf_nan=False)]
_JOINTS = Annotated[list[Count], Field(min_length=1, max_length=ELEMENTS)]


class ApproachSection(Section):
    """`[mission.operator.approach]`: commanded angles from which the opening is in view."""

    joints: _JOINTS = key("a list of numbers of joints", "which joints bend", default=...)
    angles_deg: list[Finite] = key("a list of numbers", "to which angles", default=...)

    @model_validator(mode="after")
    def _as_many(self) -> "ApproachSection":
        if len(self.angles_deg) != len(self.joints):
            raise ValueError(
                f"has {len(self.angles_deg)} angles for {len(self.joints)} joints: give as many"
            )
        return self


class OperatorSection(Section):
    """`[mission.operator]`: who drives the arm through the opening."""

    approach: ApproachSection = key("a table of keys", "where joints go first", default=...)
    approach_rate_deg_per_s: Positive = key(
        POSITIVE, "of the joint that turns the most on the way there", default=1.0
    )
    latency_s: NotNegative = key(NOT_NEGATIVE, "of picture and hand", default=0.4)
    speed_m_per_s: Positive = key(POSITIVE, "of the tip at most", default=0.2)
    largest_rate_deg_per_s: Positive = key(POSITIVE, "no joint is commanded faster", default=2.0)
    largest_angle_deg: Positive = key(POSITIVE, "no joint is commanded further", default=60.0)
    stand_off_m: Positive = key(
        POSITIVE, "how far before the opening the tip goes to its axis", default=2.0
    )
    patience_s: Positive = key(
        POSITIVE,
        "without a picture of the opening, until joints go back to the approach",
        default=20.0,
    )
    pixel_px: Positive = key(POSITIVE, "standard deviation of where it sees a corner", default=1.0)


class SteeringSection(Section):
    """`[mission.steering]`: the predictive controller, with the limits of `[mission.operator]`."""

    speed_m_per_s: Positive = key(POSITIVE, "of the tip towards the opening", default=0.4)
    stand_off_m: Positive = key(
        POSITIVE, "how far before the opening the tip goes to its axis", default=2.5
    )
    air_m_per_s: Positive = key(
        POSITIVE, "root mean square of the air that it expects", default=0.2
    )


class MissionWindSection(Section):
    """`[mission.wind]`: the air, which the operator does not know."""

    speed_m_per_s: NotNegative = key(NOT_NEGATIVE, "root mean square of its velocity", default=0.2)
    mean: _Share = key(
        "a number above 0 and up to 1",
        "the mean flow, level and in any direction, over that speed",
        default=0.3,
    )
    length_scale_m: Positive = key(POSITIVE, "of the gusts", default=2.0)


class MissionSection(Section):
    """`[mission]`: what is to be reached, in what time, by whom."""

    opening: Name | None = key("the name of a wall", "whose opening the tip goes through")
    camera: Name | None = key("the name of a camera", "at the tip, by which the operator sees")
    beyond_m: Positive = key(
        POSITIVE, "how far behind the outer face the tip is inside", default=0.5
    )
    hold_s: NotNegative = key(NOT_NEGATIVE, "for how long it must be inside", default=3.0)
    limit_s: Annotated[float, Field(gt=0, le=36_000, allow_inf_nan=False)] = key(
        "a positive number of up to 36000", "time after which it is over", default=720.0
    )
    operator: OperatorSection = key("a table of keys", "who drives", default=...)
    steering: SteeringSection = key(
        "a table of keys", "of `--controller mpc`", default=SteeringSection()
    )
    camera_stops_s: NotNegative | None = key(
        NOT_NEGATIVE, "time from which on there is no picture any more"
    )
    wind: MissionWindSection = key("a table of keys", "the air", default=MissionWindSection())
    spread: dict[str, NotNegative] | None = key(
        "a table of numbers by parameter",
        "standard deviations of the logarithm of parameters, from case to case",
    )

    @field_validator("spread", mode="before")
    @classmethod
    def _no_tables(cls, spread: object) -> object:
        if isinstance(spread, dict) and any(isinstance(each, dict) for each in spread.values()):
            raise ValueError("has a table in it: quote the paths of parameters")
        return spread


# The sections of a file that says what a game pad does: `giajax drive --pad FILE.toml`.

_Joints = Annotated[list[Count], Field(min_length=1)]
_Index = Annotated[int, Field(ge=0, le=255)]


class PadAxis(Section):
    """An entry of `[[pad.axes]]`: a stick, and the joints that it turns."""

    axis: _Index = key(
        "a whole number from 0 on",
        "number of the axis; of a standard pad 0 and 1 are the left stick (right, down), 2 and 3 "
        "the right one",
        default=...,
    )
    joints: _Joints = key("a list of numbers of joints", "the joints that it turns", default=...)
    rate_deg_per_s: Finite = key(
        "a finite number", "rate of each of them at full deflection; negative: the other way",
        default=...,
    )  # fmt: skip


class PadButton(Section):
    """An entry of `[[pad.buttons]]`: a button, and what it does."""

    button: _Index = key("a whole number from 0 on", "number of the button", default=...)
    preset: Name | None = key("the name of a preset", "go there")
    stop: bool | None = key("true or false", "stop, and hold where the command is")
    dead_man: bool | None = key("true or false", "nothing moves unless it is held")


class Preset(Section):
    """An entry of `[[pad.presets]]`: angles of some joints."""

    name: Name = key("a name", "what the page calls it", default=...)
    joints: _Joints = key("a list of numbers of joints", "which joints go there", default=...)
    angles_deg: list[Finite] = key("a list of numbers", "to which angles", default=...)
    others_deg: Finite | None = key("a finite number", "where all others go; they stay otherwise")


class PadSection(Section):
    """`[pad]`: what a game pad does."""

    dead_zone: Annotated[float, Field(ge=0, lt=1)] = key(
        "a number from 0 to below 1", "deflection below which a stick is at rest", default=0.12
    )
    exponent: Positive = key(
        POSITIVE,
        "1: rates are in proportion to the deflection; 2: finer near the middle",
        default=2.0,
    )
    largest_rate_deg_per_s: Positive = key(
        POSITIVE, "no joint is commanded faster, by pad, slider or preset", default=5.0
    )
    largest_angle_deg: Positive = key(POSITIVE, "no joint is commanded further", default=60.0)
    timeout_s: Positive = key(
        POSITIVE, "without a word from the page for so long everything stops", default=0.5
    )
    smoothing_s: NotNegative = key(NOT_NEGATIVE, "in which a rate follows the stick", default=0.1)
    axes: list[PadAxis] | None = key("a list of tables", "the sticks")
    buttons: list[PadButton] | None = key("a list of tables", "the buttons")
    presets: list[Preset] | None = key("a list of tables", "the presets")


class PadFile(Section):
    """A file that says what a game pad does."""

    pad: PadSection = key("a table of keys", "what a game pad does", default=...)
