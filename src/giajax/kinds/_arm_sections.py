"""The sections of an arm: its constants, its sensors, and what moves it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from ._section import Finite, Name, NotNegative, Positive, Section, Vector, flat, key

_PER_LINK = "or a list of them, one a link"


class PointMass(Section):
    """An entry of `[[arm.point_masses]]`: a small body fixed to a link."""

    link: Annotated[int, Field(ge=1)] = key(
        "a whole number of at least 1", "link that carries it", default=...
    )
    mass_kg: Positive = key("a positive number", "its mass", default=...)
    position_m: Finite = key(
        "a number", "its distance from the link's joint, along the link", default=...
    )
    left_m: Finite = key("a number", "its distance to the left of the link's axis", default=0.0)
    up_m: Finite = key("a number", "its distance above the link's axis", default=0.0)


class ArmSection(Section):
    """`[arm]`: the known constants of the arm. A number holds for all links."""

    preset: Name | None = key(
        "the name of a preset", "arm that the other keys change", preset="takeichi_20m"
    )
    links: Annotated[int, Field(ge=1)] | None = key(
        "a whole number of at least 1", "number of links; joint i precedes link i", preset=20
    )
    link_length_m: Positive | list[Positive] | None = key(
        f"a positive number {_PER_LINK}", "length of a link", preset=0.99
    )
    link_diameter_m: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}", "diameter that meets the air", preset=0.3
    )
    link_mass_kg: Positive | list[Positive] | None = key(
        f"a positive number {_PER_LINK}", "mass that moves with a link", preset=0.047
    )
    link_inertia_transverse_kg_m2: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}",
        "about the centre of mass, across the link",
        preset=0.004367475,
    )
    link_inertia_axial_kg_m2: NotNegative | list[NotNegative] | None = key(
        f"zero or a positive number {_PER_LINK}", "about the link's own axis", preset=0.0010575
    )
    link_centre_of_mass_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of the centre of mass from the joint", preset=0.495
    )
    joint_axes: Literal["pitch_yaw"] | list[Literal["pitch", "yaw"] | Vector] | None = key(
        '"pitch_yaw" or a list of "pitch", "yaw" or [x, y, z], one a joint',
        "axes of the joints in the straight arm; pitch_yaw alternates, pitch first",
        preset="pitch_yaw",
    )
    base_rotation_deg: Vector | None = key(
        "a list of three numbers", "rotation vector of the base", preset=[0.0, 0.0, 0.0]
    )
    air_density_kg_per_m3: NotNegative | None = key(
        "zero or a positive number", "density of the air", preset=1.204
    )
    gravity_m_per_s2: NotNegative | None = key(
        "zero or a positive number (it acts along -z)",
        "acceleration of gravity; 0 when buoyancy balances weight",
        preset=0.0,
    )
    drag: Literal["centre", "strip"] | None = key(
        '"centre" or "strip"',
        "drag at each link's centre (eq. 1), or across the flow along the link",
        preset="centre",
    )
    strip_points: Annotated[int, Field(ge=1, le=20)] | None = key(
        "a whole number from 1 to 20", "Gauss points of strip drag", preset=3
    )
    drag_curve: Literal["constant", "cylinder"] | None = key(
        '"constant" or "cylinder"',
        "C_D is constant, or follows the Reynolds number as that of a cylinder does",
        preset="constant",
    )
    buoyancy: bool | None = key(
        "true or false", "displaced air, helium and trim weights count", preset=False
    )
    trim: bool | None = key(
        "true or false", "hang the trim weights that make each link float", preset=False
    )
    point_masses: list[PointMass] | None = key(
        "a list of tables with link, mass_kg and position_m",
        "bodies fixed to links",
        example=[{"link": 20, "mass_kg": 0.003, "position_m": 0.99}],
    )
    parameters: dict[Name, Finite | list[Finite]] | None = key(
        "a table of parameter paths and numbers",
        "any other parameter by its path, SI ('giajax parameters' lists them)",
        example={"air.added_mass_coefficient": 1.0},
    )

    @field_validator("parameters", mode="before")
    @classmethod
    def _unquoted_paths_are_paths(cls, table: Any) -> Any:
        return flat(table) if isinstance(table, Mapping) else table

    @field_validator("joint_axes")
    @classmethod
    def _axes_have_a_direction(cls, axes: Any) -> Any:
        if isinstance(axes, list) and [0.0, 0.0, 0.0] in axes:
            raise ValueError("has the axis [0, 0, 0], but must have a direction: correct it")
        return axes

    @model_validator(mode="after")
    def _lists_agree(self) -> "ArmSection":
        # Without `links` the lists must still agree with each other; the run checks the rest.
        self.check_lists(self.links)
        return self

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links` (None: than another)."""
        said = f"links is {links}" if links is not None else ""
        for name in type(self).model_fields:
            value = getattr(self, name)
            if not isinstance(value, list) or name in ("base_rotation_deg", "point_masses"):
                continue
            if links is None:
                links, said = len(value), f"{name} has {len(value)}"
            elif len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each link and "
                    f"{said}: correct the list or give links"
                )


