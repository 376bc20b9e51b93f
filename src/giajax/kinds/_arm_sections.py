"""The sections of an arm: its constants and its sensors."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from .._limits import LINKS as MOST_LINKS
from ..quantities import (
    AIR,
    BASE,
    BUOYANCY,
    CAMERA,
    CONTACT,
    ENCODER,
    JOINTS,
    LINKS,
    MARKER,
)
from ._keys import with_keys
from ._obstacle import Obstacle as Obstacle, check_names
from ._other_parameters import check_bounds, check_stated_once
from ._point_mass import PointMass as PointMass
from ._section import Finite, Name, Section, Vector, each_of, flat, key

# Keys that say which muscles, where there are some.
MUSCLE_KEYS = ("muscle_law", "muscle_correction", "muscle_blend_deg")


@with_keys(LINKS)
class _Links(Section):
    """Which arm it is, and its links."""

    preset: Name | None = key(
        "the name of a preset", "arm that the other keys change", preset="takeichi_20m"
    )
    links: Annotated[int, Field(ge=1, le=MOST_LINKS)] | None = key(
        f"a whole number from 1 to {MOST_LINKS}",
        "number of links; joint i precedes link i",
        preset=20,
    )


@with_keys(JOINTS, BASE, AIR, BUOYANCY, CONTACT)
class _Surroundings(_Links):
    """Its joints, how it stands, and the air."""

    joint_axes: Literal["pitch_yaw"] | list[Literal["pitch", "yaw"] | Vector] | None = key(
        '"pitch_yaw" or a list of "pitch", "yaw" or [x, y, z], one a joint',
        "axes of the joints in the straight arm; pitch_yaw alternates, pitch first",
        preset="pitch_yaw",
    )


class ArmSection(_Surroundings):
    """`[arm]`: the known constants of the arm. A number holds for all links."""

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
    added_mass: Literal["kirchhoff", "inertia"] | None = key(
        '"kirchhoff" or "inertia"',
        "added mass with the products of velocities that belong to it, or without, as in engines "
        "that add it to the mass matrix alone",
        preset="kirchhoff",
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
    obstacles: list[Obstacle] | None = key(
        "a list of tables with shape, name and centre_m",
        "what links may touch: boxes, planes, walls with an opening",
        example=[{"shape": "plane", "name": "ground", "centre_m": [0, 0, -8], "normal": [0, 0, 1]}],
    )
    muscles: Literal["pitch", "all"] | list[Annotated[int, Field(ge=1, le=MOST_LINKS)]] | None = (
        key(
            '"pitch", "all" or a list of numbers of joints',
            "joints that pairs of muscles drive, in place of their springs",
            example="pitch",
        )
    )
    muscle_law: Literal["braided", "empirical"] | None = key(
        '"braided" or "empirical"',
        "law of these muscles, as of [muscle]",
        preset="braided",
    )
    muscle_correction: Literal["continuous", "none"] | None = key(
        '"continuous" or "none"',
        "alpha and beta of joints with muscles, as of [joint]",
        preset="continuous",
    )
    muscle_blend_deg: Annotated[float, Field(gt=0, le=30, allow_inf_nan=False)] | None = key(
        "a number above 0, and up to 30",
        "half-width about 0 in which alpha and beta join; a motion would stick at a jump",
        preset=1.0,
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

    @field_validator("parameters")
    @classmethod
    def _within_bounds(cls, table: dict[str, float | list[float]] | None) -> Any:
        check_bounds(table or {})
        return table

    @field_validator("obstacles")
    @classmethod
    def _obstacles_have_names(cls, obstacles: list[Obstacle] | None) -> Any:
        check_names(obstacles or [])
        return obstacles

    @field_validator("joint_axes")
    @classmethod
    def _axes_have_a_direction(cls, axes: Any) -> Any:
        if isinstance(axes, list) and [0.0, 0.0, 0.0] in axes:
            raise ValueError("has the axis [0, 0, 0], but must have a direction: correct it")
        return axes

    @model_validator(mode="after")
    def _muscles_are_somewhere(self) -> "ArmSection":
        about = [name for name in MUSCLE_KEYS if getattr(self, name) is not None]
        if about and self.muscles is None:
            raise ValueError(
                f"states {about[0]}, but no joints with muscles: add muscles, or remove it"
            )
        return self

    @model_validator(mode="after")
    def _lists_agree(self) -> "ArmSection":
        check_stated_once(self, self.parameters or {})
        # Without `links` the lists must still agree with each other; the run checks the rest.
        self.check_lists(self.links)
        return self

    def lists(self) -> dict[str, list[Any]]:
        """The lists that have one value for each link or joint, by key."""
        axes = {"joint_axes": self.joint_axes} if isinstance(self.joint_axes, list) else {}
        return {**axes, **each_of(self)}

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links` (None: than another)."""
        count = f"links is {links}" if links is not None else ""
        for name, value in self.lists().items():
            if len(value) > MOST_LINKS:
                raise ValueError(
                    f"key {name} has {len(value)} values, but an arm may have {MOST_LINKS} links "
                    "at most: shorten the list"
                )
            if links is None:
                links, count = len(value), f"{name} has {len(value)}"
            elif len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each link and "
                    f"{count}: correct the list or give links"
                )


@with_keys(CAMERA, MARKER, ENCODER)
class SensorsSection(Section):
    """`[sensors]`: what is known of camera, markers and angle sensors. By default: exact."""

    def check_lists(self, links: int | None) -> None:
        """Raise `ValueError` if a list has another length than `links`, where that is known."""
        for name, value in each_of(self).items():
            if links is not None and len(value) != links:
                raise ValueError(
                    f"key {name} has {len(value)} values, but must have one for each of the "
                    f"{links} links: correct the list"
                )
