"""The sections of a mission: `giajax mission FILE.toml`."""

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from .._limits import ELEMENTS
from ._section import Count, Finite, Name, NotNegative, Positive, Section, key

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
        "a positive number", "of the joint that turns the most on the way there", default=1.0
    )
    latency_s: NotNegative = key(
        "a number that is not negative", "of picture and hand", default=0.4
    )
    speed_m_per_s: Positive = key("a positive number", "of the tip at most", default=0.2)
    largest_rate_deg_per_s: Positive = key(
        "a positive number", "no joint is commanded faster", default=2.0
    )
    largest_angle_deg: Positive = key(
        "a positive number", "no joint is commanded further", default=60.0
    )
    stand_off_m: Positive = key(
        "a positive number", "how far before the opening the tip goes to its axis", default=2.0
    )
    patience_s: Positive = key(
        "a positive number",
        "without a picture of the opening, until joints go back to the approach",
        default=20.0,
    )
    pixel_px: Positive = key(
        "a positive number", "standard deviation of where it sees a corner", default=1.0
    )


class MissionWindSection(Section):
    """`[mission.wind]`: the air that nobody tells the operator of."""

    speed_m_per_s: NotNegative = key(
        "a number that is not negative", "root mean square of its velocity", default=0.2
    )
    mean: _Share = key(
        "a number above 0 and up to 1",
        "the mean flow, level and in any direction, over that speed",
        default=0.3,
    )
    length_scale_m: Positive = key("a positive number", "of the gusts", default=2.0)


class MissionSection(Section):
    """`[mission]`: what is to be reached, in what time, by whom."""

    opening: Name | None = key("the name of a wall", "whose opening the tip goes through")
    camera: Name | None = key("the name of a camera", "at the tip, by which the operator sees")
    beyond_m: Positive = key(
        "a positive number", "how far behind the outer face the tip is inside", default=0.5
    )
    hold_s: NotNegative = key(
        "a number that is not negative", "for how long it must be inside", default=3.0
    )
    limit_s: Annotated[float, Field(gt=0, le=36_000, allow_inf_nan=False)] = key(
        "a positive number of up to 36000", "time after which it is over", default=720.0
    )
    operator: OperatorSection = key("a table of keys", "who drives", default=...)
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
