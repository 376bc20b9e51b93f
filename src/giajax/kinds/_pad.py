"""The sections of a file that says what a game pad does: `giajax drive --pad FILE.toml`."""

from typing import Annotated

from pydantic import Field

from ._section import Count, Finite, Name, NotNegative, Positive, Section, key

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
        "a positive number",
        "1: rates are in proportion to the deflection; 2: finer near the middle",
        default=2.0,
    )
    largest_rate_deg_per_s: Positive = key(
        "a positive number", "no joint is commanded faster, by pad, slider or preset", default=5.0
    )
    largest_angle_deg: Positive = key(
        "a positive number", "no joint is commanded further", default=60.0
    )
    timeout_s: Positive = key(
        "a positive number",
        "without a word from the page for so long everything stops",
        default=0.5,
    )
    smoothing_s: NotNegative = key(
        "a number that is not negative", "in which a rate follows the stick", default=0.1
    )
    axes: list[PadAxis] | None = key("a list of tables", "the sticks")
    buttons: list[PadButton] | None = key("a list of tables", "the buttons")
    presets: list[Preset] | None = key("a list of tables", "the presets")


class PadFile(Section):
    """A file that says what a game pad does."""

    pad: PadSection = key("a table of keys", "what a game pad does", default=...)
