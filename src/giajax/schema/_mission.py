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

    joints: _JOINTS = key("a list of numbers of joints", "joints that bend", default=...)
    angles_deg: list[Finite] = key("a list of numbers", "angles to which they bend", default=...)

    @model_validator(mode="after")
    def _as_many(self) -> "ApproachSection":
        if len(self.angles_deg) != len(self.joints):
            raise ValueError(
                f"has {len(self.angles_deg)} angles for {len(self.joints)} joints: give one angle "
                f"for each joint"
            )
        return self


class OperatorSection(Section):
    """`[mission.operator]`: who drives the arm through the opening."""

    approach: ApproachSection = key(
        "a table of keys", "pose that the joints take first", default=...
    )
    approach_rate_deg_per_s: Positive = key(
        POSITIVE, "rate, on the way to the approach, of the joint that turns the most", default=1.0
    )
    latency_s: NotNegative = key(NOT_NEGATIVE, "total delay of image and hand", default=0.4)
    speed_m_per_s: Positive = key(POSITIVE, "maximum speed of the tip", default=0.2)
    largest_rate_deg_per_s: Positive = key(POSITIVE, "maximum commanded joint rate", default=2.0)
    largest_angle_deg: Positive = key(POSITIVE, "maximum commanded joint angle", default=60.0)
    stand_off_m: Positive = key(
        POSITIVE,
        "distance in front of the opening at which the tip moves to the axis of the opening",
        default=2.0,
    )
    patience_s: Positive = key(
        POSITIVE,
        "time without the opening in view after which the joints return to the approach",
        default=20.0,
    )
    pixel_px: Positive = key(
        POSITIVE, "standard deviation of the observed position of a corner", default=1.0
    )


class SteeringSection(Section):
    """`[mission.steering]`: the predictive controller, with the limits of `[mission.operator]`."""

    speed_m_per_s: Positive = key(POSITIVE, "speed of the tip towards the opening", default=0.4)
    stand_off_m: Positive = key(
        POSITIVE,
        "distance in front of the opening at which the tip moves to the axis of the opening",
        default=2.5,
    )
    air_m_per_s: Positive = key(
        POSITIVE, "root mean square of the air velocity that the controller assumes", default=0.2
    )


class MissionWindSection(Section):
    """`[mission.wind]`: the air, which the operator does not know."""

    speed_m_per_s: NotNegative = key(
        NOT_NEGATIVE, "root mean square of the air velocity", default=0.2
    )
    mean: _Share = key(
        "a number above 0 and up to 1",
        "ratio of the mean flow (horizontal, in a random direction) to speed_m_per_s",
        default=0.3,
    )
    length_scale_m: Positive = key(POSITIVE, "length scale of the gusts", default=2.0)


class MissionSection(Section):
    """`[mission]`: what is to be reached, in what time, by whom."""

    opening: Name | None = key(
        "the name of a wall", "wall with the opening that the tip passes through"
    )
    camera: Name | None = key("the name of a camera", "camera at the tip that the operator uses")
    beyond_m: Positive = key(
        POSITIVE, "distance behind the outer face from which the tip counts as inside", default=0.5
    )
    hold_s: NotNegative = key(NOT_NEGATIVE, "time for which the tip must stay inside", default=3.0)
    limit_s: Annotated[float, Field(gt=0, le=36_000, allow_inf_nan=False)] = key(
        "a positive number of up to 36000", "time limit of the mission", default=720.0
    )
    operator: OperatorSection = key("a table of keys", "operator who drives the arm", default=...)
    steering: SteeringSection = key(
        "a table of keys", "settings of `--controller mpc`", default=SteeringSection()
    )
    camera_stops_s: NotNegative | None = key(
        NOT_NEGATIVE, "time after which the camera gives no images"
    )
    wind: MissionWindSection = key(
        "a table of keys", "motion of the air", default=MissionWindSection()
    )
    spread: dict[str, NotNegative] | None = key(
        "a table of numbers by parameter",
        "standard deviations of the logarithm of parameters between cases",
    )

    @field_validator("spread", mode="before")
    @classmethod
    def _no_tables(cls, spread: object) -> object:
        if isinstance(spread, dict) and any(isinstance(each, dict) for each in spread.values()):
            raise ValueError("contains a table: put the paths of parameters in quotes")
        return spread


# The sections of a file that says what a game pad does: `giajax drive --pad FILE.toml`.

_Joints = Annotated[list[Count], Field(min_length=1)]
_Index = Annotated[int, Field(ge=0, le=255)]


class PadAxis(Section):
    """An entry of `[[pad.axes]]`: a stick, and the joints that it turns."""

    axis: _Index = key(
        "a whole number from 0 on",
        "number of the axis; on a standard pad 0 and 1 are the left stick (right, down), 2 and 3 "
        "the right stick",
        default=...,
    )
    joints: _Joints = key("a list of numbers of joints", "joints that the axis moves", default=...)
    rate_deg_per_s: Finite = key(
        "a finite number", "rate of each joint at full deflection; negative: reversed",
        default=...,
    )  # fmt: skip


class PadButton(Section):
    """An entry of `[[pad.buttons]]`: a button, and what it does."""

    button: _Index = key("a whole number from 0 on", "number of the button", default=...)
    preset: Name | None = key("the name of a preset", "move to this preset")
    stop: bool | None = key("true or false", "true: stop all joints and hold the current command")
    dead_man: bool | None = key(
        "true or false", "true: joints move only while this button is pressed"
    )


class Preset(Section):
    """An entry of `[[pad.presets]]`: angles of some joints."""

    name: Name = key("a name", "name of the preset on the page", default=...)
    joints: _Joints = key(
        "a list of numbers of joints", "joints that the preset moves", default=...
    )
    angles_deg: list[Finite] = key(
        "a list of numbers", "angles that these joints take", default=...
    )
    others_deg: Finite | None = key(
        "a finite number", "angle that all other joints take (default: they stay)"
    )


class PadSection(Section):
    """`[pad]`: what a game pad does."""

    dead_zone: Annotated[float, Field(ge=0, lt=1)] = key(
        "a number from 0 to below 1", "deflection below which the stick has no effect", default=0.12
    )
    exponent: Positive = key(
        POSITIVE,
        "exponent of rate over deflection; 1: proportional; 2: finer near the centre",
        default=2.0,
    )
    largest_rate_deg_per_s: Positive = key(
        POSITIVE, "maximum commanded joint rate, by pad, slider or preset", default=5.0
    )
    largest_angle_deg: Positive = key(POSITIVE, "maximum commanded joint angle", default=60.0)
    timeout_s: Positive = key(
        POSITIVE, "time without a message from the page after which all joints stop", default=0.5
    )
    smoothing_s: NotNegative = key(
        NOT_NEGATIVE, "time constant with which a rate follows the stick", default=0.1
    )
    axes: list[PadAxis] | None = key(
        "a list of tables", "axes of the sticks and the joints that they move"
    )
    buttons: list[PadButton] | None = key("a list of tables", "buttons and their actions")
    presets: list[Preset] | None = key("a list of tables", "presets of joint angles")


class PadFile(Section):
    """A file that says what a game pad does."""

    pad: PadSection = key("a table of keys", "assignment of the game pad", default=...)