Delay = Annotated[float, Field(ge=-5, le=5, allow_inf_nan=False)]
_DELAY = "a number from -5 to 5"


class SensorsSection(Section):
    """`[sensors]`: what is known of camera, markers and angle sensors. Unless given: exact."""

    camera_rotation_deg: Vector | None = key(
        "a list of three numbers",
        "rotation vector of the camera frame in the base frame",
        example=[0.0, 5.0, 0.0],
    )
    camera_origin_m: Vector | None = key(
        "a list of three numbers",
        "origin of the camera frame in the base frame",
        example=[0.0, 0.1, 0.0],
    )
    camera_scale: Positive | None = key(
        "a positive number", "recorded over true distances", example=1.0
    )
    camera_delay_s: Delay | None = key(
        _DELAY, "how long before its time stamp a position was true", example=0.05
    )
    marker_along_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}",
        "distance of a link's marker from its centre, along the link",
        example=0.0,
    )
    marker_left_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}",
        "distance of a link's marker to the left of its centre",
        example=0.0,
    )
    marker_up_m: Finite | list[Finite] | None = key(
        f"a number {_PER_LINK}", "distance of a link's marker above its centre", example=0.15
    )
    marker_tip_m: Vector | None = key(
        "a list of three numbers",
        "offset of the tip's marker from the tip: along, left, up",
        example=[0.0, 0.0, 0.0],
    )
    encoder_offset_deg: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint",
        "what an angle sensor shows at the angle 0",
        example=0.0,
    )
    encoder_scale: Positive | list[Positive] | None = key(
        "a positive number or a list of them, one a joint",
        "shown over true changes of an angle",
        example=1.0,
    )
    encoder_delay_s: Delay | None = key(
        _DELAY, "how long before its time stamp a joint's angle was true", example=0.05
    )


class InitialSection(Section):
    """`[initial]`: joint angles and rates at the first sample. Unless given: straight, at rest."""

    angle_deg: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint", "joint angles at the first sample", example=0.0
    )
    rate_deg_per_s: Finite | list[Finite] | None = key(
        "a number or a list of them, one a joint", "joint rates at the first sample", example=0.0
    )
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
        if self.first_row and (self.angle_deg is not None or self.rate_deg_per_s is not None):
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
        _BETWEEN_ROWS, "between two rows: linear, or zoh (held)", default="linear", example="linear"
    )


class WindSection(Section):
    """`[wind]`: how the wind columns run between two rows, or a constant wind instead."""

    interpolation: Interpolation = key(
        _BETWEEN_ROWS, "between two rows: linear, or zoh (held)", default="linear", example="linear"
    )
    velocity_m_per_s: Vector | None = key(
        "a list of three numbers",
        "constant wind (x, y, z), instead of wind columns",
        example=[0.0, 0.0, 0.2],
    )
