"""The sections of what moves an arm: its state at the first sample, commands and wind."""

from typing import Literal

from pydantic import model_validator

from ..quantities import INITIAL
from ._keys import with_keys
from ._section import Section, Vector, key


@with_keys(INITIAL)
class InitialSection(Section):
    """`[initial]`: joint angles and rates at the first sample. By default: straight, at rest."""

    first_row: bool | None = key(
        "true or false",
        "true: as in the first row of the joint angle and rate columns",
        example=True,
    )
    free: bool | None = key(
        "true or false",
        "true: parameters of this run, which a fit finds; the others are a start",
        example=True,
    )

    @model_validator(mode="after")
    def _stated_once(self) -> "InitialSection":
        if self.first_row and self.values():
            raise ValueError(
                "says first_row = true and angle_deg or rate_deg_per_s, but must say the state "
                "once: remove one or the other"
            )
        return self


Interpolation = Literal["zoh", "linear"]
_BETWEEN_ROWS = '"linear" or "zoh" (held until the next row)'


class CommandSection(Section):
    """`[command]`: how the joint commands run between two rows."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows", default="linear", example="linear"
    )


class WindSection(Section):
    """`[wind]`: how the wind columns run between two rows, or a constant wind instead."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows", default="linear", example="linear"
    )
    velocity_m_per_s: Vector | None = key(
        "a list of three numbers",
        "constant wind (x, y, z), instead of wind columns",
        example=[0.0, 0.0, 0.2],
    )
