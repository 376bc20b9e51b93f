"""Sections of files for operators: missions, and the assignment of a game pad."""

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

    joints: _JOINTS = key(
        "a list of joint numbers", "joints that bend in the approach pose", default=...
    )
    angles_deg: list[Finite] = key(
        "a list of numbers", "angles to which these joints bend", default=...
    )

    @model_validator(mode="after")
    def _as_many(self) -> "ApproachSection":
        if len(self.angles_deg) != len(self.joints):
            raise ValueError(
                f"has {len(self.angles_deg)} angles for {len(self.joints)} joints: give one angle "
                f"for each joint"
            )
        return self


class OperatorSection(Section):
    """`[mission.operator]`: the operator who drives the arm through the opening."""

    approach: ApproachSection = key(
        "a table of keys",
        "pose to which the operator moves the arm first, with the opening in view",
        default=...,
    )
    approach_rate_deg_per_s: Positive = key(
        POSITIVE,
        "rate of the joint with the largest rotation during the motion to the approach pose",
        default=1.0,
    )
    latency_s: NotNegative = key(
        NOT_NEGATIVE, "total delay of the image and of the operator's reaction", default=0.4
    )
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
        "time without the opening in view after which the joints return to the approach pose",
        default=20.0,
    )
    pixel_px: Positive = key(
        POSITIVE,
        "standard deviation of the observed image position of a corner of the opening",
        default=1.0,
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
    """`[mission.wind]`: the wind, which the operator does not know."""

    speed_m_per_s: NotNegative = key(
        NOT_NEGATIVE, "root mean square of the air velocity", default=0.2
    )
    mean: _Share = key(
        "a number above 0 and up to 1",
        "ratio of the speed of the mean flow (horizontal, in a random direction) to speed_m_per_s",
        default=0.3,
    )
    length_scale_m: Positive = key(POSITIVE, "length scale of the gusts", default=2.0)


class MissionSection(Section):
    """`[mission]`: the target, the time limit, and the operator."""

    opening: Name | None = key(
        "the name of a wall", "wall with the opening through which the tip passes"
    )
    camera: Name | None = key("the name of a camera", "camera at the tip that the operator uses")
    beyond_m: Positive = key(
        POSITIVE,
        "distance behind the outer face of the wall beyond which the tip is inside the opening",
        default=0.5,
    )
    hold_s: NotNegative = key(
        NOT_NEGATIVE, "time for which the tip must stay inside the opening", default=3.0
    )
    limit_s: Annotated[float, Field(gt=0, le=36_000, allow_inf_nan=False)] = key(
        "a positive number up to 36000", "time limit of the mission", default=720.0
    )
    operator: OperatorSection = key("a table of keys", "operator who drives the arm", default=...)
    steering: SteeringSection = key(
        "a table of keys", "settings of `--controller mpc`", default=SteeringSection()
    )
    camera_stops_s: NotNegative | None = key(
        NOT_NEGATIVE, "time after which the camera provides no images"
    )
    wind: MissionWindSection = key(
        "a table of keys", "wind during the mission", default=MissionWindSection()
    )
    spread: dict[str, NotNegative] | None = key(
        "a table of parameter paths and numbers",
        "standard deviations of the logarithms of the parameters that vary between cases",
    )

    @field_validator("spread", mode="before")
    @classmethod
    def _no_tables(cls, spread: object) -> object:
        if isinstance(spread, dict) and any(isinstance(each, dict) for each in spread.values()):
            raise ValueError("contains a table: put parameter paths in quotes")
        return spread


# Sections of a file that assigns the controls of a game pad: `giajax drive --pad FILE.toml`.

_Joints = Annotated[list[Count], Field(min_length=1)]
_Index = Annotated[int, Field(ge=0, le=255)]


class PadAxis(Section):
    """An entry of `[[pad.axes]]`: a stick, and the joints that it moves."""

    axis: _Index = key(
        "a whole number from 0 to 255",
        "number of the axis; on a standard pad, 0 and 1 are the left stick (right, down) and 2 "
        "and 3 are the right stick",
        default=...,
    )
    joints: _Joints = key("a list of joint numbers", "joints that the axis moves", default=...)
    rate_deg_per_s: Finite = key(
        "a finite number",
        "rate of each joint at full deflection; a negative rate reverses the direction",
        default=...,
    )


class PadButton(Section):
    """An entry of `[[pad.buttons]]`: a button, and its function."""

    button: _Index = key("a whole number from 0 to 255", "number of the button", default=...)
    preset: Name | None = key("the name of a preset", "preset to which the button moves the arm")
    stop: bool | None = key("true or false", "true: stop all joints and hold the current command")
    dead_man: bool | None = key(
        "true or false", "true: joints move only while this button is pressed"
    )


class Preset(Section):
    """An entry of `[[pad.presets]]`: angles of some joints."""

    name: Name = key("a name", "name of the preset on the page", default=...)
    joints: _Joints = key("a list of joint numbers", "joints that the preset moves", default=...)
    angles_deg: list[Finite] = key(
        "a list of numbers", "angles that these joints take", default=...
    )
    others_deg: Finite | None = key(
        "a finite number", "angle that all other joints take (default: they do not move)"
    )


class PadSection(Section):
    """`[pad]`: the assignment of a game pad."""

    dead_zone: Annotated[float, Field(ge=0, lt=1)] = key(
        "a number of at least 0 and below 1",
        "relative deflection below which the stick has no effect",
        default=0.12,
    )
    exponent: Positive = key(
        POSITIVE,
        "exponent of the joint rate as a function of the deflection; 1: proportional; 2: finer "
        "control near the centre",
        default=2.0,
    )
    largest_rate_deg_per_s: Positive = key(
        POSITIVE, "maximum joint rate commanded by pad, slider or preset", default=5.0
    )
    largest_angle_deg: Positive = key(POSITIVE, "maximum commanded joint angle", default=60.0)
    timeout_s: Positive = key(
        POSITIVE, "time without a message from the page after which all joints stop", default=0.5
    )
    smoothing_s: NotNegative = key(
        NOT_NEGATIVE,
        "time constant with which the commanded joint rate follows the stick",
        default=0.1,
    )
    axes: list[PadAxis] | None = key(
        "a list of tables", "axes of the sticks and the joints that they move"
    )
    buttons: list[PadButton] | None = key("a list of tables", "buttons and their actions")
    presets: list[Preset] | None = key("a list of tables", "presets of joint angles")


class PadFile(Section):
    """A file that assigns the controls of a game pad."""

    pad: PadSection = key(
        "a table of keys", "assignment of the controls of the game pad", default=...
    )
